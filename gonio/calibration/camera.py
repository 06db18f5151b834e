"""From frames of dark, white, trap and edge to the camera's keys of the rig file (docs/calibrate_camera.md)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.calibration import black_frames, linearity, photon_transfer, pixel_statistics, response, vignetting
from gonio.calibration.camera_frames import CameraFrame
from gonio.documents import TomlTable
from gonio.errors import DataError
from gonio.reduction.stray_light import spread
from gonio.rig import Pose
from gonio.rig.calibrated import Calibration
from gonio.rig.calibration_use import ParameterUncertainty
from gonio.rig.description import RigDescription
from gonio.rig.imaging import Channel, of_channel
from gonio.rig.light_and_camera import Camera
from gonio.rig.sensor_response import PixelMaps, linear_dn, straightened
from gonio.typing import Floats

CLIPPED = 1e-3
"""Part of the pixels of dark frames that may read 0 DN: beyond it their noise is cut off."""
BRIGHT = 0.9
"""Of the brightest part of the flats: pixels above it are the region of the photon transfer."""
PARTS = (BRIGHT, 0.45, 0.2, 0.09, 0.04, 0.02, 0.01)
"""Edges of the parts of other brightness, from which the linearity is determined."""
FEWEST_PIXELS = 200
UNDETERMINED = 0.05
"""Standard uncertainty of `vignetting` from which on it is not: lenses lose a tenth or two at the corners."""
LEVEL = 0.9
"""Of saturation: frames above are not used for the linearity."""
LEAST_DN = 2.0
"""Of a part's signal."""
PAIR = 5.0
"""Standard deviations of the lamp's noise that the frames of a pair may differ by, beyond half a per cent."""
BIASED_PAIR = 0.005
MAP_LEVELS = 0.2, 0.8
"""Of the brightest flats: flats of which the map of responsivities is made."""
NOT_BLACK = 0.25
"""Share of the mean that a lens may spread: from here on it is no lens, but something bright where black should be."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class CameraCalibration:
    """What came out."""

    values: TomlTable
    """Keys of the rig file's table [camera]."""
    names: list[str]
    """Of the numbers with uncertainties, as `nonlinearity[0]`."""
    covariance: Floats
    notes: list[str]
    measured: TomlTable
    maps: PixelMaps | None
    transfer: photon_transfer.PhotonTransfer | None
    curve: linearity.Linearity | None
    darks: Floats
    """Exposure [s], mean [DN] of each dark frame: shape (2, n)."""

    def file(self, description: RigDescription, *, valid_days: int | None, maps: str | None) -> Calibration:
        """The calibration file; `maps` is the name of the maps' file beside it."""
        known = ParameterUncertainty.of([f"camera.{name}" for name in self.names], self.covariance)
        rounded = {"u": [_rounded(u) for u in known.u], "correlation": np.round(known.correlation, 6).tolist()}
        return Calibration.made_today(
            "camera", description, valid_days,
            values={"camera": self.values | ({"maps": maps} if maps is not None and self.maps is not None else {})},
            uncertainty=known.model_copy(update=rounded), measured=self.measured, notes=self.notes,
        )  # fmt: skip


def calibrate(
    frames: Sequence[CameraFrame], description: RigDescription, channel: Channel = "mono"
) -> CameraCalibration:
    """Reduce frames to a calibration.

    Parameters
    ----------
    frames
        Dark frames of two or more exposures; flats in pairs, at exposures from dark to full; frames of trap and edge,
        where stray light is wanted. Each is read when it is needed.
    description
        The rig; of its camera size, pattern, bits and response curve count, and of its lamp the noise.
    channel
        Of a Bayer sensor: the colour of the lit band.

    Raises
    ------
    DataError
        Frames are missing, full, cut off at 0 DN, or do not go together; the message says which.
    """
    return _Work(frames, description, channel).done()


def calibrate_response(frames: Sequence[CameraFrame], description: RigDescription) -> CameraCalibration:
    """The response curve of a camera of 8 bits, from flats of one still scene at several exposures."""
    camera = description.camera
    flats = [frame for frame in frames if frame.kind == "flat"]
    if camera.bits != 8:
        raise DataError(f"camera.bits = {camera.bits}: a response curve is for cameras of 8 bits")
    if not flats:
        raise DataError("there are no flat frames: a response curve needs a bracket of exposures")
    images = [frame.read(camera) for frame in flats]
    curve = response.curve(images, np.array([frame.exposure_s for frame in flats]))
    notes = ["the noise of a camera with a response curve is not measured: that of the rig file stays"]
    values = {"response": [float(f"{value:.6g}") for value in curve]}
    values["response"][-1] = 255.0
    return CameraCalibration(
        values, [], np.zeros((0, 0)), notes, {"flats": len(flats)}, None, None, None, np.zeros((2, 0))
    )


class _Work:
    """The passes over the frames, and what each leaves for the next."""

    def __init__(self, frames: Sequence[CameraFrame], description: RigDescription, channel: Channel) -> None:
        self.description = description
        self.camera, self.lamp, self.channel = description.camera, description.lamp, channel
        # what is measured is not to be taken out before
        self.raw = self.camera.model_copy(update={"nonlinearity": (), "stray_light": 0.0, "stray_halo": 0.0})
        self.of = {kind: [f for f in frames if f.kind == kind] for kind in ("dark", "flat", "trap", "edge", "field")}
        shape = self.camera.height, self.camera.width
        self.colour = of_channel(self.camera.pattern, channel, slice(0, shape[0]), slice(0, shape[1]))
        self.notes: list[str] = []

    def read(self, frame: CameraFrame) -> Floats:
        return np.asarray(linear_dn(self.camera, frame.read(self.camera)), dtype=float)

    # ---- dark frames ----

    def darks(self) -> None:
        """Each pixel's line over exposure, defects, pairs, and the level of the frame."""
        taken = self.of["dark"]
        exposures = sorted({f.exposure_s for f in taken})
        if len(exposures) < 2 or any(sum(f.exposure_s == t for f in taken) < 2 for t in exposures):
            raise DataError(
                f"there are {len(taken)} dark frames of {len(exposures)} exposures; two exposures with two "
                f"frames each are "
                "needed (lamp off, lens covered): a short one, and the longest that is used"
            )
        count = len(taken)
        t = np.array([f.exposure_s for f in taken])
        total, first = np.zeros(self.colour.shape), np.zeros(self.colour.shape)
        zero = 0.0
        for f in taken:
            image = f.read(self.camera)
            zero += float(np.mean(image == 0)) / count
            values = np.asarray(linear_dn(self.camera, image), dtype=float)
            total += values
            first += (f.exposure_s - t.mean()) * values
        if CLIPPED < zero < 1.0:
            raise DataError(
                f"{100 * zero:.2g} % of the pixels of the dark frames read 0 DN: what lies below is cut off, "
                f"and neither "
                "noise nor dark level can be determined; raise the camera's black level"
            )
        self.dark_mean, self.dark_t = total / count, float(t.mean())
        self.dark_slope = first / float(np.sum((t - t.mean()) ** 2))
        short = self.dark_mean - self.dark_slope * self.dark_t
        self.defects = pixel_statistics.outliers(self.dark_slope) | pixel_statistics.outliers(short)
        good = self.colour & ~self.defects
        self.good = good
        means, pairs, temperatures = [], [], []
        for exposure in exposures:
            group = [f for f in taken if f.exposure_s == exposure]
            images = [self.read(f)[good] for f in group]
            means += [(f.exposure_s, float(image.mean())) for f, image in zip(group, images, strict=True)]
            temperatures += [f.temperature_c for f in group]
            pairs += [photon_transfer.pair(a, b, exposure) for a, b in zip(images[::2], images[1::2], strict=False)]
        self.dark_pairs, self.dark_means, self.temperatures = pairs, np.array(means).T, np.array(temperatures)
        x, y = self.dark_means
        away = x - x.mean()
        slope = float(np.sum(away * y) / np.sum(away**2))
        level = float(y.mean()) - slope * float(x.mean())
        scatter = float(np.sqrt(np.sum((y - level - slope * x) ** 2) / max(count - 2, 1)))
        self.level, self.slope = level, slope
        self.u_slope = scatter / float(np.sqrt(np.sum(away**2)))
        self.u_level = scatter * math.sqrt(1.0 / count + float(x.mean() ** 2 / np.sum(away**2)))

    def dark_at(self, exposure_s: float) -> Floats:
        return self.dark_mean + self.dark_slope * (exposure_s - self.dark_t)

    def _noise_of_line(self, exposure_s: float) -> float:
        """Temporal variance [DN^2] of a pixel's dark line at an exposure: of the frames that it is made of."""
        return self._noise_and_u(exposure_s)[0]

    def _noise_and_u(self, exposure_s: float) -> tuple[float, float]:
        """That variance, and its standard uncertainty."""
        x = self.dark_means[0]
        share = (1.0 / len(x) + (exposure_s - x.mean()) * (x - x.mean()) / np.sum((x - x.mean()) ** 2)) ** 2
        variance = u_square = 0.0
        for t in set(x):
            pairs, weight = [p for p in self.dark_pairs if p.exposure_s == t], float(np.sum(share[x == t]))
            variance += weight * float(np.mean([p.variance_dn2 for p in pairs]))
            u_square += weight**2 * float(np.sum([p.u_variance**2 for p in pairs])) / len(pairs) ** 2
        return variance, math.sqrt(u_square)

    def uneven_darks(self) -> tuple[pixel_statistics.Unevenness, float, Floats]:
        """Unevenness of the dark level at no exposure [DN], the standard uncertainty of its total, and the level."""
        bias = self.dark_mean - self.dark_slope * self.dark_t
        filled = np.where(self.defects, float(np.median(bias)), bias)
        temporal, u_temporal = self._noise_and_u(0.0)
        uneven = pixel_statistics.unevenness(filled, temporal)
        u_variance = math.hypot((uneven.total**2 + temporal) * math.sqrt(2.0 / filled.size), u_temporal)
        return uneven, u_variance / (2.0 * max(uneven.total, math.sqrt(u_variance))), filled

    # ---- flat frames ----

    def flats(self) -> None:
        """Parts of the picture, levels of every frame, and pairs over the brightest part."""
        taken = self.of["flat"]
        if len(taken) < 2 * photon_transfer.FEWEST_LEVELS:
            raise DataError(
                f"there are {len(taken)} flat frames; pairs at {photon_transfer.FEWEST_LEVELS} exposures and "
                f"more are needed"
            )
        if len({f.exposure_s for f in taken}) < photon_transfer.FEWEST_LEVELS:
            raise DataError(
                f"the flat frames have {len({f.exposure_s for f in taken})} exposures; at least "
                f"{photon_transfer.FEWEST_LEVELS} from dark to full are needed: flats of one level tell no line"
            )
        tops: dict[float, float] = {}
        for f in taken:
            tops.setdefault(f.exposure_s, float(np.percentile(self.read(f)[self.good], 99.0)) - self.level)
        # of the converter, or of a well that fills up before
        white = self.camera.white_level_dn - self.level
        self.full = min(white, max(tops.values()))
        inside = {t: top for t, top in tops.items() if top < 0.7 * self.full}
        if min(tops.values()) > 0.9 * white or not inside:
            raise DataError(
                "every flat frame is full: take flats at shorter exposures, from a few per cent of full scale on"
            )
        if max(inside.values()) < 0.05 * white:
            raise DataError(
                f"the brightest flat frames reach {100 * max(tops.values()) / white:.1f} % of full scale: light "
                f"the white "
                "reference more, or expose longer"
            )
        middle = max(inside, key=lambda t: inside[t])
        picture = np.mean([self.read(f) for f in taken if f.exposure_s == middle], axis=0) - self.dark_at(middle)
        top = float(np.percentile(picture[self.good], 99.0))
        # noise must not choose the pixels
        even = pixel_statistics.smooth(picture, self.good, 2.0)
        edges = [math.inf, *(part * top for part in PARTS)]
        masks = [self.good & (even < high) & (even >= low) for high, low in pairwise(edges)]
        self.bright, self.even = masks[0], even
        self.masks = [mask for mask in masks if np.count_nonzero(mask) >= FEWEST_PIXELS]
        if np.count_nonzero(self.bright) < FEWEST_PIXELS:
            raise DataError("the flat frames hold no even bright part: is the white reference in view, and in focus?")
        self._levels(taken)

    def _levels(self, taken: list[CameraFrame]) -> None:
        parts = len(self.masks)
        darks = [(self.dark_mean[m].mean(), self.dark_slope[m].mean()) for m in self.masks]
        self.u_dark_dn = np.array([math.sqrt(self._noise_of_line(0.0) / np.count_nonzero(m)) for m in self.masks])
        level, u = np.full((2, parts, len(taken)), math.nan)
        self.pairs: list[photon_transfer.Pair] = []
        limit = PAIR * math.sqrt(2.0) * self.lamp.noise + BIASED_PAIR
        sums, of_map = np.zeros(self.colour.shape), []
        dropped = 0
        waiting: dict[float, tuple[int, Floats]] = {}
        for k, f in enumerate(taken):
            image = self.read(f)
            for b, mask in enumerate(self.masks):
                values = image[mask]
                dark, slope = darks[b]
                level[b, k] = values.mean() - dark - slope * (f.exposure_s - self.dark_t)
            mean = level[0, k]
            if MAP_LEVELS[0] * self.full <= mean <= MAP_LEVELS[1] * self.full:
                sums += image - self.dark_at(f.exposure_s)
                of_map.append(f.exposure_s)
            other = waiting.pop(f.exposure_s, None)
            if other is None:
                waiting[f.exposure_s] = (k, image)
                continue
            first, before = other
            for b, mask in enumerate(self.masks):
                found = photon_transfer.pair(before[mask], image[mask], f.exposure_s)
                u[b, [first, k]] = math.sqrt(max(found.variance_dn2, 0.05) / found.pixels)
            found = photon_transfer.pair(before[self.bright], image[self.bright], f.exposure_s)
            apart = abs(level[0, first] - level[0, k]) / max(mean, 1.0)
            if apart > limit + 5.0 * math.sqrt(2.0) * u[0, k] / max(mean, 1.0):
                dropped += 1
                self.notes.append(
                    f"{f.path.name} and {taken[first].path.name} differ by {100 * apart:.2g} % and are left "
                    f"out: the lamp is "
                    f"taken to be steady within {100 * limit:.2g} % (lamp.noise)"
                )
                level[:, [first, k]] = math.nan
                continue
            self.pairs.append(found)
        for left, _ in waiting.values():
            level[:, left] = math.nan
        if waiting:
            self.notes.append(f"{len(waiting)} flat frames have no second one of their exposure and are left out")
        if dropped > 0.5 * (dropped + len(self.pairs)):
            raise DataError(
                f"{dropped} of {dropped + len(self.pairs)} pairs of flat frames differ by more than "
                f"{100 * limit:.2g} %: the "
                "lamp drifts or flickers more than lamp.noise says; let it warm up, or give its noise in the rig file"
            )
        if len({p.exposure_s for p in self.pairs}) < photon_transfer.FEWEST_LEVELS:
            raise DataError(
                f"there are pairs of flat frames at {len({p.exposure_s for p in self.pairs})} exposures; "
                f"{photon_transfer.FEWEST_LEVELS} are needed: two frames and more at each exposure"
            )
        self.level_dn, self.u_dn = level, u
        self.map_sum, self.map_count = sums, len(of_map)
        self.map_exposure = float(np.mean(of_map)) if of_map else 0.0

    # ---- results ----

    def done(self) -> CameraCalibration:
        self.darks()
        self.flats()
        ordered = sorted(self.pairs, key=lambda p: p.mean_dn)
        last = photon_transfer.saturation_index(np.array([p.variance_dn2 for p in ordered]))
        full = min(ordered[last].mean_dn - self.level, self.camera.white_level_dn - self.level)
        curve = self._linearity(full)
        bent = self.raw.model_copy(update={"nonlinearity": tuple(curve.coefficients)})
        transfer = photon_transfer.photon_transfer(
            self.pairs, self.dark_pairs, (self.level, self.slope), bent, curve.covariance
        )
        standard = photon_transfer.photon_transfer(self.pairs, self.dark_pairs, (self.level, self.slope), self.raw)
        prnu, u_prnu, map_ = self._responsivities(transfer, bent)
        gain = transfer.electrons_per_dn
        uneven, u_uneven, filled = self.uneven_darks()
        values, own = self._noise(transfer, (uneven.total * gain, u_uneven * gain), (prnu, u_prnu))
        values["nonlinearity"] = [float(c) for c in curve.coefficients]
        covariance, names = _with_gain(values, own, transfer)
        covariance, names = _with(
            covariance, names, curve.covariance, [f"nonlinearity[{k}]" for k in range(len(curve.coefficients))]
        )
        stray = self._stray(bent, gain, transfer.read_noise_e)
        measured = self._figures(transfer, standard, curve, uneven, prnu)
        if stray is not None:
            values |= {"stray_light": max(stray.uniform, 0.0)}
            strays = ["stray_light"]
            if stray.halo > 0:
                values |= {"stray_halo": stray.halo, "stray_halo_px": stray.halo_px}
                strays.append("stray_halo")
            covariance, names = _with(covariance, names, stray.covariance[: len(strays), : len(strays)], strays)
            measured["stray_light_chi_square"] = stray.chi_square
        lens = self._vignetting(bent, stray)
        if lens is not None and lens.u > UNDETERMINED:
            self.notes.append(
                f"vignetting: {lens.value:.2g}, u = {lens.u:.2g}, is not determined: that of the rig file, "
                f"{self.camera.vignetting:g}, stays. A white that reaches the corners of the frame would tell it "
                "(reference.diameter_mm), or one that is closer"
            )
        elif lens is not None:
            values["vignetting"] = max(lens.value, 0.0)
            covariance, names = _with(covariance, names, np.array([[lens.u**2]]), ["vignetting"])
            measured["field_residual"] = lens.residual
        law = self._temperature(gain)
        if law is not None:
            measured |= {"dark_doubling_c": law.doubling_c, "dark_energy_ev": law.energy_ev, "dark_at_c": law.at_c}
        if not self.of["edge"] and stray is not None:
            self.notes.append("no frame of an edge: whether light spreads as a halo is not known")
        maps = PixelMaps(
            map_[0].astype(np.float32), map_[1].astype(np.float32), self.defects,
            ((filled - filled.mean()) * gain).astype(np.float32),
        )  # fmt: skip
        rounded = {k: _rounded(v) for k, v in values.items()}
        return CameraCalibration(
            rounded, names, covariance, self.notes, {k: _rounded(v) for k, v in measured.items()},
            maps, transfer, curve, self.dark_means,
        )  # fmt: skip

    def _noise(
        self, transfer: photon_transfer.PhotonTransfer, dsnu: tuple[float, float], prnu: tuple[float, float]
    ) -> tuple[TomlTable, dict[str, float]]:
        """Keys of the noise model, and the standard uncertainties that they have beside that of the gain."""
        gain = transfer.electrons_per_dn
        out: TomlTable = {
            "electrons_per_dn": gain,
            "black_level_dn": max(self.level, 0.0),
            "read_noise_e": transfer.read_noise_e,
            "dark_current_e_per_s": max(self.slope * gain, 0.0),
            "dsnu_e": dsnu[0],
            "prnu": prnu[0],
            "photon_noise": True,
        }
        own = {
            "electrons_per_dn": 0.0,
            "black_level_dn": self.u_level,
            "read_noise_e": math.sqrt(
                max(transfer.u_read_noise_e**2 - (transfer.read_noise_e * transfer.u_gain / transfer.gain) ** 2, 0.0)
            ),
            "dark_current_e_per_s": self.u_slope * gain,
            "dsnu_e": dsnu[1],
            "prnu": prnu[1],
        }
        if transfer.saturated:
            out["full_well_e"] = transfer.saturation_e
            own["full_well_e"] = transfer.u_saturation_dn * gain
        else:
            self.notes.append("no flat frame saturates: the full well is not determined")
        if transfer.hidden:
            self.notes.append("rounding to whole DN hides the read noise: it is at most what is given")
        return out, own

    def _figures(
        self,
        transfer: photon_transfer.PhotonTransfer,
        standard: photon_transfer.PhotonTransfer,
        curve: linearity.Linearity,
        uneven: pixel_statistics.Unevenness,
        prnu: float,
    ) -> TomlTable:
        """The standard's figures, for people; `standard` has no curve taken out."""
        gain = transfer.electrons_per_dn
        out: TomlTable = {
            "gain_dn_per_e": transfer.gain,
            "gain_of_the_standard_dn_per_e": standard.gain,
            "temporal_dark_noise_dn": transfer.dark_noise_dn,
            "saturation_capacity_e": transfer.saturation_e,
            "absolute_threshold_e": transfer.threshold_e,
            "dynamic_range_db": 20.0 * math.log10(transfer.dynamic_range),
            "snr_max": transfer.snr_max,
            "dsnu1288_e": uneven.total * gain,
            "dsnu1288_row_column_pixel_e": [uneven.row * gain, uneven.column * gain, uneven.pixel * gain],
            "prnu1288": prnu,
            "lamp_noise": curve.lamp_noise,
            "parts_of_the_flats": curve.parts,
            "linearity_chi_square": curve.chi_square,
            "defects": int(np.count_nonzero(self.defects)),
            "pairs": len(self.pairs),
            "dark_frames": len(self.of["dark"]),
        }
        if math.isfinite(standard.linearity_error):
            out["linearity_error"] = standard.linearity_error
        return out

    def _linearity(self, full: float) -> linearity.Linearity:
        taken = self.of["flat"]
        use = (self.level_dn >= LEAST_DN) & (self.level_dn[0] <= LEVEL * full)[None, :] & np.isfinite(self.u_dn)
        kept = use.any(axis=0)
        level = np.where(use, self.level_dn, math.nan)[:, kept]
        t = np.array([f.exposure_s for f in taken])[kept]
        times = np.array([f.time_s for f in taken])[kept]
        curve = linearity.fit(level, self.u_dn[:, kept], self.u_dark_dn, t, times, self.raw)
        if curve.parts == 1:
            self.notes.append(
                "the flat frames are of one brightness throughout: the linearity is determined by exposure times, and "
                "is as good as "
                "the lamp and the shutter are steady; let something darker be in view beside the white reference"
            )
        if curve.chi_square > 4.0:
            self.notes.append(
                f"parts of the flat frames depart from the fitted curve by {math.sqrt(curve.chi_square):.1f} "
                f"times their noise"
            )
        return curve

    def _responsivities(
        self, transfer: photon_transfer.PhotonTransfer, camera: Camera
    ) -> tuple[float, float, tuple[Floats, Floats]]:
        """PRNU with its uncertainty, and the map of responsivities with that of each pixel."""
        ones = np.ones(self.colour.shape)
        if not self.map_count:
            self.notes.append("no flat frame between 20 and 80 % of full scale: PRNU is not determined")
            return self.camera.prnu, self.camera.prnu, (ones, self.camera.prnu * ones)
        region = pixel_statistics.inside(self.even >= 0.5 * np.percentile(self.even[self.bright], 50.0)) & self.good
        electrons = float(np.mean(self.map_sum[region])) * transfer.electrons_per_dn
        alike = pixel_statistics.CORRELATED / math.sqrt(2.0 * np.count_nonzero(region))
        signal = straightened(camera, self.map_sum / self.map_count)
        ratio, region, total = pixel_statistics.evened(signal, region)
        if not region.any():
            self.notes.append(
                "the white is blurred or marked all over the flat frames: single pixels' responsivities are not "
                "determined; let more of it be in view, and in focus"
            )
        bad = pixel_statistics.outliers(ratio, pixel_statistics.LEAST_DEPARTURE)
        self.defects = self.defects | bad
        region &= ~bad
        # a sum of S electrons of n frames has the variance S + n sigma_d^2, and n^2 times that of the dark line
        dark = self._noise_of_line(self.map_exposure) * transfer.electrons_per_dn**2
        each = (transfer.dark_noise_dn * transfer.electrons_per_dn) ** 2
        temporal = (electrons + self.map_count * each + self.map_count**2 * dark) / electrons**2
        prnu = math.sqrt(max(total - temporal, 0.0))
        u = total / max(prnu, math.sqrt(total) * 1e-3) * alike
        # the mean of all pixels is known: of a noisy map the part is used that is more likely the pixel's than noise
        share = prnu**2 / max(prnu**2 + temporal, 1e-30)
        responsivity = np.where(region, 1.0 + share * (np.nan_to_num(ratio, nan=1.0) - 1.0), 1.0)
        left = np.where(region, prnu * math.sqrt(temporal / max(prnu**2 + temporal, 1e-30)), prnu)
        return prnu, u, (responsivity, left)

    def _stray(self, camera: Camera, gain: float, read_noise_e: float) -> black_frames.StrayLight | None:
        black: list[black_frames.BlackFrame] = []
        groups: dict[tuple[str, float, str], list[CameraFrame]] = {}
        for f in self.of["trap"] + self.of["edge"]:
            if f.black is None:
                raise DataError(
                    f"{f.path}: nothing says which pixels see black; give them in frames.csv (black_px = "
                    f"top:bottom,left:right)"
                )
            rows, cols = f.black
            if rows.stop > self.camera.height or cols.stop > self.camera.width:
                raise DataError(f"{f.path}: black_px reaches beyond the frame")
            groups.setdefault((f.kind, f.exposure_s, repr(f.black)), []).append(f)
        for (_, exposure, _), group in groups.items():
            mean = np.mean([self.read(f) for f in group], axis=0)
            top = float(np.percentile(mean[self.good], 99.9)) - self.level
            if top > 0.97 * (self.camera.white_level_dn - self.level):
                raise DataError(
                    f"{group[0].path}: is full where it is bright; stray light needs frames that are not: "
                    f"expose shorter"
                )
            dark = self.dark_at(exposure)
            signal = straightened(camera, mean - self.level) - straightened(camera, dark - self.level)
            assert group[0].black is not None
            region = signal[group[0].black][~self.defects[group[0].black]]
            signal = np.where(self.defects, math.nan, signal)
            # quiet or not, a mean over a part holds photon noise, read noise, and the dark line's
            electrons = max(float(region.mean()) * gain, 0.0) + max(self.slope * gain * exposure, 0.0)
            variance = (electrons + read_noise_e**2) / gain**2 + 1.0 / 12.0
            black.append(
                black_frames.BlackFrame(signal, group[0].black, variance / len(group) + self._noise_of_line(exposure))
            )
        if not black:
            self.notes.append("no frames of a trap or an edge: stray light is not determined")
            return None
        found = black_frames.fit(black, camera, self.channel)
        if found.uniform + found.halo > NOT_BLACK:
            raise DataError(
                f"{(self.of['trap'] + self.of['edge'])[0].path.parent}: what shall be black in the frames of trap and "
                f"edge is at {100 * (found.uniform + found.halo):.3g} % of the frames' mean, and no lens spreads more "
                f"than {100 * NOT_BLACK:g} %: did a black trap lie in the holder, and is it at black_px?"
            )
        if found.uniform < -3.0 * math.sqrt(found.covariance[0, 0]):
            self.notes.append(
                f"stray_light comes out as {found.uniform:.2g}, and is taken for 0: are the dark frames of this day?"
            )
        return found

    def _vignetting(self, camera: Camera, stray: black_frames.StrayLight | None) -> vignetting.Vignetting | None:
        if not self.of["field"]:
            return None
        groups: dict[tuple[Pose, float], list[CameraFrame]] = {}
        for f in self.of["field"]:
            if f.pose is None:
                raise DataError(f"{f.path}: nothing says where the arms stood; give it in frames.csv (pose_deg)")
            groups.setdefault((f.pose, f.exposure_s), []).append(f)
        pictures = []
        for (pose, exposure), group in groups.items():
            mean = np.mean([self.read(f) for f in group], axis=0)
            dark = self.dark_at(exposure)
            signal = straightened(camera, mean - self.level) - straightened(camera, dark - self.level)
            if float(np.percentile(signal[self.good], 99.0)) > 0.97 * self.full:
                raise DataError(f"{group[0].path}: is full: frames of the field are not; expose shorter")
            if stray is not None:
                fractions = {"stray_light": max(stray.uniform, 0.0), "stray_halo": stray.halo}
                known = camera.model_copy(update=fractions | {"stray_halo_px": stray.halo_px})
                rows, cols = (index.ravel() for index in np.indices(signal.shape))
                added = spread(known, np.where(self.defects, 0.0, signal), 0.0, self.channel).at(rows, cols)[0]
                signal = signal - added.reshape(signal.shape)
            pictures.append((np.where(self.defects, math.nan, signal), pose))
        return vignetting.fit(pictures, self.description, self.channel)

    def _temperature(self, gain: float) -> pixel_statistics.DarkTemperature | None:
        """Arrhenius' law, where the dark frames say their temperatures."""
        t = np.round(self.temperatures, 1)
        exposures, means = self.dark_means
        found = []
        for one in np.unique(t[np.isfinite(t)]):
            here = t == one
            away = exposures[here] - exposures[here].mean()
            if np.sum(away**2) > 0:
                slope = float(np.sum(away * means[here]) / np.sum(away**2))
                left = means[here] - means[here].mean() - slope * away
                u = math.sqrt(float(np.sum(left**2)) / max(len(left) - 2, 1) / float(np.sum(away**2)))
                found.append((one, slope * gain, max(u, 1e-6) * gain))
        if not found:
            return None
        return pixel_statistics.temperature_law(*np.array(found).T)


def _with_gain(
    values: TomlTable, own: dict[str, float], transfer: photon_transfer.PhotonTransfer
) -> tuple[Floats, list[str]]:
    """Covariance of numbers of which those in electrons share the gain's uncertainty."""
    names = list(own)
    in_electrons = ("electrons_per_dn", "dark_current_e_per_s")
    by_gain = np.array([values[name] if name.endswith("_e") or name in in_electrons else 0.0 for name in names])
    covariance = np.diag(np.array(list(own.values())) ** 2)
    return covariance + np.outer(by_gain, by_gain) * (transfer.u_gain / transfer.gain) ** 2, names


def _with(a: Floats, names: list[str], b: Floats, more: list[str]) -> tuple[Floats, list[str]]:
    """Two covariances of numbers that have nothing to do with each other."""
    out = np.zeros((len(a) + len(b),) * 2)
    out[: len(a), : len(a)], out[len(a) :, len(a) :] = a, b
    return out, names + more


def _rounded(value: Any) -> Any:
    """Numbers with six digits, as a person reads them."""
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def black_rectangle(mask: npt.NDArray[np.bool_]) -> tuple[slice, slice] | None:
    """The rows and columns of a region that is a rectangle, or nearly one; None for an empty one."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)
