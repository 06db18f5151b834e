"""The region of interest of a frame: which pixels show the patch that is read, or the lamp straight through.

Also here is whether the beam is larger ("over") or smaller ("under") than the region of interest, and the rate then.

Overfilled: every pixel of the region is lit, and the irradiance there is known from the geometry of each.
Underfilled: the whole spot lies inside the region, and what is known is the flux of the beam. The signals of all
pixels are then summed over the area that each sees (docs/acquisition.md, "The beam and the region").
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import (
    Channel,
    PixelMap,
    _centre,
    _falloff,
    _middle,
    _project,
    image_distance_mm,
    of_channel,
    pixel_map,
    pixel_on_focus_mm,
    pixel_on_sample_mm,
    pixels_for_each,
    project,
)
from gonio.lab.rig.kinematics import View
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.protocols import Frame, Target
from gonio.typing import Bools, Floats, NDArray


@dataclass(frozen=True, slots=True)
class Roi:
    """The pixels that a BRDF value is the mean of: a rectangle of the sensor, and which of its pixels are used."""

    rows: slice
    cols: slice
    mask: Bools
    """Shape of the rectangle."""

    @property
    def count(self) -> int:
        """Number of pixels used; at least one."""
        return int(np.count_nonzero(self.mask))

    def of(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """The used pixels of a whole frame, one-dimensional."""
        return np.asarray(image[self.rows, self.cols][self.mask])

    def shared(self, other: "Roi") -> int:
        """How many pixels two regions have in common."""
        top, bottom = max(self.rows.start, other.rows.start), min(self.rows.stop, other.rows.stop)
        left, right = max(self.cols.start, other.cols.start), min(self.cols.stop, other.cols.stop)
        if top >= bottom or left >= right:
            return 0
        cut = [r.mask[top - r.rows.start : bottom - r.rows.start, left - r.cols.start : right - r.cols.start]
               for r in (self, other)]  # fmt: skip
        return int(np.count_nonzero(cut[0] & cut[1]))


def require_frame(camera: Camera, frame: Frame, source: str) -> None:
    """Raise `DeviceError` where a frame is not of the size that the rig file gives the camera, or no plane of counts.

    `source` begins the message: a file, or the camera.
    """
    mosaic = np.asarray(frame.mosaic)
    if mosaic.ndim != 2:
        raise DeviceError(
            f"{source}: the frame has {mosaic.ndim} dimensions, {mosaic.shape}; a raw frame is one plane of "
            f"{camera.height} rows of {camera.width} pixels (is it a colour picture?)"
        )
    if mosaic.shape != (camera.height, camera.width):
        raise DeviceError(
            f"{source}: the frame has {mosaic.shape[1]} x {mosaic.shape[0]} pixels; the rig file says "
            f"camera.width = {camera.width}, camera.height = {camera.height}"
        )
    if mosaic.dtype.kind not in "iu":
        raise DeviceError(f"{source}: the frame holds {mosaic.dtype}; a raw frame holds whole numbers [DN]")


def require_raw(camera: Camera, frame: Frame, source: str) -> None:
    """As `require_frame`; and its pattern must be that of the rig file, and no pixel brighter than it says."""
    require_frame(camera, frame, source)
    if frame.pattern != camera.pattern:
        raise DeviceError(
            f'{source}: the frame has the colour pattern "{frame.pattern}"; the rig file says '
            f'camera.pattern = "{camera.pattern}"'
        )
    top = int(frame.mosaic.max())
    if top > frame.white_level_dn:
        raise DeviceError(
            f"{source}: a pixel holds {top} DN, above the highest value, {frame.white_level_dn:g}; the rig file says "
            f"camera.bits = {camera.bits}"
        )


def roi(description: RigDescription, view: View, target: Target = "sample", channel: Channel = "mono") -> Roi:
    """The pixels whose spots lie within `acquisition.roi_radius_mm` of the target's centre.

    On a Bayer sensor only the pixels of the band's channel count ("mono": all of them). Near grazing reflection a
    column can be longer on the sample than the patch is wide, so that no spot falls into it; then the radius grows to
    the length of a pixel on the sample, and a region is never empty.

    Parameters
    ----------
    target
        "sample", at the origin; "reference", at `reference.offset_mm` where it lies beside the sample, else at the
        origin. Where the lamp itself is the reference: see `straight_through`.
    channel
        Colour of the band's pixels.

    Raises
    ------
    ConfigError
        The camera is in the plane, or does not see the target's centre.
    """
    if target == "reference" and description.reference.how == "beam":
        return straight_through(description, view, channel)
    camera, centre = description.camera, _centre(description, target)
    if view.camera_mm[2] == 0:
        raise ConfigError("the camera is in the sample's plane: it sees no region of interest")
    radius = description.acquisition.roi_radius_mm
    longest = pixel_on_sample_mm(description, view)
    extent, (column, row) = _extent(description, view, centre, max(radius, longest))
    if not (-0.5 <= column < camera.width - 0.5 and -0.5 <= row < camera.height - 0.5):
        raise ConfigError(
            f"the centre of the {target} at x = {centre[0]:g} mm, y = {centre[1]:g} mm falls on column {column:.0f}, "
            f"row {row:.0f}, outside the {camera.width} x {camera.height} frame; see reference.offset_mm, "
            "camera.pixel_um and camera.focal_length_mm in the rig file"
        )
    box_cols, box_rows = _span(extent[:2], camera.width), _span(extent[2:], camera.height)
    seen = pixel_map(description, view, box_rows, box_cols)
    x, y = seen.x_mm - centre[0], seen.y_mm - centre[1]
    distance = x * x + y * y  # NaN where a pixel does not see the plane: it is inside of nothing
    if channel != "mono" and camera.pattern != "mono":
        distance[~of_channel(camera.pattern, channel, box_rows, box_cols)] = np.nan
    inside = distance <= radius**2
    if not inside.any():
        inside = distance <= max(longest**2, np.fmin.reduce(distance, axis=None, initial=np.inf))
    return Roi(box_rows, box_cols, inside)


@lru_cache(1)
def _ring() -> Floats:
    """Cosines and sines of 64 equal steps around the edge of a patch, shape (2, 64)."""
    turn = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
    return np.stack([np.cos(turn), np.sin(turn)])


AROUND = 1.15
"""How much larger the region is that holds the lamp, seen straight through, than the lamp is there."""


def straight_radius_mm(description: RigDescription) -> float:
    """Radius [mm], in the plane in focus, of what a camera sees that looks straight into the lamp.

    The plane lies between lamp and lens. From a spot of it both are discs, and it gets light where these overlap.
    """
    g, half_angle = description.geometry, description.lamp.half_angle_deg + description.camera.lens_half_angle_deg
    return float(np.radians(half_angle)) / (1.0 / g.light_distance_mm + 1.0 / g.camera_distance_mm)


def straight_through(description: RigDescription, view: View, channel: Channel = "mono") -> Roi:
    """The pixels that hold the whole lamp, seen straight through an empty holder, and a margin around it.

    The lamp's middle is where a view has it: arms that are not quite in one plane show it beside the frame's.

    Raises
    ------
    ConfigError
        The rig file says neither how large the lamp is nor how large the lens, or the frame does not hold the lamp.
    """
    camera, radius = description.camera, AROUND * straight_radius_mm(description)
    if radius <= 0.0:
        raise ConfigError(
            'reference.how = "beam" needs lamp.half_angle_deg or camera.lens_half_angle_deg: nothing says how much of '
            "the frame the lamp fills"
        )
    g, beam = description.geometry, description.lamp.beam_diameter_mm
    lens = g.camera_distance_mm * float(np.tan(np.radians(camera.lens_half_angle_deg)))
    needed = 2.0 * lens * g.light_distance_mm / (g.light_distance_mm + g.camera_distance_mm)
    if beam is not None and beam < needed:
        raise ConfigError(
            f'reference.how = "beam": a beam of lamp.beam_diameter_mm = {beam:g} mm at the sample does not fill the '
            f"lens behind it, which takes {needed:.3g} mm: take a wider beam, or a white reference"
        )
    pitch = pixel_on_focus_mm(description)
    half = 0.5 * pitch * min(camera.width, camera.height)
    if radius > half:
        raise ConfigError(
            f'reference.how = "beam": the lamp, seen straight through, fills a disc of {radius:.1f} mm radius in the '
            f"plane in focus (a margin of {100 * (AROUND - 1):.0f} % included), and the frame holds {half:.1f} mm: "
            "take a smaller lens aperture, a shorter focal length, or a smaller lamp"
        )
    column, row = (float(place) for place in project(description, view, view.source_mm))
    edge = pitch * min(column + 0.5, row + 0.5, camera.width - 0.5 - column, camera.height - 0.5 - row)
    if not edge >= radius / AROUND:
        raise ConfigError(
            f'reference.how = "beam": the lamp, seen straight through, has its middle on column {column:.0f}, row '
            f"{row:.0f}, and the {camera.width} x {camera.height} frame does not hold it whole: align the arms"
        )
    rows, cols = slice(0, camera.height), slice(0, camera.width)
    v, u = (np.arange(camera.height) - row) * pitch, (np.arange(camera.width) - column) * pitch
    inside = v[:, None] ** 2 + u[None, :] ** 2 <= radius**2
    return Roi(rows, cols, inside & of_channel(camera.pattern, channel, rows, cols))


def straight_through_weight(description: RigDescription, view: View, region: Roi, channel: Channel = "mono") -> Floats:
    """By what the rate of each pixel of `straight_through` is divided, so that their mean is that of a unit BRDF.

    The sum of the rates over the lens's falloff, times `straight_through_scale`, is what the sample would give per unit
    BRDF at normal incidence [e- sr/s]: neither the lamp's solid angle nor the lens's is in it. Derived in
    docs/radiometry.md, "The lamp as the reference".
    """
    camera, area = description.camera, straight_through_scale(description, view)
    falloff = _falloff(camera, image_distance_mm(description), 0, camera.height, 0, camera.width)[region.mask]
    every = region.count * pixels_for_each(camera.pattern, channel)
    return np.asarray(falloff * (description.reference.attenuation or 1.0) / (area * every))


def straight_through_scale(description: RigDescription, view: View) -> float:
    """Area of a pixel in the plane in focus, times (D / (d_i d_r))^2, D being the way from lamp to lens [sr]."""
    g, apart = description.geometry, float(np.linalg.norm(np.asarray(view.source_mm) - np.asarray(view.camera_mm)))
    return pixel_on_focus_mm(description) ** 2 * (apart / (g.light_distance_mm * g.camera_distance_mm)) ** 2


def patch_extent(description: RigDescription, view: View, target: Target = "sample") -> tuple[float, ...]:
    """Lowest and highest column, lowest and highest row (fractional) that the whole patch around a target covers.

    The patch is the disc of `acquisition.roi_radius_mm` around the target's centre. Pixel k reaches from k - 1/2 to
    k + 1/2. Infinite where a part of the patch does not lie in front of the camera.
    """
    centre, radius = _centre(description, target), description.acquisition.roi_radius_mm
    return _extent(description, view, centre, radius)[0]


def _extent(
    description: RigDescription, view: View, centre: tuple[float, float], radius: float
) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """Lowest and highest column, lowest and highest row (fractional) of a disc of the sample's plane; those of its
    middle.
    """
    from gonio.lab.rig._sight_lines import patch_extent as seen

    camera, (x, y), ring = description.camera, centre, _ring()
    if any(camera.distortion):
        columns, rows = _project(
            description, view, np.append(x + radius * ring[0], x), np.append(y + radius * ring[1], y)
        )
        low_high = float(columns.min()), float(columns.max()), float(rows.min()), float(rows.max())
        return low_high, (float(columns[-1]), float(rows[-1]))
    scale, (column, row) = image_distance_mm(description) / (1e-3 * camera.pixel_um), _middle(camera)
    left, right, top, bottom, u, v = seen(
        view.camera_mm, view.optical_axis, view.image_x, view.image_y, x, y, radius, ring
    )
    whole = scale * left + column, scale * right + column, scale * top + row, scale * bottom + row
    return whole, (scale * u + column, scale * v + row)


def outline(description: RigDescription, view: View, target: Target = "sample") -> tuple[Floats, Floats]:
    """Columns and rows (fractional) of the edge of the patch around a target, once round."""
    (x, y), radius = _centre(description, target), description.acquisition.roi_radius_mm
    turn = np.linspace(0.0, 2 * np.pi, 65)
    return _project(description, view, x + radius * np.cos(turn), y + radius * np.sin(turn))


def frame_holds(description: RigDescription, extent: tuple[float, ...]) -> bool:
    """Whether the frame holds a `patch_extent` whole."""
    left, right, top, bottom = extent
    camera = description.camera
    return min(left, top) >= -0.5 and right <= camera.width - 0.5 and bottom <= camera.height - 0.5


def always_holds_sample(description: RigDescription) -> bool:
    """Whether the frame holds the patch of the sample from every direction; False says nothing.

    No spot of the patch lies farther from the optical axis than its radius, nor nearer to the camera than that allows.
    """
    camera, radius = description.camera, description.acquisition.roi_radius_mm
    if not description.as_meant or camera.principal_point_px != (0.0, 0.0) or any(camera.distortion):
        return False
    nearest = description.geometry.camera_distance_mm - radius
    half = 0.5e-3 * camera.pixel_um * min(camera.width, camera.height)
    return nearest > 0 and image_distance_mm(description) * radius <= half * nearest


def _span(extent: tuple[float, ...], size: int) -> slice:
    """The pixels between two fractional positions, with a margin of one Bayer cell, inside the frame."""
    lowest, highest = (min(max(edge, 0.0), size) for edge in extent)
    return slice(max(math.floor(lowest) - 2, 0), min(math.ceil(highest) + 3, size))


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
    pixel = pixel_on_sample_mm(description, view)
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
    area = seen.area_mm2[region.mask] * pixels_for_each(description.camera.pattern, channel)
    return np.asarray(region.count * area / (seen.falloff[region.mask] * received))
