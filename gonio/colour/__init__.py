"""From spectra to colours: CIE 15, dominant wavelengths, screens, and the colour of a reflection (docs/colour.md)."""

from gonio.colour.cie import (
    ILLUMINANTS,
    chromaticity,
    illuminant,
    light_weights,
    observer,
    spectrum_locus,
    wavelengths,
    weights,
    white,
    xyz,
)
from gonio.colour.display import (
    MONITOR_1982,
    NTSC_1953,
    SRGB,
    Primaries,
    adaptation,
    desaturated,
    display_1982,
    display_srgb,
    exposure,
)
from gonio.colour.dominant import dominant_wavelength
from gonio.colour.lab import lab, lab_slope
from gonio.colour.reflection import (
    ShiftError,
    index_from_f0,
    reflectance,
    reflected_xyz,
    shift_error,
    shifted_xyz,
)

__all__ = [
    "ILLUMINANTS",
    "MONITOR_1982",
    "NTSC_1953",
    "SRGB",
    "Primaries",
    "ShiftError",
    "adaptation",
    "chromaticity",
    "desaturated",
    "display_1982",
    "display_srgb",
    "dominant_wavelength",
    "exposure",
    "illuminant",
    "index_from_f0",
    "lab",
    "lab_slope",
    "light_weights",
    "observer",
    "reflectance",
    "reflected_xyz",
    "shift_error",
    "shifted_xyz",
    "spectrum_locus",
    "wavelengths",
    "weights",
    "white",
    "xyz",
]
