"""Which spot of the sample each pixel sees, and how the light falls on it: pure geometry of a view.

The camera is a pinhole in the middle of its lens, focused on the sample's centre. The simulated camera calls this
with the true view, the reduction with the view that the encoders read, so that both sides share one set of formulas
and differ only in what they know. Everything is in the sample's frame: origin at its centre, z its normal.
"""

import math
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from gonio.errors import ConfigError
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import View
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.protocols import Target
from gonio.typing import Bools, Floats

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
        from gonio.lab.rig._sight_lines import spots

        if any(self._camera_model.distortion):
            return self._spots_of_bent_lines()
        out = np.empty((4, self._by_row.shape[0], self._by_col.shape[1]))
        spots(self._by_row, self._by_col, self._camera, self._source, self._distance_mm, *out)
        return out[0], out[1], out[2], out[3]

    def _spots_of_bent_lines(self) -> tuple[Floats, Floats, Floats, Floats]:
        """As `gonio.lab.rig._sight_lines.spots`, for lines of sight through a lens with distortion."""
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
    def sees_plane(self) -> Bools:
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
        out = np.ones(self.x_mm.shape)
        if self._lambertian:
            (sx, sy, _), squared = self._source, float(self._source @ self._source)
            across = (sx * self.x_mm + sy * self.y_mm) / squared
            away = np.sqrt(squared * self.distance_factor) / self._distance_mm  # |S| / |S - x|
            out = np.where(self.sees_plane, np.maximum((1.0 - across) * away, 0.0), 0.0)
        if self._beam is not None:
            (x, y), (a, b, aa, ab, bb) = self.beam_xy_mm, self._beam
            log = a * x + b * y + aa * x**2 + ab * x * y + bb * y**2
            out = out * np.where(self.sees_plane, np.exp(np.minimum(log, 1.0)), 0.0)
        return out

    @property
    def beam_xy_mm(self) -> tuple[Floats, Floats]:
        """Where the ray from the lamp to the spot crosses the plane that faces the lamp (`Beam`) [mm]."""
        distance = float(np.linalg.norm(self._source))
        toward = self._source / distance
        along = np.cross(self._beam_y, toward)
        stretch = distance / (distance - toward[0] * self.x_mm - toward[1] * self.y_mm)
        x, y = ((e[0] * self.x_mm + e[1] * self.y_mm) * stretch for e in (along, self._beam_y))
        return x, y

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
        out = np.stack([to[0] - self.x_mm, to[1] - self.y_mm, np.full(self.x_mm.shape, to[2])], axis=-1)
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
"""Tolerance in image distances: a millionth of a pixel, for any camera."""


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


def _centre(description: RigDescription, target: Target) -> tuple[float, float]:
    """Where a target's patch lies on the sample's plane [mm]."""
    reference = description.reference
    return reference.offset_mm if target == "reference" and reference.how == "beside" else (0.0, 0.0)


def _project(description: RigDescription, view: View, x: float | Floats, y: float | Floats) -> tuple[Floats, Floats]:
    """Column and row (fractional) on which spots of the sample's plane fall; infinite for those behind the camera."""
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    return project(description, view, np.stack([x, y, np.zeros(x.shape)], axis=-1))


def project(description: RigDescription, view: View, points_mm: Floats) -> tuple[Floats, Floats]:
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
    return np.asarray((view.camera_mm - line * (view.camera_mm[2] / line[2]))[:2])


def of_channel(pattern: str, channel: Channel, rows: slice = slice(None), cols: slice = slice(None)) -> Bools:
    """Which pixels of a rectangle (with a start and a stop) carry a colour of a Bayer pattern in raster order.

    Every pixel does for the channel "mono", and on a sensor without a mosaic.
    """
    if channel == "mono" or pattern == "mono":
        return np.ones((max(rows.stop - rows.start, 0), max(cols.stop - cols.start, 0)), dtype=bool)
    i = np.arange(rows.start, rows.stop)[:, None] % 2
    j = np.arange(cols.start, cols.stop)[None, :] % 2
    return np.asarray(np.array(list(pattern)).reshape(2, 2)[i, j] == channel)


def pixels_for_each(pattern: str, channel: Channel) -> float:
    """For how many pixels of a Bayer pattern each of a colour stands: 1 for the channel "mono", or without a mosaic."""
    return 1.0 if channel == "mono" or pattern == "mono" else len(pattern) / pattern.count(channel)
