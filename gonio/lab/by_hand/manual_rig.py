"""A rig under a person's hands: one device at a time, from a prompt, a notebook or `gonio rig ...`.

    with gonio.open_rig("my.toml", only=["arms"]) as rig:
        rig.move(light=math.radians(30))
        rig.hold()

A `ManualRig` is the rig itself, with `move`, `read`, `lamp`, `snap` and `scan` beside what `gonio.lab.rig.Rig`
promises. Leaving it darkens and parks, unless `hold` was called. Angles are radians here.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from gonio.errors import ArgumentError, ConfigError, DeviceError, GonioError
from gonio.geometry import ANGLES, Directions
from gonio.lab.acquisition.measure import RigChoice, find_rig
from gonio.lab.rig import (
    ArmsDevice,
    CameraDevice,
    Device,
    Health,
    LightDevice,
    Pose,
    Reading,
    Rig,
    Step,
    Target,
    inverse_kinematics,
    motion_planning,
)
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.protocols import Dims, Holds, Jogs, OpensSome, Surveys, TellsHealth
from gonio.samples.description import SampleDescription
from gonio.samples.files import load_sample
from gonio.typing import DataFrame

if TYPE_CHECKING:
    from gonio.lab.by_hand.snapshot import Snapshot

log = logging.getLogger("gonio.devices")

EYE_NM = 555.0
"""Where an eye sees most: the band that is lit where nobody asks for one."""


@dataclass(frozen=True, slots=True)
class Moved:
    """What a move has come to."""

    asked: dict[str, float]
    """Goals by axis [rad]."""
    landed: dict[str, float]
    """What the encoders read there [rad]."""
    branch: str = ""
    """For a move by directions: which way of reaching them was taken, and on further lines what of the others."""


class ManualRig:
    """An open rig, and what a person does with it.

    Parameters
    ----------
    rig
        Built, and not yet entered. Whatever it has beside is to be had from here too.
    source
        Its name or file, for messages.
    only
        The devices to open; the others may be missing. A rig whose driver has no `only` opens all of them.
    """

    description: RigDescription
    """Its rig file."""
    arms: ArmsDevice
    """Its axes, all together."""
    light: LightDevice
    """Its lamp."""
    camera: CameraDevice
    """Its camera."""
    repeatable: bool
    """True for a simulation alone."""
    begin: Callable[[Step], None]
    """Called before anything of a step of a run is done."""
    present: Callable[[Target], None]
    """Put the sample or the white reference into the beam."""
    time_s: Callable[[], float]
    """Seconds on the rig's own clock."""

    def __init__(self, rig: Rig, source: str = "", only: Sequence[Device] = ()) -> None:
        self.rig, self._source, self._open = rig, source, False
        self._band: Band | None = None
        self._stops = 0
        self.entered = False
        """Its devices were open, now or before."""
        self._only = frozenset(only) if isinstance(rig, OpensSome) else frozenset()
        if self._only and isinstance(rig, OpensSome):
            rig.only(*only)

    # ---- gonio.lab.rig.Rig ----

    def __enter__(self) -> Self:
        with self._naming():
            self.rig.__enter__()
        self._open = self.entered = True
        return self

    def __exit__(self, *how: Any) -> None:
        self._open = False
        self.rig.__exit__(*how)

    def __getattr__(self, name: str) -> Any:
        """What is declared above, and whatever else the rig has."""
        if name.startswith("__") or name == "rig":
            raise AttributeError(name)
        return getattr(self.rig, name)

    def _naming(self) -> contextlib.AbstractContextManager[None]:
        return RigChoice(None, self.rig.description, self._source).naming()  # type: ignore[arg-type]

    # ---- by hand ----

    @property
    def can_hold(self) -> bool:
        """Whether `hold` has an effect; a rig whose driver has no `hold` parks whenever it is left."""
        return isinstance(self.rig, Holds)

    def hold(self) -> None:
        """On leaving, the arms stay where they stand and hold; the lamp is darkened all the same."""
        if not isinstance(self.rig, Holds):
            raise ConfigError(f'the driver of rig "{self.description.name}" has no `hold`: its arms park on leaving')
        self.rig.hold()

    def move(self, **angles: float) -> Moved:
        """Drive axes, or all axes to directions; the others stay where they are.

        Parameters
        ----------
        **angles
            By axis: light, camera, tilt, spin, azimuth [rad]. Or directions [rad]: theta_i and theta_r, with phi_i (0)
            and phi_r. Without phi_r the detector lies in the plane of incidence, and theta_r is signed: positive on
            the mirror side.

        Raises
        ------
        ConfigError
            No such axis, a goal beyond a limit, directions that the rig cannot reach, or a way on which bodies of the
            rig file would touch; nothing has moved.
        DeviceError
            An axis does not land, or `stop` was called meanwhile; every axis has been stopped.
        """
        stops = self._stops
        goals, branch = self.goals(**angles)
        for leg in self._legs(goals):
            if self._stops != stops:
                raise DeviceError("the axes were stopped on their way")
            landed = self._drive(leg)
        self._tell_unsteady(landed)
        return Moved(goals, landed, branch)

    def stop(self) -> None:
        """Stop every axis where it is, from any thread; a move that is going on takes no further leg."""
        self._stops += 1
        self.arms.stop()

    def _tell_unsteady(self, landed: Iterable[str]) -> None:
        """Say so where the readings at rest, whose mean is given, lie too far apart to tell a place."""
        from gonio.lab.acquisition.session import MOVED_DEG, MOVED_STEPS

        spread = getattr(self.arms, "spread", None)
        for name in landed if spread is not None else ():
            apart_deg = math.degrees(getattr(spread, name))
            if apart_deg > max(MOVED_STEPS * self.description.axes()[name].encoder_step_deg, MOVED_DEG):
                log.warning(
                    "axis %s: its readings at rest lie %.2f deg apart, and what it is said to read is their mean",
                    name, apart_deg,
                )  # fmt: skip

    def _legs(self, goals: dict[str, float]) -> list[dict[str, float]]:
        """What to move one after the other, so that no two bodies touch."""
        if not self.description.looks_ahead:
            return [goals]
        here = self.arms.read()
        there, legs = replace(here, **goals), []
        for pose in motion_planning.route(self.description, here, there):
            moved = {n: getattr(pose, n) for n in self.description.axes() if getattr(pose, n) != getattr(here, n)}
            legs.append(moved or goals)
            here = pose
        legs[-1] |= goals
        return legs

    def _drive(self, goals: dict[str, float]) -> dict[str, float]:
        if isinstance(self.rig, Jogs):
            return self.rig.jog(goals)
        pose = self.arms.move(replace(self.arms.read(), **goals))
        return {name: getattr(pose, name) for name in goals}

    def goals(self, **angles: float) -> tuple[dict[str, float], str]:
        """Where `move` would drive the axes [rad], and by which branch; nothing has to be open; errors of `move`."""
        if any(name in ANGLES for name in angles):
            pose, branch = self._reached(angles)
            return {name: float(getattr(pose, name)) for name in self.description.axes()}, branch
        goals = {name: float(angle) for name, angle in angles.items()}
        self.check(goals)
        return goals, ""

    def read(self) -> Health:
        """What every device says of itself: those that are open, or, before the rig is entered, each that is there.

        Before it is entered nothing is changed by it. A device that says nothing stands in `silent`. (A driver without
        `survey` has to be entered for it, and parks when it is left.)
        """
        if not self._open and isinstance(self.rig, Surveys):
            with self._naming():
                return self.rig.survey()
        if not self._open:
            with self:
                return self.read()
        if isinstance(self.rig, TellsHealth):
            return self.rig.health()
        pose, limits = self.arms.read(), self.description.limits_deg()
        return Health(tuple(Reading(n, "angle", math.degrees(getattr(pose, n)), "deg", limits[n]) for n in limits))

    def read_arms(self) -> Health:
        """As `read`, of the axes alone; before the rig is entered, or after it was left."""
        if not isinstance(self.rig, Surveys):
            return self.read()
        with self._naming():
            return self.rig.survey("arms")

    def pose(self) -> Pose | None:
        """Where all axes stand [rad]; None where one of them does not say so."""
        if self._open and (not self._only or "arms" in self._only):
            try:
                return self.arms.read()
            except GonioError:
                return None
        if not isinstance(self.rig, Surveys):
            return None
        health = self.rig.survey("arms")
        angles = {name: health.of(name, "angle") for name in self.description.axes()}
        if not all(isinstance(angle, float) for angle in angles.values()):
            return None
        return Pose(**{name: math.radians(float(angle)) for name, angle in angles.items() if angle is not None})

    def lamp(self, level: float | bool, *, wavelength_nm: float | None = None) -> None:
        """Light the lamp, or darken it.

        Parameters
        ----------
        level
            True: as bright as the rig file says. A fraction of the lamp's largest output, from 0 to 1. 0 or False:
            dark.
        wavelength_nm
            The band that contains it [nm]; without it the last one, and at first the one that is nearest to 555 nm.

        Raises
        ------
        ConfigError
            No such level or band, or the lamp has no levels.
        DeviceError
            The lamp does not do it; it was told to be dark.
        """
        if not 0 <= level <= 1:
            raise ArgumentError(f"level = {level:g}: the lamp's level is a fraction from 0 to 1")
        if wavelength_nm is not None:
            self.choose_band(wavelength_nm)
        if not level:
            self.light.off()
            return
        if isinstance(self.light, Dims):
            self.light.dim(None if level is True else float(level))
        elif level is not True and level != 1:
            raise ConfigError(f'the lamp of rig "{self.description.name}" has no levels: it can be on or off')
        self.light.select(self.band)
        self.light.on()

    def choose_band(self, wavelength_nm: float) -> None:
        """The band that contains a wavelength [nm] is the one that `lamp` lights from now on."""
        self._band = usual_band(self.description, wavelength_nm)

    @property
    def band(self) -> Band:
        """The band that `lamp` lights."""
        return self._band or usual_band(self.description)

    def snap(self, file: str | Path | None = None, *, exposure_s: float | None = None) -> Snapshot:
        """Take a frame, as the lamp is; with `file` it is written, and drawn beside it.

        Parameters
        ----------
        file
            Ends with .dng, .tif or .png: the raw values.
        exposure_s
            Without it, what a matt white surface would need with the lamp on.
        """
        from gonio.lab.by_hand import snapshot

        return snapshot.take(self, Path(file) if file is not None else None, exposure_s=exposure_s)

    def scan(
        self, axis: str, angles: Sequence[float], *, frames: int = 2, exposure_s: float | None = None,
        progress: Callable[[DataFrame, int], None] = lambda table, total: None,
    ) -> DataFrame:  # fmt: skip
        """A signal against an angle; see `gonio.lab.by_hand.scan.scan`. The lamp is dark after it, whatever happens."""
        from gonio.lab.by_hand import scan

        return scan.scan(self, axis, angles, frames=frames, exposure_s=exposure_s, progress=progress)

    # ---- inside ----

    def check(self, goals: dict[str, float]) -> None:
        """Raise `ConfigError` where one of these goals [rad] is none of an axis of the rig."""
        limits = self.description.limits_deg()
        if not goals:
            raise ArgumentError(f"nothing to move: name an axis ({', '.join(limits)}), or theta_i and theta_r")
        for name, angle in goals.items():
            if name not in limits:
                known = f"it has {', '.join(limits)}; directions are {', '.join(ANGLES)}"
                raise ConfigError(f'rig "{self.description.name}" has no axis {name}; {known}')
            lower, upper = limits[name]
            degrees = math.degrees(angle)
            if not lower - 1e-6 <= degrees <= upper + 1e-6:
                raise ConfigError(f"{name} = {degrees:g} deg is outside this axis's limits, {lower:g} to {upper:g} deg")

    def _reached(self, angles: dict[str, float]) -> tuple[Pose, str]:
        wrong = [name for name in angles if name not in ANGLES]
        if wrong:
            raise ArgumentError(f"{wrong[0]}: give either axes or directions ({', '.join(ANGLES)})")
        for name in ("theta_i", "theta_r"):
            if name not in angles:
                raise ArgumentError(f"{name} is missing: directions need theta_i and theta_r")
        for name, angle in angles.items():
            if not math.isfinite(angle):
                raise ArgumentError(f"{name} = {angle}: must be a finite angle")
        theta_r, phi_i = angles["theta_r"], angles.get("phi_i", 0.0)
        if "phi_r" in angles:
            if theta_r < 0:
                raise ArgumentError("theta_r is negative: with phi_r it counts from the normal, 0 to 90 deg")
            phi_r = angles["phi_r"]
        else:
            phi_r = phi_i + (math.pi if theta_r >= 0 else 0.0)
        directions = Directions(angles["theta_i"], phi_i, abs(theta_r), phi_r)
        pose = inverse_kinematics.reach(self.description, directions)
        return pose, self._branch(directions, pose)

    def _branch(self, directions: Directions, taken: Pose) -> str:
        others = []
        for pose, verdict in inverse_kinematics.branches(self.description, directions):
            if isinstance(verdict, Pose):
                if any(abs(getattr(verdict, n) - getattr(taken, n)) > 1e-9 for n in self.description.axes()):
                    others.append(f"{self._said(verdict)} {self._free(verdict)}")
            else:
                others.append(f"{self._said(pose)} is out of reach: {verdict}")
        return "\n".join([f"taken: {self._said(taken)}", *(dict.fromkeys(others) or ["there is no other way"])])

    def _free(self, pose: Pose) -> str:
        try:
            motion_planning.require_free(self.description, pose)
        except motion_planning.Blocked as blocked:
            return f"is blocked: {blocked}"
        return "would do too"

    def _said(self, pose: Pose) -> str:
        return ", ".join(
            f"{name} {round(math.degrees(getattr(pose, name)), 2) + 0.0:.2f}" for name in self.description.axes()
        )


def usual_band(description: RigDescription, wavelength_nm: float | None = None) -> Band:
    """The band that contains a wavelength [nm]; without one, that nearest to where an eye sees most."""
    if wavelength_nm is not None:
        return description.bands.containing(wavelength_nm)
    return min(description.bands.all(), key=lambda band: abs(band.centre_nm - EYE_NM))


def open_rig(
    name: str,
    *,
    sample: str | Path | SampleDescription | None = None,
    seed: int = 0,
    confirm: bool = False,
    only: Sequence[Device] = (),
) -> ManualRig:
    """A rig by its name or its rig file, built and not yet entered: `with open_rig("sim", sample="s.toml") as rig:`.

    Parameters
    ----------
    name
        "sim", "sim-ideal", another entry point, or the path of a rig file.
    sample
        Of a simulated rig: a sample file, or what it holds.
    seed
        Of a simulated rig's noise.
    confirm
        Ask somebody before sample and reference are taken as swapped.
    only
        The devices to open, of "arms", "light", "camera"; the others may be missing. Without it, all.

    Raises
    ------
    ConfigError
        There is no such rig, file or sample, or one of them is wrong.
    """
    described = load_sample(sample) if isinstance(sample, (str, Path)) else sample
    choice = find_rig(name)
    rig = choice.open(sample=described, seed=seed, confirm=confirm, by_hand=bool(only))
    return ManualRig(rig, choice.source, only)
