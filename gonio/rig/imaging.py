"""Which spot of the sample each pixel sees, and how the light falls on it: pure geometry of a view.

The camera is a pinhole in the middle of its lens, focused on the sample's centre. The simulated camera calls this
with the true view, the reduction with the view that the encoders read, so that both sides share one set of formulas
and differ only in what they know. Everything is in the sample's frame: origin at its centre, z its normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from gonio.errors import ConfigError, DeviceError
from gonio.rig.description import Camera, RigDescription
from gonio.rig.protocols import Frame, Target
from gonio.typing import Floats

if TYPE_CHECKING:
    from gonio.rig.kinematics import View

Channel = Literal["mono", "R", "G", "B"]
EDGE_PARTS = 4
"""Parts of the side of a pixel at the beam's edge: the area of a spot of 16 pixels is then right to 2e-4."""


def image_distance_mm(description: RigDescription) -> float:
    """Distance from the lens to the sensor [mm] that brings the sample's centre into focus: 1/(1/f - 1/d)."""
    focal, distance = description.camera.focal_length_mm, description.geometry.camera_distance_mm
    return 1.0 / (1.0 / focal - 1.0 / distance)


class PixelMap:
    """What a rectangle of pixels sees of the sample's plane, each array of shape (rows, columns).

    Nothing is computed before it is asked for. A pixel whose line of sight does not meet the plane in front of the
    camera sees nothing: its `x_mm`, `y_mm` are NaN, and `cos_theta_i` and `distance_factor` are zero.
    """

    def __init__(self, description: RigDescription, view: View, rows: slice, cols: slice) -> None:
        camera = description.camera
        self._camera_model = camera
        self._image_distance_mm = image_distance_mm(description)
        self._distance_mm = description.geometry.light_distance_mm
        self._lambertian = description.lamp.radiation == "lambertian"
        beam = description.lamp.beam
        self._beam = beam.terms() if beam is not None and any(beam.terms()) else None
        self._beam_mm = description.lamp.beam_diameter_mm
        self._source = np.asarray(view.source_mm, dtype=float)
        self._camera = np.asarray(view.camera_mm, dtype=float)
        self._beam_y = np.asarray(view.image_y if view.beam_y is None else view.beam_y, dtype=float)
        self.rows = slice(*rows.indices(camera.height)[:2])
        self.cols = slice(*cols.indices(camera.width)[:2])
        # The line of sight of the pixel (i, j) is axis + v_i image_y + u_j image_x, with u and v in units of the image
        # distance: it is separable, so that a frame costs two outer sums.
        u, v = _on_sensor(camera, self._image_distance_mm, self.rows, self.cols)
        self._view = view
        self._by_col = np.asarray(view.image_x, dtype=float)[:, None] * u
        self._by_row = view.optical_axis + v[:, None] * np.asarray(view.image_y, dtype=float)

    @cached_property
    def _spots(self) -> tuple[Floats, Floats, Floats, Floats]:
        from gonio.rig._sight_lines import spots

        if any(self._camera_model.distortion):
            return self._spots_of_bent_lines()
        out = np.empty((4, self._by_row.shape[0], self._by_col.shape[1]))
        spots(self._by_row, self._by_col, self._camera, self._source, self._distance_mm, *out)
        return out[0], out[1], out[2], out[3]

    def _spots_of_bent_lines(self) -> tuple[Floats, Floats, Floats, Floats]:
        """As `gonio.rig._sight_lines.spots`, for lines of sight through a lens with distortion."""
        lines, eye, source = self.sight_lines, self._camera, self._source
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = (eye[k] - eye[2] * lines[..., k] / lines[..., 2] for k in (0, 1))
            meets = eye[2] * lines[..., 2] < 0.0
            inverse = 1.0 / ((source[0] - x) ** 2 + (source[1] - y) ** 2 + source[2] ** 2)
            cosine = max(source[2], 0.0) * np.sqrt(inverse)
        return (
            np.where(meets, x, np.nan),
            np.where(meets, y, np.nan),
            np.where(meets, cosine, 0.0),
            np.where(meets, self._distance_mm**2 * inverse, 0.0),
        )

    @cached_property
    def sight_lines(self) -> Floats:
        """Directions of the lines of sight, of length 1 along the optical axis, shape (rows, columns, 3)."""
        camera, view = self._camera_model, self._view
        if not any(camera.distortion):
            return np.asarray(self._by_row[:, None, :] + self._by_col.T[None, :, :])
        rows, cols = self.rows, self.cols
        u, v = _straightened(camera, self._image_distance_mm, rows.start, rows.stop, cols.start, cols.stop)
        across = u[..., None] * np.asarray(view.image_x) + v[..., None] * np.asarray(view.image_y)
        return np.asarray(view.optical_axis + across)

    @property
    def x_mm(self) -> Floats:
        """The spot's x in the sample's frame [mm]."""
        return self._spots[0]

    @property
    def y_mm(self) -> Floats:
        """The spot's y in the sample's frame [mm]."""
        return self._spots[1]

    @property
    def cos_theta_i(self) -> Floats:
        """Cosine of the local angle of incidence; 0 where the source is below the plane."""
        return self._spots[2]

    @property
    def distance_factor(self) -> Floats:
        """(d0/d)^2 with d the spot's distance from the source and d0 = geometry.light_distance_mm."""
        return self._spots[3]

    @property
    def sees_plane(self) -> npt.NDArray[np.bool_]:
        """True where the pixel sees the plane of the sample."""
        return np.isfinite(self.x_mm)

    @property
    def falloff(self) -> Floats:
        """The lens's share of light: cos^4 of the field angle and vignetting, where the rig has them (read-only)."""
        camera, distance = self._camera_model, self._image_distance_mm
        return _falloff(camera, distance, self.rows.start, self.rows.stop, self.cols.start, self.cols.stop)

    @property
    def radiation(self) -> Floats:
        """The lamp's radiant intensity toward the spot, relative to that toward the sample's centre (`lamp.radiation`).

        A Lambertian lamp faces the centre, and the intensity falls with the cosine of the angle at the lamp between
        centre and spot: with S from the centre to the lamp and x the spot, S (S - x) / (|S| |S - x|). The measured
        profile `lamp.beam` comes on top of either.
        """
        if self._beam is not None:
            return self._facing * self._profile(self._beam)
        return self._facing

    @property
    def _facing(self) -> Floats:
        if not self._lambertian:
            return np.ones(self.x_mm.shape)
        (sx, sy, _), squared = self._source, float(self._source @ self._source)
        across = (sx * self.x_mm + sy * self.y_mm) / squared
        away = np.sqrt(squared * self.distance_factor) / self._distance_mm  # |S| / |S - x|
        return np.where(self.sees_plane, np.maximum((1.0 - across) * away, 0.0), 0.0)

    @property
    def beam_xy_mm(self) -> tuple[Floats, Floats]:
        """Where the ray from the lamp to the spot crosses the plane that faces the lamp (`Beam`) [mm]."""
        distance = float(np.linalg.norm(self._source))
        toward = self._source / distance
        along = np.cross(self._beam_y, toward)
        stretch = distance / (distance - toward[0] * self.x_mm - toward[1] * self.y_mm)
        x, y = ((e[0] * self.x_mm + e[1] * self.y_mm) * stretch for e in (along, self._beam_y))
        return x, y

    def _profile(self, terms: tuple[float, ...]) -> Floats:
        x, y = self.beam_xy_mm
        log = terms[0] * x + terms[1] * y + terms[2] * x**2 + terms[3] * x * y + terms[4] * y**2
        return np.where(self.sees_plane, np.exp(np.minimum(log, 1.0)), 0.0)

    @cached_property
    def lit(self) -> Floats:
        """The share of each pixel's spot that lies in the beam (`lamp.beam_diameter_mm`), whose edge is sharp.

        The beam is a cone around the direction from the lamp to the sample's centre. Pixels at its edge are cut into
        parts; of each that share counts which a straight edge leaves, linear in the distance of the part from it.
        """
        x, y = self.x_mm, self.y_mm
        if self._beam_mm is None:
            return np.ones(x.shape)
        outside = self._outside_beam(x, y)
        width = sum(np.abs(slope) for slope in np.gradient(outside))
        share = (outside < 0.0).astype(float)
        edge = np.abs(outside) < width
        down, right = ([slope[edge] for slope in slopes] for slopes in zip(np.gradient(x), np.gradient(y), strict=True))
        share[edge] = 0.0
        parts = (np.arange(EDGE_PARTS) + 0.5) / EDGE_PARTS - 0.5
        for row in parts:
            for col in parts:
                apart = self._outside_beam(
                    x[edge] + row * down[0] + col * right[0], y[edge] + row * down[1] + col * right[1]
                )
                share[edge] += np.clip(0.5 - EDGE_PARTS * apart / width[edge], 0.0, 1.0) / EDGE_PARTS**2
        return np.where(self.sees_plane, share, 0.0)

    def _outside_beam(self, x: Floats, y: Floats) -> Floats:
        """How far spots of the plane lie outside the beam [mm], across its axis at the sample's centre."""
        away = float(np.linalg.norm(self._source))
        along = away - (self._source[0] * x + self._source[1] * y) / away
        across = np.sqrt(np.maximum(x**2 + y**2 - (away - along) ** 2, 0.0))
        return np.asarray(away * across / along - 0.5 * (self._beam_mm or 0.0))

    @property
    def area_mm2(self) -> Floats:
        """The area of the sample's plane that each pixel sees [mm^2]: its solid angle at the lens, slanted."""
        scale = 1e-3 * self._camera_model.pixel_um / self._image_distance_mm
        lines = self._by_row[:, None, :] + self._by_col.T[None, :, :]
        cubed = np.einsum("...k,...k->...", lines, lines) ** -1.5  # of the cosine of the field angle
        slanted = np.abs(self._camera[2] / self.omega_r[..., 2]) ** 3 / abs(self._camera[2])
        return np.asarray(scale**2 * cubed * slanted)

    @cached_property
    def weight(self) -> Floats:
        """falloff cos(theta_i) (d0/d)^2 radiation, in the beam: all of the measurement equation that depends on the
        pixel alone.
        """
        weight = self.falloff * self.cos_theta_i * self.distance_factor
        if self._lambertian or self._beam is not None:
            weight = weight * self.radiation
        return weight if self._beam_mm is None else weight * self.lit

    @cached_property
    def omega_i(self) -> Floats:
        """Unit vectors from the spots to the source, shape (rows, columns, 3)."""
        return self._unit(self._source)

    @cached_property
    def omega_r(self) -> Floats:
        """Unit vectors from the spots to the camera, shape (rows, columns, 3)."""
        return self._unit(self._camera)

    def _unit(self, to: Floats) -> Floats:
        out = np.empty((*self.x_mm.shape, 3))
        out[..., 0] = to[0] - self.x_mm
        out[..., 1] = to[1] - self.y_mm
        out[..., 2] = to[2]
        out /= np.sqrt(np.einsum("...k,...k->...", out, out))[..., None]
        return out


def pixel_map(
    description: RigDescription, view: View, rows: slice = slice(None), cols: slice = slice(None)
) -> PixelMap:
    """What the pixels of a rectangle see of the sample's plane.

    Parameters
    ----------
    description
        The rig; its camera's pitch, focal length and size, and its distances.
    view
        Where source and camera are, and how the sensor's columns and rows run, in the sample's frame.
    rows, cols
        The rectangle (no step); the whole sensor when left out.
    """
    return PixelMap(description, view, rows, cols)


def _middle(camera: Camera) -> tuple[float, float]:
    """Column and row (fractional) of the principal point."""
    columns, rows = camera.principal_point_px
    return 0.5 * (camera.width - 1) + columns, 0.5 * (camera.height - 1) + rows


def _on_sensor(camera: Camera, image_distance: float, rows: slice, cols: slice) -> tuple[Floats, Floats]:
    """Places of columns and of rows on the sensor from the principal point, in image distances."""
    scale, (column, row) = 1e-3 * camera.pixel_um / image_distance, _middle(camera)
    return (np.arange(cols.start, cols.stop) - column) * scale, (np.arange(rows.start, rows.stop) - row) * scale


def _distorted(camera: Camera, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Where the lens images what a pinhole would image at (x, y), in image distances: Brown's model as OpenCV has it.

    Source: D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32, 444-462 (1966).
    """
    k1, k2, p1, p2, k3 = camera.distortion
    squared = x * x + y * y
    radial = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x),
        y * radial + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


STRAIGHT_STEPS = 100
ASTRAY = 1e3
STRAIGHT = 1e-12
"""In image distances: a millionth of a pixel, for any camera."""


@lru_cache(maxsize=8)
def _straightened(
    camera: Camera, image_distance: float, top: int, bottom: int, left: int, right: int
) -> tuple[Floats, Floats]:
    """Where a pinhole would image what each pixel sees, in image distances, each of shape (rows, columns)."""
    u, v = _on_sensor(camera, image_distance, slice(top, bottom), slice(left, right))
    x, y = _unbent(camera, *np.meshgrid(u, v))
    for each in (x, y):
        each.flags.writeable = False
    return x, y


def _unbent(camera: Camera, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """The inverse of `_distorted`, by fixed-point iteration."""
    x, y = u, v
    for _ in range(STRAIGHT_STEPS):
        bent_x, bent_y = _distorted(camera, x, y)
        x, y = x + (u - bent_x), y + (v - bent_y)
        off = max(np.abs(u - bent_x).max(initial=0.0), np.abs(v - bent_y).max(initial=0.0))
        if not STRAIGHT < off < ASTRAY:
            break
    if not off <= STRAIGHT:
        raise ConfigError(
            f"camera.distortion = {list(camera.distortion)} images several directions on one pixel of the frame: it "
            "holds for a smaller part of it; is it given for image coordinates in focal lengths, as OpenCV does?"
        )
    return x, y


@lru_cache(maxsize=8)
def _falloff(camera: Camera, image_distance: float, top: int, bottom: int, left: int, right: int) -> Floats:
    column, row = _middle(camera)
    v = (np.arange(top, bottom) - row) * 1e-3 * camera.pixel_um
    u = (np.arange(left, right) - column) * 1e-3 * camera.pixel_um
    radius_squared = v[:, None] ** 2 + u[None, :] ** 2
    out = np.ones(radius_squared.shape)
    if camera.cos4:
        out /= (1.0 + radius_squared / image_distance**2) ** 2
    if camera.vignetting:
        corner_squared = (0.5e-3 * camera.pixel_um) ** 2 * (camera.width**2 + camera.height**2)
        out *= 1.0 - camera.vignetting * (radius_squared / corner_squared) ** 2
    out.flags.writeable = False
    return out


@dataclass(frozen=True, slots=True)
class Roi:
    """The pixels that a BRDF value is the mean of: a rectangle of the sensor, and which of its pixels are used."""

    rows: slice
    cols: slice
    mask: npt.NDArray[np.bool_]
    """Shape of the rectangle."""

    @property
    def count(self) -> int:
        """Number of pixels used; at least one."""
        return int(np.count_nonzero(self.mask))

    def of(self, image: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """The used pixels of a whole frame, one-dimensional."""
        out: npt.NDArray[np.generic] = image[self.rows, self.cols][self.mask]
        return out

    def shared(self, other: Roi) -> int:
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
    x, y = _spots_of(description, view, box_rows, box_cols)
    x -= centre[0]
    y -= centre[1]
    x *= x
    y *= y
    distance = np.add(x, y, out=x)  # NaN where a pixel does not see the plane: it is inside of nothing
    if channel != "mono" and camera.pattern != "mono":
        distance[~of_channel(camera.pattern, channel, box_rows, box_cols)] = np.nan
    inside = distance <= radius**2
    if not inside.any():
        inside = distance <= max(longest**2, np.fmin.reduce(distance, axis=None, initial=np.inf))
    return Roi(box_rows, box_cols, inside)


def _spots_of(description: RigDescription, view: View, rows: slice, cols: slice) -> tuple[Floats, Floats]:
    """x and y [mm] of the spots of a rectangle inside the frame, as `PixelMap` has them; the caller's own arrays."""
    from gonio.rig._sight_lines import spots

    camera = description.camera
    if any(camera.distortion):
        seen = pixel_map(description, view, rows, cols)
        return seen.x_mm, seen.y_mm
    u, v = _on_sensor(camera, image_distance_mm(description), rows, cols)
    by_col, by_row = view.image_x[:, None] * u, view.optical_axis + v[:, None] * view.image_y
    out = np.empty((4, len(v), len(u)))
    spots(by_row, by_col, view.camera_mm, view.source_mm, description.geometry.light_distance_mm, *out)
    return out[0], out[1]


@lru_cache(1)
def _ring() -> Floats:
    """Cosines and sines of places once round the edge of a patch, shape (2, places)."""
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
    # pixels of one colour of a mosaic stand for all
    pattern = camera.pattern
    every = region.count * (1.0 if channel == "mono" or pattern == "mono" else len(pattern) / pattern.count(channel))
    out: Floats = falloff * (description.reference.attenuation or 1.0) / (area * every)
    return out


def straight_through_scale(description: RigDescription, view: View) -> float:
    """Area of a pixel in the plane in focus, times (D / (d_i d_r))^2, D being the way from lamp to lens [sr]."""
    g, apart = description.geometry, float(np.linalg.norm(np.asarray(view.source_mm) - np.asarray(view.camera_mm)))
    return pixel_on_focus_mm(description) ** 2 * (apart / (g.light_distance_mm * g.camera_distance_mm)) ** 2


def pixel_on_focus_mm(description: RigDescription) -> float:
    """Width of a pixel in the plane in focus, which faces the camera at the sample's centre [mm]."""
    pitch = 1e-3 * description.camera.pixel_um
    return pitch * description.geometry.camera_distance_mm / image_distance_mm(description)


def pixel_on_sample_mm(description: RigDescription, view: View) -> float:
    """The longer side of a pixel on the sample [mm], at its centre."""
    eye = np.asarray(view.camera_mm, dtype=float)
    distance = math.sqrt(eye.dot(eye))
    pitch = 1e-3 * description.camera.pixel_um * distance / image_distance_mm(description)
    return float(pitch * distance / abs(eye[2]))


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
    from gonio.rig._sight_lines import patch_extent as seen

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


def _centre(description: RigDescription, target: Target) -> tuple[float, float]:
    """Where a target's patch lies on the sample's plane [mm]."""
    reference = description.reference
    return reference.offset_mm if target == "reference" and reference.how == "beside" else (0.0, 0.0)


def _project(
    description: RigDescription, view: View, x: float | Floats, y: float | Floats
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Column and row (fractional) on which spots of the sample's plane fall; infinite for those behind the camera."""
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    return project(description, view, np.stack([x, y, np.zeros(x.shape)], axis=-1))


def project(
    description: RigDescription, view: View, points_mm: Floats
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Column and row (fractional) on which points fall; infinite for those behind the camera.

    `points_mm`: in the sample's frame, shape (..., 3).
    """
    camera, eye = description.camera, np.asarray(view.camera_mm, dtype=float)
    ray = np.asarray(points_mm, dtype=float) - eye
    depth = ray @ view.optical_axis
    depth = np.where(depth > 0.0, depth, np.nan)
    scale, (column, row) = image_distance_mm(description) / (1e-3 * camera.pixel_um), _middle(camera)
    if any(camera.distortion):
        u, v = _distorted(camera, ray @ np.asarray(view.image_x) / depth, ray @ np.asarray(view.image_y) / depth)
        columns, rows = scale * u + column, scale * v + row
    else:
        columns = scale * (ray @ np.asarray(view.image_x)) / depth + column
        rows = scale * (ray @ np.asarray(view.image_y)) / depth + row
    return np.where(depth > 0.0, columns, np.inf), np.where(depth > 0.0, rows, np.inf)


def place(description: RigDescription, view: View, target: Target) -> tuple[float, float]:
    """Column and row (fractional) on which the centre of a target's patch falls."""
    column, row = _project(description, view, *_centre(description, target))
    return float(column), float(row)


def spot(description: RigDescription, view: View, column: float, row: float) -> Floats:
    """Where the line of sight of a place on the sensor (fractional) meets the sample's plane, x and y [mm]."""
    camera, (middle_column, middle_row) = description.camera, _middle(description.camera)
    scale = 1e-3 * camera.pixel_um / image_distance_mm(description)
    u, v = np.array((column - middle_column) * scale), np.array((row - middle_row) * scale)
    if any(camera.distortion):
        u, v = _unbent(camera, u, v)
    line = view.optical_axis + u * view.image_x + v * view.image_y
    out: Floats = (view.camera_mm - line * (view.camera_mm[2] / line[2]))[:2]
    return out


def _span(extent: tuple[float, ...], size: int) -> slice:
    """The pixels between two fractional positions, with a margin of one Bayer cell, inside the frame."""
    lowest, highest = (min(max(edge, 0.0), size) for edge in extent)
    return slice(max(math.floor(lowest) - 2, 0), min(math.ceil(highest) + 3, size))


def of_channel(
    pattern: str, channel: Channel, rows: slice = slice(None), cols: slice = slice(None)
) -> npt.NDArray[np.bool_]:
    """Which pixels of a rectangle (with a start and a stop) carry a colour of a Bayer pattern in raster order.

    Every pixel does for the channel "mono", and on a sensor without a mosaic.
    """
    if channel == "mono" or pattern == "mono":
        return np.ones((max(rows.stop - rows.start, 0), max(cols.stop - cols.start, 0)), dtype=bool)
    i = np.arange(rows.start, rows.stop)[:, None] % 2
    j = np.arange(cols.start, cols.stop)[None, :] % 2
    return np.asarray(np.array(list(pattern)).reshape(2, 2)[i, j] == channel)
