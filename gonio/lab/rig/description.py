"""The description of a rig: what `RIG.toml` says, checked.

The same description drives the laboratory rig, the simulated one and the reduction of their frames. Everything in it is
what a laboratory knows of its instrument (distances, apertures, limits, the camera's data sheet, the reference's
certificate). Two kinds of key matter only to a simulated rig, which has to *produce* what a laboratory suffers:
`backlash_deg`, `drift_per_hour`, and a zero offset that is hidden (`zero_offset_known = false`).

An effect that is not named in the file is off. Angles are in degrees here (`_deg`), and radians everywhere in Python.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.config import Fraction, NonNegative, Positive, SmallAngle, Strict
from gonio.errors import ConfigError
from gonio.lab.rig.calibration_use import CalibrationUse
from gonio.lab.rig.health import Reading
from gonio.lab.rig.laboratory import Laboratory
from gonio.lab.rig.light_and_camera import Bands, Camera, Lamp
from gonio.lab.rig.polarisers import PolariserMounts
from gonio.samples.description import SampleDescription as SampleDescription
from gonio.typing import TomlTable


class Geometry(Strict):
    """Distances and bodies, seen from the sample's centre."""

    light_distance_mm: Positive = 1000.0
    camera_distance_mm: Positive = 1000.0
    light_body_radius_mm: NonNegative = 25.0
    camera_body_radius_mm: NonNegative = 30.0
    clearance_mm: NonNegative = 5.0
    """Closer than this no two bodies come to each other on their ways; see `Body`."""


Point = tuple[float, float, float]


class Body(Strict):
    """A body that moves with an axis, or stands on the bench: a capsule, or a box.

    Its frame is the lab's with every axis at 0: the origin on the sample's surface, z along the sample's normal and
    both arms, y along the axis that the arms turn about.
    """

    name: str
    on: Literal["bench", "light", "camera", "tilt", "spin"]
    """What carries it. What is on the tilt is not turned by the spin."""
    from_mm: Point | None = None
    to_mm: Point | None = None
    """A capsule: all that lies within `radius_mm` of the line between these two points."""
    radius_mm: Positive | None = None
    centre_mm: Point | None = None
    size_mm: tuple[Positive, Positive, Positive] | None = None
    """A box: its edges along x, y and z."""

    @model_validator(mode="after")
    def _one_shape(self) -> Body:
        keys = (self.from_mm, self.to_mm, self.radius_mm, self.centre_mm, self.size_mm)
        given = [value is not None for value in keys]
        if given not in ([True, True, True, False, False], [False, False, False, True, True]):
            raise ValueError(
                f'body "{self.name}" needs either from_mm, to_mm and radius_mm (a capsule), or centre_mm and size_mm '
                "(a box)"
            )
        return self


class Cable(Strict):
    """A cable between two parts of the rig, fixed at either end. Points are given as those of a `Body`."""

    name: str
    from_on: Literal["bench", "light", "camera", "tilt", "spin"]
    from_mm: Point
    to_on: Literal["bench", "light", "camera", "tilt", "spin"]
    to_mm: Point
    length_mm: Positive
    """Largest distance of the two ends, in a straight line."""
    radius_mm: NonNegative = 3.0
    sag_mm: NonNegative | None = None
    """How far the cable hangs, at most, beside the straight line between its ends. All that is so close to that line
    counts as a body. None: the cable is led (chain, reel, springs), and nothing runs into it."""

    @model_validator(mode="after")
    def _between_two(self) -> Cable:
        if self.from_on == self.to_on:
            raise ValueError(
                f'cable "{self.name}": both ends are on "{self.from_on}", where nothing moves them apart; a cable '
                "that only follows one part is one of its bodies"
            )
        return self


class Axis(Strict):
    """A rotary axis: its encoder, its mechanics, and how well its zero is known."""

    encoder_step_deg: NonNegative = 0.0
    encoder_noise_deg: NonNegative = 0.0
    """Standard deviation of readings around what zero, harmonics and the step say, from landing to landing."""
    backlash_deg: NonNegative = 0.0
    zero_offset_deg: float = 0.0
    """Encoder reading at the true zero, for an approach from below."""
    zero_offset_known: bool = True
    """True: the offset is subtracted from every reading. False: it is there, and nobody knows."""
    zero_u_deg: NonNegative = 0.0
    """Standard uncertainty of the zero after calibration; a simulated rig draws the remaining error from its seed."""
    speed_deg_per_s: Positive = 30.0


def _check_limits(name: str, limits: tuple[float, float], stops: tuple[float, float] | None) -> None:
    if limits[0] >= limits[1]:
        raise ValueError(f"{name}limits_deg must be [lower, upper] with lower < upper")
    if stops is not None and not stops[0] <= limits[0] < limits[1] <= stops[1]:
        raise ValueError(
            f"{name}hard_stops_deg = [{stops[0]:g}, {stops[1]:g}] must enclose {name}limits_deg = "
            f"[{limits[0]:g}, {limits[1]:g}]"
        )


def approach_start(goal: float, approach: float, lower: float, upper: float) -> float:
    """Where the last part of an axis's way to a goal begins: `approach` off it, inside the limits; all in one unit."""
    start = goal - approach
    return max(start, min(lower, goal)) if approach > 0 else min(start, max(upper, goal))


class ArmAxis(Axis):
    """The axis of an arm, with the range that it may turn in."""

    limits_deg: tuple[float, float] = (-90.0, 90.0)
    """Soft limits: no goal lies beyond them, and no way to a goal leads beyond them."""
    hard_stops_deg: tuple[float, float] | None = None
    """Where the axis meets metal, if it does: no reading can be beyond, and homing may look for it."""
    approach_deg: float | None = None
    """Instead of `acquisition.approach_deg`, for this axis."""
    harmonics_deg: tuple[tuple[Annotated[int, Field(ge=1)], float, float], ...] = ()
    """Errors of the encoder within its turn, rows [order k, C, S]. With r = reading - zero_offset_deg the true angle is
    r - sum(C cos(k r) + S sin(k r))."""
    axis_tilt_deg: tuple[SmallAngle, SmallAngle] = (0.0, 0.0)
    """Direction of the axis: the lab's y turned about the lab's z, then about its x (given as [about x, about z]). Of
    the azimuth axis: the lab's z turned about y, then about x, [about x, about y]."""
    axis_offset_mm: tuple[float, float] = (0.0, 0.0)
    """Where the axis passes by the crossing of the sample's axes: [x, z] in the lab; of the azimuth axis [x, y]."""
    elevation_deg: SmallAngle = 0.0
    """How far lamp or lens stands out of the plane perpendicular to the axis, positive toward the lab's y."""

    @model_validator(mode="after")
    def _ordered(self) -> ArmAxis:
        _check_limits("", self.limits_deg, self.hard_stops_deg)
        return self


class Arms(Strict):
    """The arms of lamp and camera."""

    light: ArmAxis = ArmAxis()
    camera: ArmAxis = ArmAxis()
    azimuth: ArmAxis | None = None
    """The axis that carries the camera arm around the sample normal, where the rig has one."""

    def axes(self) -> dict[str, ArmAxis]:
        """Those that there are, by name."""
        own = {"light": self.light, "camera": self.camera}
        return own if self.azimuth is None else own | {"azimuth": self.azimuth}

    @model_validator(mode="after")
    def _sound(self) -> Arms:
        if self.azimuth is not None and self.azimuth.elevation_deg:
            raise ValueError("azimuth.elevation_deg: nothing stands on this axis but the camera arm; give that one's")
        return self


class Fiducials(Strict):
    """Square markers printed around the holder's aperture, in the plane of the sample's surface.

    Their centres lie on a circle around the sample's centre, the first on the sample's x axis, then counterclockwise
    at equal angles. Every marker stands upright: its top edge toward the sample's y.
    """

    dictionary: str = "DICT_APRILTAG_36h11"
    """A name of OpenCV's."""
    first_id: Annotated[int, Field(ge=0)] = 0
    """Ids count up from it."""
    count: Annotated[int, Field(ge=3, le=64)] = 8
    marker_mm: Positive = 6.0
    """Side of the black square."""
    ring_mm: Positive = 18.0
    """Radius of the circle of their centres."""
    albedo: Fraction = 0.8
    """Albedo of the paper; the black is as `holder.holder_albedo` (simulation)."""

    @model_validator(mode="after")
    def _apart(self) -> Fiducials:
        least = 1.2 * math.sqrt(2.0) * self.marker_mm  # two squares with a white rim, however they stand
        if 2.0 * self.ring_mm * math.sin(math.pi / self.count) < least:
            raise ValueError(
                f"{self.count} markers of {self.marker_mm:g} mm do not fit on a circle of radius {self.ring_mm:g} mm"
            )
        return self


class Holder(Axis):
    """The sample holder: a tilt axis that lies in the plane of the arms, and a spin about the sample's normal."""

    axes: tuple[Literal["tilt", "spin"], ...] = ()
    tilt_limits_deg: tuple[float, float] = (-80.0, 80.0)
    spin_limits_deg: tuple[float, float] = (-180.0, 180.0)
    """May be wider than a turn: as far as the cables let the sample wind."""
    tilt_hard_stops_deg: tuple[float, float] | None = None
    spin_hard_stops_deg: tuple[float, float] | None = None
    tilt_approach_deg: float | None = None
    """Instead of `acquisition.approach_deg`, for the tilt."""
    spin_approach_deg: float | None = None
    tilt_zero_offset_deg: float | None = None
    """Instead of `zero_offset_deg`, which is that of both axes."""
    spin_zero_offset_deg: float | None = None
    surface_offset_mm: float = 0.0
    """How far the sample's surface lies before the crossing of the axes, along its normal."""
    surface_tilt_deg: tuple[SmallAngle, SmallAngle] = (0.0, 0.0)
    """The surface against the spin axis, with which it turns: turned about its own y, then about its x, given as
    [about x, about y]. Its normal wobbles when the sample is spun."""
    sample_offset_mm: tuple[float, float] = (0.0, 0.0)
    """Centre of the sample (of its aperture) beside the spin axis, along the sample's x and y."""
    spin_axis_tilt_deg: SmallAngle = 0.0
    """How far the spin axis leans toward the tilt axis (the lab's x) from standing upright on it."""
    tilt_axis_offset_mm: float = 0.0
    """How far the tilt axis passes by the spin axis, along the lab's y."""
    sample_diameter_mm: Positive = 20.0
    holder_albedo: Fraction = 0.03
    fiducials: Fiducials | None = None
    """Printed markers around the aperture (`gonio calibrate geometry --print-fiducials`)."""

    def of(self, name: str) -> Holder:
        """The holder as one of its axes, "tilt" or "spin", has it."""
        own: float | None = getattr(self, f"{name}_zero_offset_deg")
        return self if own is None else self.model_copy(update={"zero_offset_deg": own})

    @model_validator(mode="after")
    def _sound(self) -> Holder:
        if len(set(self.axes)) < len(self.axes):
            raise ValueError("axes names an axis twice")
        for name in ("tilt", "spin"):
            _check_limits(f"{name}_", getattr(self, f"{name}_limits_deg"), getattr(self, f"{name}_hard_stops_deg"))
        marks = self.fiducials
        if marks is not None and marks.ring_mm - 0.75 * marks.marker_mm < 0.5 * self.sample_diameter_mm:
            raise ValueError(
                f"fiducials.ring_mm = {marks.ring_mm:g} with markers of {marks.marker_mm:g} mm reaches into the sample "
                f"(sample_diameter_mm = {self.sample_diameter_mm:g})"
            )
        return self


Reflectance = Annotated[float, Field(gt=0, le=1)]
"""Of a white: a black one tells nothing."""


class Reference(Strict):
    """The white reference: how it is reached, and what its certificate says."""

    name: str | None = None
    """Which white it is, as on its certificate: tables of one white share its error (docs/laboratories.md)."""
    how: Literal["beside", "axis", "swap", "beam"] = "swap"
    """"beam": no white at all. The holder is empty, and the camera looks into the lamp through `attenuation`."""
    albedo: Reflectance | None = 0.99
    table: str | None = None
    """A measurement table of the reference's BRDF, instead of a Lambertian albedo; a path beside the rig file."""
    u_rel: NonNegative = 0.0
    certificate: str | None = None
    """A digital calibration certificate (DCC, XML) that says both, instead of them; a path beside the rig file."""
    certificate_quantity: str | None = None
    """Which of the certificate's quantities is meant, by a part of its name or its id; where there are several."""
    spectrum: tuple[tuple[Positive, Reflectance, NonNegative], ...] = ()
    """[nm, albedo, relative standard uncertainty] where a certificate has several wavelengths; linear in between."""
    error: Literal["drawn", "none"] = "none"
    """Simulation: draw the reference's true error from the seed, or have none."""
    scale: Positive = 1.0
    """Simulation, in a `truth` file alone: true reflectance over the certified one."""
    attenuation: Annotated[float, Field(gt=0, le=1)] | None = None
    """`beam`: transmittance of the attenuator through which the camera looks into the lamp."""
    theta_i_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    theta_r_deg: Annotated[float, Field(gt=-90, lt=90)] = 45.0
    every: Annotated[int, Field(ge=0)] = 25
    """Points between two visits; 0 for visits at the start and at the end only."""
    frames: Annotated[int, Field(ge=1)] = 8
    offset_mm: tuple[float, float] = (0.0, 0.0)
    """`beside`: centre of the reference on the sample's plane, in the sample's x and y."""
    diameter_mm: Positive = 20.0

    @model_validator(mode="after")
    def _attenuated(self) -> Reference:
        if (self.how == "beam") != (self.attenuation is not None):
            raise ValueError(
                'how = "beam" and attenuation go together: attenuation is the transmittance of the filter through '
                "which the camera looks into the lamp (1 without a filter)"
            )
        return self

    def at(self, wavelength_nm: float) -> tuple[float | None, float]:
        """The albedo at a wavelength [nm], where it is known, and the relative standard uncertainty.

        Raises
        ------
        ConfigError
            The certificate does not reach there.
        """
        if not self.spectrum:
            return self.albedo, self.u_rel
        first, last = self.spectrum[0][0], self.spectrum[-1][0]
        if not first <= wavelength_nm <= last:
            raise ConfigError(
                f"{self.certificate or 'reference.spectrum'}: certifies {first:g} to {last:g} nm, and a band lies at "
                f"{wavelength_nm:g} nm; leave that band out, or give a certificate that has it"
            )
        waves, albedo, u_rel = np.array(self.spectrum).T
        return float(np.interp(wavelength_nm, waves, albedo)), float(np.interp(wavelength_nm, waves, u_rel))


class Acquisition(Strict):
    """How a point is measured on this rig."""

    roi_radius_mm: Positive = 0.8
    """Radius of the patch of the sample, around its centre, that a BRDF value is the mean of."""
    approach_deg: float = 1.0
    """Every axis arrives from this far below its goal, so that backlash always lies on the same side; negative: from
    above. Near a limit on that side the way is shorter: it never passes the limit."""
    exposure_target: Annotated[float, Field(gt=0.05, lt=0.95)] = 0.6
    """Where the brightest used pixel should lie, as a fraction of full scale."""
    frames: Annotated[int, Field(ge=1)] = 2
    """Frames at the chosen exposure; a shorter one always follows them."""
    dark_frames: Annotated[int, Field(ge=1)] = 8
    u_rel_target: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Relative standard uncertainty (k = 1) that the noise may leave of the rate of a point or of a visit. Exposures
    and numbers of frames are planned for it. None: `frames` of them, whatever comes of it."""
    longest_point_s: Positive = 120.0
    """Time that a planned bracket may take in one band, metering apart; where it is too short the target is missed."""
    merge: Literal["frames", "pixels"] = "frames"
    """How frames of a step become one rate: whole frames, or pixel by pixel, with hits of cosmic radiation and hot
    pixels left out. A planned bracket is always merged by pixels."""

    @property
    def by_pixels(self) -> bool:
        """Whether frames are merged pixel by pixel."""
        return self.merge == "pixels" or self.u_rel_target is not None


ROOM_LIGHT = "room_light"
"""A quantity that is measured by a frame with the lamp off [DN/s]: its mean over the black level, by its exposure."""


class Suspender(Strict):
    """A rule that pauses a run: a quantity of the rig's health beyond a threshold, and how it has to come back."""

    quantity: str
    """"temperature", "current", "load", "voltage", "monitor", "lock", or what else the rig reads; or "room_light"."""
    device: str | None = None
    """"light", "camera", "lamp", ...; None for every device that has the quantity."""
    above: float | None = None
    below: float | None = None
    unless: str | None = None
    """For a quantity that is a word: the only one that is good, as "locked"."""
    hysteresis: NonNegative = 0.0
    """How far behind the threshold the quantity has to come back before the run goes on."""
    longest_s: Positive = 1800.0
    """How long the run waits at most; then it ends, and can be resumed."""
    dark: bool = False
    """The lamp is dark while the run waits."""

    @model_validator(mode="after")
    def _one_threshold(self) -> Suspender:
        if [self.above, self.below, self.unless].count(None) != 2:
            raise ValueError("needs one of above, below and unless")
        if self.dark and (self.device == "lamp" or self.quantity in ("monitor", "lock")):
            raise ValueError("dark = true: how the lamp shines cannot be seen in the dark; leave the key out")
        return self

    def concerns(self, reading: Reading) -> bool:
        """Whether a reading is one that the rule is about: its quantity, or the extreme of it since the last step."""
        extreme = f"{self.quantity}_max" if self.above is not None else f"{self.quantity}_min"
        return reading.quantity in (self.quantity, extreme) and self.device in (None, reading.device)

    def breaks(self, value: float | str, back: float = 0.0) -> bool:
        """Whether a value is beyond the threshold, drawn nearer by `back`; what is no number where one is needed is."""
        if self.unless is not None:
            return value != self.unless
        if isinstance(value, str):
            return True
        return not (value <= self.above - back if self.above is not None else value >= (self.below or 0.0) + back)

    def badness(self, reading: Reading) -> float:
        """The larger, the further beyond the threshold."""
        if isinstance(reading.value, str):
            return float("inf")
        return reading.value if self.above is not None else -reading.value

    def words(self, back: float = 0.0) -> str:
        """The threshold in words."""
        if self.unless is not None:
            return f'anything but "{self.unless}"'
        return f"above {self.above - back:g}" if self.above is not None else f"below {(self.below or 0.0) + back:g}"


class RigDescription(Strict):
    """A whole rig file."""

    rig: str
    """The entry point (group `gonio.rigs`) that drives it."""
    name: str
    geometry: Geometry = Geometry()
    arms: Arms = Arms()
    holder: Holder = Holder()
    lamp: Lamp = Lamp()
    camera: Camera = Camera()
    polarisers: PolariserMounts = PolariserMounts()
    """Before the lamp, before the camera, or both."""
    reference: Reference = Reference()
    bands: Bands
    acquisition: Acquisition = Acquisition()
    suspend: dict[str, Suspender] = Field(default_factory=dict)
    """What pauses a run, by a name of the user's (`gonio.lab.acquisition.waits`)."""
    bodies: tuple[Body, ...] = ()
    """What could touch on its way. Where there are any, the two balls of `geometry` belong to them."""
    cables: tuple[Cable, ...] = ()
    """What could be torn on its way, or caught."""
    devices: TomlTable = Field(default_factory=dict)
    """Ports, ids and dialects: checked by the rig's own driver."""
    calibration: CalibrationUse = CalibrationUse()
    laboratory: Laboratory | None = None
    """Whose rig it is; a run has it under its own name, with what the plan says."""
    truth: str | None = None
    """Simulation: a file of rig keys, beside the rig file, that says what is true of the rig and that nobody knows
    who measures there. The simulated devices read it; nothing that plans, measures or reduces does."""

    def axes(self) -> dict[str, Axis]:
        """The axes that this rig has, by the name of their field in a `gonio.lab.rig.protocols.Pose`, in the order of
        those fields.

        Tilt and spin are both `holder`, each with its own zero where it has one.
        """
        arms = self.arms.axes()
        out: dict[str, Axis] = {"light": arms["light"], "camera": arms["camera"]}
        out |= {name: self.holder.of(name) for name in ("tilt", "spin") if name in self.holder.axes}
        return out | arms

    def _by_axis(self, key: str) -> dict[str, Any]:
        """A key of each of `axes`; tilt and spin have theirs in the table of the holder."""
        return {n: getattr(axis, key if isinstance(axis, ArmAxis) else f"{n}_{key}") for n, axis in self.axes().items()}

    def limits_deg(self) -> dict[str, tuple[float, float]]:
        """The range of each of `axes` [deg]."""
        return self._by_axis("limits_deg")

    def hard_stops_deg(self) -> dict[str, tuple[float, float] | None]:
        """Where each of `axes` meets metal [deg]; None where it does not, or nobody has said."""
        return self._by_axis("hard_stops_deg")

    def approach_deg(self) -> dict[str, float]:
        """From how far below its goal each of `axes` arrives [deg]; negative: from above."""
        own = self._by_axis("approach_deg")
        return {n: self.acquisition.approach_deg if value is None else value for n, value in own.items()}

    def approach_starts_deg(self, name: str, goal_deg: float) -> float:
        """Where an axis begins the last part of its way to a goal [deg]: `approach_deg` off it, inside the limits."""
        return approach_start(goal_deg, self.approach_deg()[name], *self.limits_deg()[name])

    @property
    def looks_ahead(self) -> bool:
        """Whether the file names anything that could touch, or be torn, on a way."""
        return bool(self.bodies or self.cables)

    @property
    def as_meant(self) -> bool:
        """Whether the file names no error of alignment that a view of the sample depends on; encoders apart."""
        holder, camera, none = self.holder, self.camera, (0.0, 0.0)
        return (
            all(
                axis.axis_tilt_deg == none and axis.axis_offset_mm == none and not axis.elevation_deg
                for axis in self.arms.axes().values()
            )
            and not (holder.surface_offset_mm or holder.spin_axis_tilt_deg or holder.tilt_axis_offset_mm)
            and holder.surface_tilt_deg == holder.sample_offset_mm == none
            and not camera.roll_deg
            and camera.pointing_deg == none
        )

    @model_validator(mode="after")
    def _lens_focuses(self) -> RigDescription:
        if self.camera.focal_length_mm >= self.geometry.camera_distance_mm:
            raise ValueError(
                f"camera.focal_length_mm = {self.camera.focal_length_mm:g} must be smaller than "
                f"geometry.camera_distance_mm = {self.geometry.camera_distance_mm:g}: "
                "this lens cannot focus on the sample"
            )
        return self
