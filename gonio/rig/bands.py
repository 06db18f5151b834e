"""The spectral bands of a rig file: listed, or of a tunable filter."""

from functools import lru_cache
from typing import Literal

from pydantic import model_validator

from gonio.config import Strict
from gonio.errors import ConfigError
from gonio.rig.ranges import Positive

MAX_BANDS = 10_000


class Band(Strict):
    """A spectral band of the rig."""

    name: str
    centre_nm: Positive
    fwhm_nm: Positive
    channel: Literal["mono", "R", "G", "B"] = "mono"


class Tunable(Strict):
    """The range of a source whose wavelength can be chosen."""

    start_nm: Positive
    stop_nm: Positive
    step_nm: Positive
    fwhm_nm: Positive

    @model_validator(mode="after")
    def _sound(self) -> "Tunable":
        if self.stop_nm < self.start_nm:
            raise ValueError("a tunable source needs start_nm <= stop_nm")
        if (self.stop_nm - self.start_nm) / self.step_nm >= MAX_BANDS:
            raise ValueError(f"a tunable source of more than {MAX_BANDS} bands; take a larger step_nm")
        return self


@lru_cache(maxsize=64)
def _all_bands(listed: tuple[Band, ...], tunable: Tunable | None) -> tuple[Band, ...]:
    """Bands by name, and those of a tunable source: some hundred, and a fit asks at every step."""
    if tunable is None:
        return listed
    count = int((tunable.stop_nm - tunable.start_nm) / tunable.step_nm + 1.5)
    centres = [tunable.start_nm + k * tunable.step_nm for k in range(count)]
    made = (
        Band(name=f"{c:g} nm", centre_nm=c, fwhm_nm=tunable.fwhm_nm) for c in centres if c <= tunable.stop_nm + 1e-9
    )
    return (*listed, *made)


class Bands(Strict):
    """Bands by name, or a tunable source that has one every `step_nm`."""

    list: tuple[Band, ...] = ()
    tunable: Tunable | None = None

    @model_validator(mode="after")
    def _some(self) -> "Bands":
        if not self.all():
            raise ValueError("a rig needs at least one band: give `list` or `tunable`")
        names = [band.name for band in self.all()]
        if len(set(names)) < len(names):
            raise ValueError(f'two bands are named "{next(n for n in names if names.count(n) > 1)}"')
        return self

    def all(self) -> tuple[Band, ...]:
        """Every band, in the order of the file."""
        return _all_bands(self.list, self.tunable)

    def containing(self, wavelength_nm: float) -> Band:
        """The band whose full width at half maximum contains a wavelength (the nearest centre, if several do).

        Raises
        ------
        ConfigError
            No band of this rig contains it.
        """
        inside = [b for b in self.all() if abs(b.centre_nm - wavelength_nm) <= b.fwhm_nm / 2 + 1e-9]
        if not inside:
            bands = self.all()
            listed = ", ".join(b.name for b in bands) if len(bands) <= 6 else f"{bands[0].name} ... {bands[-1].name}"
            raise ConfigError(f"wavelength_nm = {wavelength_nm:g} lies in no band of the rig; it has: {listed}")
        return min(inside, key=lambda b: abs(b.centre_nm - wavelength_nm))
