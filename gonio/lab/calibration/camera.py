"""From frames of dark, white, trap and edge to the camera's keys of the rig file (docs/calibration.md)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition.exposure import MAY_BE_FULL
from gonio.lab.calibration import beam, black_frames, linearity, photon_transfer
from gonio.lab.calibration.camera_frames import CameraFrame, Passes
from gonio.lab.reduction.stray_light import spread
from gonio.lab.rig import Pose
from gonio.lab.rig.calibration_files import Calibration
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import Channel
from gonio.lab.rig.light_and_camera import Camera, PixelMaps, straightened
from gonio.samples.description import ParameterUncertainty
from gonio.shown import with_u
from gonio.typing import Bools, Figure, Floats, TomlTable

UNDETERMINED = 0.05
"""Standard uncertainty of `vignetting` from which on it is not: lenses lose a tenth or two at the corners."""
LEVEL = 0.9
"""Part of saturation: frames above are not used for the linearity."""
LEAST_DN = 2.0
"""Least signal of a part."""
NOT_BLACK = 0.25
"""Share of the mean that a lens may spread: from here on it is no lens, but something bright where black should be."""


@dataclass(frozen=True)
class CameraCalibration:
    """What came out."""

    values: TomlTable
    """Keys of the rig file's table [camera]."""
    names: list[str]
    """Names of the numbers with uncertainties, as `nonlinearity[0]`."""
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
    require_8_bits(camera)
    if not flats:
        raise DataError("there are no flat frames: a response curve needs a bracket of exposures")
    images = [frame.read(camera) for frame in flats]
    curve, covariance = linearity.curve(images, np.array([frame.exposure_s for frame in flats]))
    notes = ["the noise of a camera with a response curve is not measured: that of the rig file stays"]
    values: TomlTable = {"response": [float(f"{value:.6g}") for value in curve], "nonlinearity": [0.0, 0.0]}
    values["response"][-1] = 255.0
    return CameraCalibration(
        values, ["nonlinearity[0]", "nonlinearity[1]"], covariance, notes, {"flats": len(flats)}, None, None, None,
        np.zeros((2, 0)),
    )  # fmt: skip


def require_8_bits(camera: Camera) -> None:
    """Raise `ConfigError` where a camera is none of 8 bits, which alone have a response curve."""
    if camera.bits != 8:
        raise ConfigError(
            f"camera.bits = {camera.bits}: a response curve is for cameras of 8 bits; leave out --response"
        )


class _Work(Passes):
    """What comes out of the passes over the frames."""

    def done(self) -> CameraCalibration:
        """All that the frames tell."""
        self.darks()
        self.flats()
        ordered = sorted(self.pairs, key=lambda p: p.mean_dn)
        last = int(np.argmax([p.variance_dn2 for p in ordered]))
        curve = self._linearity(min(ordered[last].mean_dn - self.level, self.camera.white_level_dn - self.level))
        bent = self.raw.model_copy(update={"nonlinearity": tuple(curve.coefficients)})
        pairs = self.pairs, self.dark_pairs, (self.level, self.slope)
        transfer = photon_transfer.photon_transfer(*pairs, bent, curve.covariance)
        standard = photon_transfer.photon_transfer(*pairs, self.raw)
        prnu, u_prnu, responsivities = self._responsivities(transfer, bent)
        gain = transfer.electrons_per_dn
        uneven, u_uneven, filled = self.uneven_darks()
        values, own = self._noise(transfer, (uneven.total * gain, u_uneven * gain), (prnu, u_prnu))
        values["nonlinearity"] = [float(c) for c in curve.coefficients]
        names = [*own, *(f"nonlinearity[{k}]" for k in range(len(curve.coefficients)))]
        blocks = [_with_gain(values, own, transfer), curve.covariance]
        measured = self._figures(transfer, standard, curve, uneven, prnu)
        stray = self._stray(bent, gain, transfer.read_noise_e)
        if stray is not None:
            values |= {"stray_light": max(stray.uniform, 0.0)}
            if stray.halo > 0:
                values |= {"stray_halo": stray.halo, "stray_halo_px": stray.halo_px}
            names += (strays := ["stray_light", "stray_halo"][: 1 + (stray.halo > 0)])
            blocks.append(stray.covariance[: len(strays), : len(strays)])
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
            names.append("vignetting")
            blocks.append(np.array([[lens.u**2]]))
            measured["field_residual"] = lens.residual
        law = self._temperature()
        if law is not None:
            measured |= {"dark_doubling_c": law.doubling_c, "dark_energy_ev": law.energy_ev, "dark_at_c": law.at_c}
        if not self.of["edge"] and stray is not None:
            self.notes.append("no frame of an edge: whether light spreads as a halo is not known")
        maps = [each.astype(np.float32) for each in (*responsivities, (filled - filled.mean()) * gain)]
        return CameraCalibration(
            _rounded(values), names, np.asarray(block_diag(*blocks)), self.notes, _rounded(measured),
            PixelMaps(maps[0], maps[1], self.defects, maps[2]), transfer, curve, np.array(self.dark_means),
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
        uneven: photon_transfer.Unevenness,
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
        region = photon_transfer.inside(self.even >= 0.5 * np.percentile(self.even[self.bright], 50.0)) & self.good
        electrons = float(np.mean(self.map_sum[region])) * transfer.electrons_per_dn
        alike = photon_transfer.CORRELATED / math.sqrt(2.0 * np.count_nonzero(region))
        signal = straightened(camera, self.map_sum / self.map_count)
        ratio, region, total = photon_transfer.evened(signal, region)
        if not region.any():
            self.notes.append(
                "the white is blurred or marked all over the flat frames: single pixels' responsivities are not "
                "determined; let more of it be in view, and in focus"
            )
        bad = photon_transfer.outliers(ratio, photon_transfer.LEAST_DEPARTURE)
        self.defects = self.defects | bad
        region &= ~bad
        # a sum of S electrons of n frames has the variance S + n sigma_d^2, and n^2 times that of the dark line
        dark = self.dark_variance(self.map_exposure)[0] * transfer.electrons_per_dn**2
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
            mean = self.mean(group)
            top = float(np.percentile(mean[self.good], 99.9)) - self.level
            if top > MAY_BE_FULL * (self.camera.white_level_dn - self.level):
                raise DataError(
                    f"{group[0].path}: is full where it is bright; stray light needs frames that are not: "
                    f"expose shorter"
                )
            signal = self._signal(camera, mean, exposure)
            assert group[0].black is not None
            region = signal[group[0].black][~self.defects[group[0].black]]
            signal = np.where(self.defects, math.nan, signal)
            # quiet or not, a mean over a part holds photon noise, read noise, and the dark line's
            electrons = max(float(region.mean()) * gain, 0.0) + max(self.slope * gain * exposure, 0.0)
            variance = (electrons + read_noise_e**2) / gain**2 + 1.0 / 12.0
            black.append(
                black_frames.BlackFrame(signal, group[0].black, variance / len(group) + self.dark_variance(exposure)[0])
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

    def _signal(self, camera: Camera, mean: Floats, exposure_s: float) -> Floats:
        """What a mean frame holds beyond its dark level [DN], with the curve taken out."""
        dark = self.dark_at(exposure_s)
        return np.asarray(straightened(camera, mean - self.level) - straightened(camera, dark - self.level))

    def _vignetting(self, camera: Camera, stray: black_frames.StrayLight | None) -> beam.Vignetting | None:
        if not self.of["field"]:
            return None
        groups: dict[tuple[Pose, float], list[CameraFrame]] = {}
        for f in self.of["field"]:
            if f.pose is None:
                raise DataError(f"{f.path}: nothing says where the arms stood; give it in frames.csv (pose_deg)")
            groups.setdefault((f.pose, f.exposure_s), []).append(f)
        pictures = []
        for (pose, exposure), group in groups.items():
            signal = self._signal(camera, self.mean(group), exposure)
            if float(np.percentile(signal[self.good], 99.0)) > MAY_BE_FULL * self.full:
                raise DataError(f"{group[0].path}: is full: frames of the field are not; expose shorter")
            if stray is not None:
                fractions = {"stray_light": max(stray.uniform, 0.0), "stray_halo": stray.halo}
                known = camera.model_copy(update=fractions | {"stray_halo_px": stray.halo_px})
                rows, cols = (index.ravel() for index in np.indices(signal.shape))
                added = spread(known, np.where(self.defects, 0.0, signal), 0.0, self.channel).at(rows, cols)[0]
                signal = signal - added.reshape(signal.shape)
            pictures.append((np.where(self.defects, math.nan, signal), pose))
        return beam.fit_vignetting(pictures, self.description, self.channel)

    def _temperature(self) -> photon_transfer.DarkTemperature | None:
        """Arrhenius' law, where the dark frames say their temperatures."""
        from scipy.stats import linregress

        t, (exposures, means) = np.round(self.temperatures, 1), self.dark_means
        found = []
        for one in np.unique(t[np.isfinite(t)]):
            here = t == one
            if np.ptp(exposures[here]) > 0:
                line = linregress(exposures[here], means[here])
                found.append((one, line.slope, max(line.stderr, 1e-6)))
        return photon_transfer.temperature_law(*np.array(found).T) if found else None


def _with_gain(values: TomlTable, own: dict[str, float], transfer: photon_transfer.PhotonTransfer) -> Floats:
    """Covariance of numbers of which those in electrons share the gain's uncertainty."""
    in_electrons = ("electrons_per_dn", "dark_current_e_per_s")
    by_gain = np.array([values[name] if name.endswith("_e") or name in in_electrons else 0.0 for name in own])
    return (
        np.diag(np.array(list(own.values())) ** 2) + np.outer(by_gain, by_gain) * (transfer.u_gain / transfer.gain) ** 2
    )


def _rounded(value: Any) -> Any:
    """Numbers with six digits, as a person reads them."""
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def black_rectangle(mask: Bools) -> tuple[slice, slice] | None:
    """The rows and columns of a region that is a rectangle, or nearly one; None for an empty one."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def draw(found: CameraCalibration, camera: Camera) -> Figure | None:
    """Three panels; None where no photon transfer was made."""
    from matplotlib.figure import Figure

    transfer, curve = found.transfer, found.curve
    if transfer is None or curve is None:
        return None
    figure = Figure(figsize=(14, 4.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    x = transfer.signal_dn
    left.loglog(x, np.maximum(transfer.variance_dn2, 1e-3), "o", ms=4, color="tab:blue", label="pairs")
    line = np.geomspace(max(float(x.min()), 0.5), float(x.max()), 50)
    left.loglog(
        line, transfer.gain * line, color="0.3", lw=1, label=f"K = {with_u(transfer.gain, transfer.u_gain)} DN/e-"
    )
    left.axvline(
        photon_transfer.FIT_RANGE * transfer.saturation_dn,
        color="tab:green",
        lw=0.8,
        ls="--",
        label="70 % of saturation",
    )
    left.axvline(transfer.saturation_dn, color="tab:orange", lw=0.8, ls="--", label="saturation")
    left.set(xlabel="signal [DN]", ylabel="variance above dark [DN²]", title="Photon transfer")
    left.legend(fontsize="small")

    level = np.linspace(0.0, transfer.saturation_dn, 100)
    departure, u = curve.departure(camera, level), curve.u_departure(camera, level)
    middle.plot(level, 100 * departure, color="tab:blue", label="fitted departure")
    middle.fill_between(level, 100 * (departure - 2 * u), 100 * (departure + 2 * u), alpha=0.25, label="k = 2")
    points = curve.departure(camera, curve.signal_dn) + curve.residuals
    middle.plot(curve.signal_dn.ravel(), 100 * points.ravel(), ".", ms=3, color="0.4", label="parts of the flats")
    spread = max(200 * float(np.max(np.abs(departure))), 0.5)
    middle.set(xlabel="signal [DN]", ylabel="departure [%]", title="Linearity", ylim=(-spread, spread))
    middle.legend(fontsize="small")

    exposures, means = found.darks
    right.plot(exposures, means, "o", ms=4, label="mean of each dark frame")
    rate = found.values["dark_current_e_per_s"] / found.values["electrons_per_dn"]
    right.plot(exposures, found.values["black_level_dn"] + rate * exposures, color="0.3", lw=1, label="line")
    right.set(xlabel="exposure [s]", ylabel="mean [DN]", title="Dark signal")
    right.legend(fontsize="small")
    return figure
