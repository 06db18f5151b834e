"""All quantities of appearance of one sample, from what its table or its model gives."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gonio.shown import finite
from gonio_analysis.appearance import sampled
from gonio_analysis.appearance.sampled import NotMeasured, Sampled
from gonio_analysis.result_records import Appearance, AtIncidence, Colour, Quantity, Retroreflection

WHITE_L = 100.0
"""L* of the perfect diffuser."""
BRIGHTER = (
    "above 100: brighter than a perfect white diffuser in this direction, as a gloss is near the mirror direction"
)
MULTI_ANGLE = ((45.0, -15.0), (45.0, 15.0), (45.0, 25.0), (45.0, 45.0), (45.0, 75.0), (45.0, 110.0), (15.0, -15.0),
               (15.0, 15.0))  # fmt: skip
"""Angle of incidence and aspecular angle [deg]: ASTM E2194 (45: 15, 45, 110) and E2539."""
FLOP = ((45.0, 15.0), (45.0, 45.0), (45.0, 110.0))
RETRO = ((4.0, 0.2, "ASTM E810"), (5.0, 0.33, "EN 12899"))
"""Entrance and observation angle [deg] of retroreflection."""
SMOOTH_TIS = 0.1
"""Largest share of scattered light from which a roughness is stated."""
HAZE_GU = (70.0, 100.0)
"""Glosses from which D4039's index follows: a high gloss at 60 degrees, on the scale of the standard glass."""
HAZE_SLACK_GU = 0.1
"""Beyond the upper one, besides what is not known: quadratures give a smooth glass a hundredth more or less."""
UNVERIFIED = "through apertures of 0.4° by 3° and a source of 0.44° by 5°, which could not be verified"
FLOP_STEP = 0.5
"""Step of L* over which the slope of the flop index is taken. At equal lightnesses its tangent is level, and says that
lightnesses have no part in it."""
DARKEST_L = 1.0
"""L* that a flop index is divided by."""


class _Numbers:
    """Numbers by name, and why others are missing."""

    def __init__(self) -> None:
        self.values: dict[str, Sampled] = {}
        self.missing: dict[str, NotMeasured] = {}

    def take(self, key: str, one: Sampled | NotMeasured) -> None:
        """Keep a number, or why there is none."""
        if isinstance(one, NotMeasured):
            self.missing[key] = one
        else:
            self.values[key] = one

    def put(self, key: str, make: Callable[[], Sampled]) -> None:
        """Work a number out, or keep why that cannot be done."""
        try:
            self.values[key] = make()
        except NotMeasured as error:
            self.missing[key] = error

    def __getitem__(self, key: str) -> Sampled:
        if key in self.missing:
            why = self.missing[key]
            raise NotMeasured(str(why), why.at_least)  # a new one: one that is raised again keeps all its frames
        return self.values[key]


def _key(theta_i_deg: float, aspecular_deg: float) -> str:
    return f"{theta_i_deg:g}as{aspecular_deg:g}"


@dataclass(frozen=True)
class _Quantities:
    """What standards ask for, made of numbers, with their uncertainties; or why it is not known."""

    numbers: _Numbers
    uncertainty: Callable[[Sampled], float | None]
    wavelength_nm: float

    def quantity(
        self, make: Callable[[], Sampled], unit: str, note: Callable[[float], str | None] | None = None
    ) -> Quantity:
        try:
            one = make()
        except NotMeasured as error:
            return Quantity(None, None, None, unit, why=str(error), at_least=finite(error.at_least))
        u = self.uncertainty(one)
        remark = one.note if note is None else note(one.value)
        return Quantity(finite(one.value), finite(u), finite(one.error), unit, note=remark)

    def named(self, key: str, unit: str) -> Quantity:
        return self.quantity(lambda: self.numbers[key], unit)

    def haze(self) -> Sampled:
        high, low = self.numbers["gloss_60_gu"], self.numbers["gloss_20_gu"]
        if high.value <= HAZE_GU[0]:
            raise NotMeasured(f"D4039 is for a gloss at 60° above {HAZE_GU[0]:g} GU: it is {high.value:.3g} GU")
        for angle, one in ((20, low), (60, high)):
            slack = HAZE_SLACK_GU + one.error + 2.0 * (finite(self.uncertainty(one)) or 0.0)
            if one.value > HAZE_GU[1] + slack:
                raise NotMeasured(
                    f"D4039 is for non-metals, whose gloss ends at {HAZE_GU[1]:g} GU, that of the standard glass: at"
                    f" {angle}° it is {one.value:.4g} GU"
                )
        return high.plus(low, -1.0)

    def tis(self) -> Sampled:
        return sampled.made_of(lambda rho, spike: 1.0 - spike / rho, self.numbers["rho_dh_8"], self.numbers["spike_8"])

    def roughness(self) -> Sampled:
        share = self.tis()
        if not 0.0 < share.value < SMOOTH_TIS:
            raise NotMeasured(
                f"{100 * share.value:.3g} % of what is reflected is scattered: a roughness follows between 0 and"
                f" {100 * SMOOTH_TIS:g} %, from a smooth surface without a diffuse base"
            )
        if math.isnan(self.wavelength_nm):
            raise NotMeasured("the wavelength is not known")
        length = self.wavelength_nm / (4.0 * math.pi * math.cos(math.radians(8.0)))
        return sampled.made_of(lambda t: length * math.sqrt(-math.log1p(-t)), share)

    def retro(self, entrance: float, observation: float, after: str) -> Retroreflection:
        cos_i, cos_r = math.cos(math.radians(entrance)), math.cos(math.radians(entrance + observation))
        return Retroreflection(
            after,
            entrance,
            observation,
            self.quantity(lambda: self.numbers[f"f {entrance}"].times(cos_i * cos_r), "cd/(lx m²)"),
            self.quantity(lambda: self.numbers[f"f {entrance}"].times(cos_i), "cd/(m² lx)"),
        )

    def colour_at(self, theta_i: float, aspecular: float) -> Colour:
        key = _key(theta_i, aspecular)
        light = self.quantity(lambda: self.numbers[f"L {key}"], "1", lambda x: BRIGHTER if x > WHITE_L else None)
        return Colour(
            theta_i, aspecular, theta_i - aspecular, light, *(self.named(f"{letter} {key}", "1") for letter in "ab")
        )


def _assembled(
    numbers: _Numbers,
    uncertainty: Callable[[Sampled], float | None],
    name: str,
    source: str,
    kind: str,
    wavelength_nm: float,
    incidences: Sequence[float],
    notes: Sequence[str],
) -> Appearance:
    of = _Quantities(numbers, uncertainty, wavelength_nm)
    return Appearance(
        name=name,
        source=source,
        kind=kind,
        wavelength_nm=finite(wavelength_nm),
        gloss_20_gu=of.named("gloss_20_gu", "GU"),
        gloss_60_gu=of.named("gloss_60_gu", "GU"),
        gloss_85_gu=of.named("gloss_85_gu", "GU"),
        haze_gu=of.quantity(of.haze, "GU"),
        haze_e430_20=of.named("haze_e430_20", "HU"),
        haze_e430_30=of.quantity(lambda: numbers["haze_e430_30"], "HU", lambda _: UNVERIFIED),
        rho_dh_8=of.named("rho_dh_8", "1"),
        rho_dh=[
            AtIncidence(**vars(of.named(f"rho_dh {math.degrees(t)}", "1")), theta_i_deg=round(math.degrees(t), 2))
            for t in incidences
        ],
        radiance_factor_0_45=of.named("radiance_factor_0_45", "1"),
        radiance_factor_45_0=of.named("radiance_factor_45_0", "1"),
        retroreflection=[of.retro(*geometry) for geometry in RETRO],
        lab=[of.colour_at(*geometry) for geometry in MULTI_ANGLE],
        flop_index=of.quantity(lambda: _flop(numbers), "1"),
        tis_8=of.quantity(of.tis, "1"),
        rms_roughness_nm=of.quantity(of.roughness, "nm"),
        notes=list(notes),
    )


def _flop(numbers: _Numbers) -> Sampled:
    def index(near: float, face: float, far: float) -> float:
        # Alman 1987; below the noise it keeps its sign, as every estimate
        return float(2.69 * math.copysign(abs(near - far) ** 1.11, near - far) / face**0.86)

    near, face, far = (numbers[f"L {_key(*geometry)}"] for geometry in FLOP)
    if face.value < DARKEST_L:
        raise NotMeasured(f"L* at 45 degrees, aspecular 45, is below {DARKEST_L:g}: the index divides by it")
    return sampled.made_of(index, near, face, far, step=FLOP_STEP)
