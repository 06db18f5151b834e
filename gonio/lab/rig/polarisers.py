"""Polarisers of a rig file: before the lamp, before the camera, or both; and bands in states of polarisation."""

from typing import Annotated, Literal

from pydantic import Field

from gonio.config import Fraction, NonNegative, Positive, SmallAngle, Strict
from gonio.errors import ConfigError
from gonio.lab.rig.light_and_camera import Band
from gonio.polarisation import UNPOLARISED, WORDS

Side = Literal["light", "receiver"]
SIDES: tuple[Side, Side] = ("light", "receiver")


class PolariserMount(Strict):
    """A polariser on an arm, with what turns it."""

    empty: bool = False
    """It can be taken out of the beam: the state u, and unpolarised measurements."""
    retarder: bool = False
    """It can make, or pass, circular light: the states r and l."""
    extinction: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Smallest over largest transmittance for linearly polarised light."""
    azimuth_deg: SmallAngle = 0.0
    """How far its axis stands beside where it is turned to: it is turned that much less."""
    u_extinction: NonNegative = 0.0
    """Standard uncertainty of the extinction; a simulated rig draws the remaining error from its seed, as of the two
    that follow. A calibration that knows a number is believed instead."""
    u_azimuth_deg: NonNegative = 0.0
    u_transmittance: NonNegative = 0.0
    """Relative standard deviation of what passes, from one azimuth to another. In the plane of the arms the white
    reference tells it; elsewhere it is in the budget."""
    transmittance: Annotated[Fraction, Field(gt=0)] = 1.0
    """Simulation: of light that is polarised along the axis."""
    turn_s: Positive = 1.0
    """Time that a change of state takes, about."""

    def refusal(self, letter: str) -> str:
        """Why it cannot do a state; "" where it can."""
        if letter == "u" and not self.empty:
            return "it has no empty place (empty = false)"
        if letter in "rl" and not self.retarder:
            return "it has no retarder (retarder = false)"
        return ""


class PolariserMounts(Strict):
    """Those of a rig."""

    light: PolariserMount | None = None
    receiver: PolariserMount | None = None

    def on(self, side: Side) -> PolariserMount | None:
        """The one on a side, where there is one."""
        return self.light if side == "light" else self.receiver

    def sides(self) -> tuple[Side, ...]:
        """Where there is one."""
        return tuple(side for side in SIDES if self.on(side) is not None)

    @property
    def turn_s(self) -> float:
        """Time that a change of state takes, all of them at once [s]."""
        return max((mount.turn_s for mount in (self.light, self.receiver) if mount is not None), default=0.0)

    def passed(self, word: str) -> float:
        """What of the light of a depolarising sample is seen in a state, of what is seen without polarisers."""
        out = 1.0
        for side, letter in zip(SIDES, letters(word), strict=True):
            mount = self.on(side)
            if mount is not None and letter != "u":
                out *= 0.5 * mount.transmittance * (1.0 + mount.extinction)
        return out

    def require(self, word: str) -> None:
        """Raise `ConfigError` where the rig cannot measure in a state, a word of `gonio.polarisation`."""
        if word not in WORDS or not (word == UNPOLARISED or word.islower()):
            raise ConfigError(
                f'polarisation: "{word}" is no state that a rig can measure; one letter for the light (u, s, p, d, a, '
                'r, l), or two for light and analyser, as "s", "sp", "us"; or "unpolarised"'
            )
        for side, letter in zip(SIDES, letters(word), strict=True):
            mount = self.on(side)
            if mount is None:
                if letter != "u":
                    raise ConfigError(
                        f'polarisation = "{word}": the rig has no polariser before the '
                        f"{'lamp' if side == 'light' else 'camera'}; leave the state out, or say what there is in "
                        f"[polarisers.{side}] of the rig file"
                    )
            elif why := mount.refusal(letter):
                raise ConfigError(
                    f'polarisation = "{word}": [polarisers.{side}] of the rig cannot do "{letter}": {why}'
                )


class PolarisedBand(Band):
    """A band in one state of light and analyser: measured, and calibrated by the white reference, as a band is."""

    state: str

    @property
    def polarisation(self) -> str:
        return self.state

    @property
    def alone(self) -> Band:
        return Band(**self.model_dump(exclude={"state", "name"}), name=self.name.removesuffix(f" ({self.state})"))


def in_states(bands: tuple[Band, ...], words: tuple[str, ...]) -> tuple[Band, ...]:
    """Every band in every state, in the order of the states; the bands themselves where that is no polarisation."""
    out: list[Band] = []
    for word in words or (UNPOLARISED,):
        for band in bands:
            named = band.model_dump() | {"name": f"{band.name} ({word})"}
            out.append(band if word == UNPOLARISED else PolarisedBand(**named, state=word))
    return tuple(out)


def letters(word: str) -> tuple[str, str]:
    """Those of the light and of the analyser."""
    return ("u", "u") if word == UNPOLARISED else (word[0], word[1:] or "u")
