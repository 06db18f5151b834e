"""XYZ on a screen: what a monitor of 1982 was given, and what one of today is."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.colour.cie import white as white_of
from gonio.errors import ArgumentError, refuse_masked
from gonio.typing import ArrayLike, Floats

D6500 = (0.3127, 0.3290)
C = (0.31006, 0.31616)
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""XYZ to the sharpened cone responses of Bradford's chromatic adaptation (Lam 1985), as ICC profiles take them."""


@dataclass(frozen=True)
class Primaries:
    """The three lights of a screen, its white, and its transfer curve.

    Parameters
    ----------
    name
        As reports call it.
    red, green, blue, white
        Chromaticities (x, y). Equal amounts of the three give the white, all of them its Y = 1.
    gamma
        The transfer curve: light = code^gamma; None for the curve of sRGB.
    """

    name: str
    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]
    white: tuple[float, float]
    gamma: float | None = None

    @functools.cached_property
    def to_xyz(self) -> Floats:
        """The matrix (3, 3) from linear RGB to XYZ, ``to_xyz @ rgb``."""
        lights = np.array([(x / y, 1.0, (1.0 - x - y) / y) for x, y in (self.red, self.green, self.blue, self.white)]).T
        return np.asarray(lights[:, :3] * np.linalg.solve(lights[:, :3], lights[:, 3]))

    @functools.cached_property
    def from_xyz(self) -> Floats:
        """The matrix (3, 3) from XYZ to linear RGB, ``from_xyz @ xyz``."""
        return np.asarray(np.linalg.inv(self.to_xyz))

    def rgb(self, xyz: ArrayLike) -> Floats:
        """Linear RGB of XYZ, (..., 3): 1 in every channel for the screen's white, negative outside the gamut."""
        return np.asarray(_triples("xyz", xyz) @ self.from_xyz.T)

    def xyz(self, rgb: ArrayLike) -> Floats:
        """XYZ of linear RGB, (..., 3)."""
        return np.asarray(_triples("rgb", rgb) @ self.to_xyz.T)

    def encode(self, linear: ArrayLike) -> Floats:
        """Values for the screen in [0, 1] from linear light, by the transfer curve, cut to [0, 1]; any shape."""
        cut = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
        if self.gamma is not None:
            return np.asarray(cut ** (1.0 / self.gamma))
        return np.asarray(np.where(cut <= 0.0031308, 12.92 * cut, 1.055 * cut ** (1.0 / 2.4) - 0.055))

    def decode(self, code: ArrayLike) -> Floats:
        """Linear light from values for the screen, in [0, 1]; any shape."""
        value = np.clip(np.asarray(code, dtype=np.float64), 0.0, 1.0)
        if self.gamma is not None:
            return np.asarray(value**self.gamma)
        return np.asarray(np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4))


SRGB = Primaries("sRGB", (0.64, 0.33), (0.30, 0.60), (0.15, 0.06), D6500)
"""IEC 61966-2-1: the screens of today."""
NTSC_1953 = Primaries("NTSC 1953", (0.67, 0.33), (0.21, 0.71), (0.14, 0.08), C, 2.2)
"""The phosphors, white (illuminant C) and gamma of the colour television standard of 1953, 47 CFR 73.682."""
MONITOR_1982 = Primaries("NTSC 1953, white D6500", (0.67, 0.33), (0.21, 0.71), (0.14, 0.08), D6500, 2.2)
"""The phosphors that a monitor of 1982 was specified by, set to the white of Cook and Torrance's light.

The paper prints neither phosphors nor a matrix.
"""


def channel_weights() -> Floats:
    """XYZ of the channels of linear sRGB, (3, 3) as `weights`: a row each of blue, green and red, by wavelength.

    Their sum is the white of D65 (`white`), from which that of sRGB differs by its rounding to four digits.
    """
    return np.asarray(SRGB.to_xyz.T[::-1] * white_of("D65") / SRGB.to_xyz.sum(axis=1))


def adaptation(white: ArrayLike, to: ArrayLike) -> Floats:
    """The matrix (3, 3) that turns XYZ seen under one white into the same look under another, after Bradford.

    Parameters
    ----------
    white, to
        XYZ of the two whites, (3,), each above zero.
    """
    cones = BRADFORD @ np.asarray(white, dtype=np.float64)
    wanted = BRADFORD @ np.asarray(to, dtype=np.float64)
    return np.asarray(np.linalg.solve(BRADFORD, (wanted / cones)[:, None] * BRADFORD))


def desaturated(rgb: ArrayLike, luminance: ArrayLike, *, largest: float = np.inf) -> Floats:
    """Linear RGB moved toward the grey of the same luminance until no channel is below 0 or above `largest`.

    On the straight line to white luminance and dominant wavelength stay, and purity falls. What is in the gamut is
    left alone; what is brighter than `largest` becomes the white of that luminance, `largest` in every channel.

    Parameters
    ----------
    rgb
        Linear RGB, (..., 3).
    luminance
        Its Y, (...), at least 0.
    largest
        The largest value of a channel.
    """
    colour = _triples("rgb", rgb)
    out = np.array(colour.reshape(-1, 3))
    low, high = (functools.reduce(pick, out.T) for pick in (np.minimum, np.maximum))  # ten times .min(axis=1)'s speed
    outside = np.flatnonzero((low < 0.0) | (high > largest))
    grey = np.broadcast_to(np.asarray(luminance, dtype=np.float64), colour.shape[:-1]).reshape(-1)[outside]
    grey = np.clip(grey, 0.0, largest)
    kept = np.ones(outside.size)  # the share of the way from grey to the colour
    low, high = low[outside], high[outside]
    below, above = low < 0.0, high > largest
    kept[below] = (grey / (grey - low))[below]
    kept[above] = np.minimum(kept, (largest - grey) / np.where(above, high - grey, 1.0))[above]
    out[outside] = np.clip(grey[:, None] + kept[:, None] * (out[outside] - grey[:, None]), 0.0, largest)
    return out.reshape(colour.shape)


def display_1982(xyz: ArrayLike, primaries: Primaries = MONITOR_1982) -> Floats:
    """A picture for a monitor of 1982, as Cook and Torrance print the procedure ("Determining the RGB values").

    Colours outside the phosphors' triangle lose purity at constant dominant wavelength (about the monitor's white)
    and luminance until they lie on its edge. All are scaled by one number, for which the brightest is reproduced at
    the largest luminance that its chromaticity can have and all lie inside the gamut. Then the transfer curve.
    Scaling first and losing purity then, as the paper has it, is the same: the loss does not depend on the scale.

    Parameters
    ----------
    xyz
        XYZ of all pixels of a scene, (..., 3), in any unit.
    primaries
        The monitor. With `SRGB` the same procedure for a screen of today.

    Returns
    -------
    Values for the monitor in [0, 1], (..., 3); a black scene stays black.

    Raises
    ------
    ArgumentError
        A value is not finite, or the last axis is not of length 3.
    """
    values = _triples("xyz", xyz)
    rgb = desaturated(primaries.rgb(values), values[..., 1])
    most = float(rgb.max(initial=0.0))
    return primaries.encode(rgb / most if most > 0.0 else rgb)


def exposure(xyz: ArrayLike, share: float = 0.99) -> float:
    """The factor that leaves a share of a picture's lit pixels no brighter than the screen's white.

    Parameters
    ----------
    xyz
        XYZ of all pixels, (..., 3).
    share
        Of the pixels whose Y is above 0, in (0, 1]. The rest, highlights as a rule, is shown white.

    Returns
    -------
    One over that quantile of Y; 1 for a black picture.
    """
    if not 0.0 < share <= 1.0:
        raise ArgumentError(f"share = {share!r}: must lie in (0, 1]")
    luminance = _triples("xyz", xyz)[..., 1]
    lit = luminance[luminance > 0.0]
    return float(1.0 / np.quantile(lit, share)) if lit.size else 1.0


def display_srgb(
    xyz: ArrayLike, *, exposure: float = 1.0, illuminant: str | None = "D65", gamut: str = "desaturate"
) -> Floats:
    """A picture for a screen of today: adapted to its white, exposed, brought into its gamut, encoded as sRGB.

    Parameters
    ----------
    xyz
        XYZ of all pixels, (..., 3).
    exposure
        The factor before the screen's white, which has Y = 1; `exposure` in this module finds one.
    illuminant
        The light whose white is shown as the screen's white, after Bradford. None: no adaptation.
    gamut
        "desaturate": toward the grey of the same luminance, which keeps luminance and dominant wavelength and turns
        highlights white as a camera does. "clip": channel by channel, which shifts the hue: a highlight on copper
        turns yellow. The first is the standard because the second would show a colour that no model predicts.

    Returns
    -------
    Values for the screen in [0, 1], (..., 3).

    Raises
    ------
    ArgumentError
        A value is not finite, the last axis is not of length 3, or an argument is out of range.
    """
    if not (np.isfinite(exposure) and exposure > 0.0):
        raise ArgumentError(f"exposure = {exposure!r}: must be above 0")
    if gamut not in ("desaturate", "clip"):
        raise ArgumentError(f'gamut = {gamut!r}: must be "desaturate" or "clip"')
    matrix = exposure * SRGB.from_xyz
    if illuminant is not None:
        matrix = matrix @ adaptation(white_of(illuminant), SRGB.to_xyz.sum(axis=1))
    rgb = _triples("xyz", xyz) @ matrix.T
    return SRGB.encode(desaturated(rgb, rgb @ SRGB.to_xyz[1], largest=1.0) if gamut == "desaturate" else rgb)


def _triples(name: str, value: Any) -> Floats:
    refuse_masked(name, value)
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ArgumentError(f"{name} has shape {array.shape}: its last axis must have the three numbers of a colour")
    if not bool(np.all(np.isfinite(array))):
        raise ArgumentError(f"{name}: must be finite")
    return array
