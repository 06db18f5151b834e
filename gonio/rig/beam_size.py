"""Whether the beam is larger than the region of interest ("over") or smaller ("under"), and what a rate is then.

Overfilled: every pixel of the region is lit, and the irradiance there is known from the geometry of each.
Underfilled: the whole spot lies inside the region, and what is known is the flux of the beam. The signals of all
pixels are then summed over the area that each sees (docs/exposure.md, "The beam and the region").
"""

import math
from typing import Literal

import numpy as np

from gonio.errors import ConfigError
from gonio.rig import imaging
from gonio.rig.description import RigDescription
from gonio.rig.imaging import Channel, PixelMap
from gonio.rig.kinematics import View
from gonio.rig.protocols import Target
from gonio.rig.regions import Roi
from gonio.typing import Floats

Filling = Literal["over", "under"]


def filling(description: RigDescription) -> Filling:
    """How the beam of a rig is meant to fill the region: "under" where it is narrower than the region is wide."""
    beam = description.lamp.beam_diameter_mm
    return "over" if beam is None or beam >= 2.0 * description.acquisition.roi_radius_mm else "under"


def cut(description: RigDescription, view: View, target: Target = "sample") -> str:
    """Why the edge of the beam cuts through the region of interest in a view, for people; "" where it does not.

    The spot of a beam of the radius b at the distance d from the lamp reaches b across the plane of incidence, and
    b / (cos theta_i - (b/d) sin theta_i) in it. Half a pixel on the sample is left to the pixels at the edge.
    """
    beam = description.lamp.beam_diameter_mm
    if beam is None:
        return ""
    source, eye = np.asarray(view.source_mm, dtype=float), np.asarray(view.camera_mm, dtype=float)
    if source[2] <= 0 or eye[2] == 0:
        return ""  # other words are there for these
    half, radius, distance = 0.5 * beam, description.acquisition.roi_radius_mm, float(np.linalg.norm(source))
    pixel = imaging.pixel_on_sample_mm(description, view)
    beside = target == "reference" and description.reference.how == "beside"
    if filling(description) == "over":
        reach = max(radius, pixel) + 0.5 * pixel + (math.hypot(*description.reference.offset_mm) if beside else 0.0)
        if half >= reach:
            return ""
        return f"the beam of {beam:g} mm does not cover the region, which reaches {reach:.3g} mm from the beam's axis"
    if beside:
        return f"the beam of {beam:g} mm does not fall on a reference that lies beside the sample"
    cosine = source[2] / distance
    narrowing = cosine - half / distance * math.sqrt(1.0 - min(cosine, 1.0) ** 2)
    reach = half / narrowing if narrowing > 0 else math.inf
    if reach + 0.5 * pixel > radius:
        return (
            f"the edge of the beam's spot, {reach:.3g} mm from the centre, cuts through the region of {radius:g} mm "
            f"and its pixels of {pixel:.2g} mm"
        )
    return ""


def require_whole(description: RigDescription, view: View, target: Target) -> None:
    """Raise `ConfigError` where the edge of the beam cuts through a region that a run cannot do without."""
    why = cut(description, view, target)
    if why:
        raise ConfigError(
            f'rig "{description.name}": {target}: {why}; see lamp.beam_diameter_mm and acquisition.roi_radius_mm'
        )


def per_weight(description: RigDescription, view: View, seen: PixelMap, region: Roi, channel: Channel) -> Floats:
    """What the signals of the used pixels are multiplied with, so that their mean is R pi f; shape (n,).

    Overfilled: 1 / (falloff cos(theta_i) (d0/d)^2 radiation); infinite where no light falls. Underfilled: N A_k /
    (falloff S) with the area A_k that a pixel sees on the sample, and S = integral of cos(theta_i) (d0/d)^2 radiation
    over the spot, which is the beam's solid angle times d0^2 whatever the angle of incidence.
    """
    if filling(description) == "over":
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / seen.weight[region.mask])
    source = np.asarray(view.source_mm, dtype=float)
    if source[2] <= 0:
        return np.full(region.count, math.inf)
    beam = description.lamp.beam_diameter_mm or 0.0
    squared = 1.0 / (1.0 + (2.0 * float(np.linalg.norm(source)) / beam) ** 2)  # of the sine of the beam's half-angle
    lambertian = description.lamp.radiation == "lambertian"
    solid = math.pi * squared if lambertian else 2.0 * math.pi * squared / (1.0 + math.sqrt(1.0 - squared))
    received = description.geometry.light_distance_mm**2 * solid
    area = seen.area_mm2[region.mask] * imaging.pixels_for_each(description.camera.pattern, channel)
    return np.asarray(region.count * area / (seen.falloff[region.mask] * received))
