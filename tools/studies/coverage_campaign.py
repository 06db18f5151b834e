"""One campaign as a laboratory carries it out: files, calibration, measurement, reduction, fit; then the comparison.

The functions are those that the commands call. What is true is written to `truth.toml`, which the simulated devices
alone read, and is looked at again when everything is done.
"""

import csv
import datetime
import io
import math
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gonio_analysis.fitting.energy import of_model
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.profile_likelihood import walked

from gonio import instrument, measurement, models
from gonio.config import numbers_in, read_toml, to_toml, with_numbers
from gonio.errors import GonioError, Interrupted
from gonio.geometry import ANGLES_DEG, AROUND_MIRROR, Directions
from gonio.lab.acquisition.measure import carry_out, find_rig
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.by_hand import alignment, rig_file
from gonio.lab.by_hand.alignment_scans import Scans
from gonio.lab.by_hand.manual_rig import ManualRig, open_rig
from gonio.lab.calibration import camera, lamp_scan, lamp_stability
from gonio.lab.calibration.camera_scan import CameraScan
from gonio.lab.reduction import brdf
from gonio.lab.rig.calibration_files import Calibration, identity, uncalibrated, with_keys, write_calibration
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import ParameterUncertainty
from gonio.samples.files import load_sample
from gonio.shown import finite
from gonio.typing import DataFrame, Floats
from tools.studies.campaigns import Record
from tools.studies.coverage_hidden import Campaign

FORMAT = 3
"""Version of a record's format."""
WRONG = {"oren-nayar": "lambert", "phong": "cook-torrance", "blinn": "phong", "cook-torrance": "blinn",
         "he-torrance": "cook-torrance"}  # fmt: skip
"""Which model is fitted that the sample does not have, by the one that it has."""
SPIKE = 0.01
"""Part of the reflected light: with more of it in the specular spike no wrong model is looked at."""
BESIDE = math.radians(1.5)
"""Distance from a measured direction at which a value of a wrong model is looked at [rad]."""
GRAZING = math.radians(65.0)
EDGE = math.radians(0.3)
"""How far beyond the cones errors of the angles may bring the edge of a spike [rad]."""
SERIES_S = (2700.0, 45.0)
"""How long the lamp is watched, and how often [s]."""
PAIRS = 1
"""Pairs of flats, at each of 23 exposures."""
STRAYS: tuple[Literal["trap", "edge"], ...] = ("trap", "edge")
SEARCH_DEG = 8.0
"""How far a scan looks for the lamp: the sum of two zero offsets of 3 deg, and some."""


def carried_out(campaign: Campaign, folder: Path) -> Record:
    """The record of a campaign, as JSON has it: what was hidden, what came out, and what is true.

    A campaign that the programs refuse has a record too, with the step and the message under "failed".

    Parameters
    ----------
    folder
        Where its files lie meanwhile; what is there is removed before and afterwards.
    """
    began = time.perf_counter()
    record: Record = {
        "format": FORMAT, "campaign": campaign.number, "model": campaign.model, "plan": campaign.plan,
        "truth": campaign.truth, "wavelength_nm": campaign.wavelength_nm, "rig": campaign.rig,
        "hidden": campaign.true, "calibrated": {}, "points": {}, "fit": {}, "wrong": {}, "failed": None,
    }  # fmt: skip
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    step = "files"
    try:
        _write(campaign, folder)
        rig = folder / "rig.toml"
        for error, (name, calibrate) in CALIBRATIONS.items():
            if error in campaign.errors:
                step = name
                rig = calibrate(campaign, rig, record)
        step = "measurement"
        run = carry_out(
            load_plan(folder / "plan.toml"), find_rig(str(rig)), folder / "run",
            sample=load_sample(folder / "sample.toml"), seed=campaign.seed, yes=True,
        )  # fmt: skip
        step = "reduction"
        measurement.write(brdf.reduce(run), folder / "brdf.csv")
        table = measurement.read(folder / "brdf.csv")
        record["points"] = points(campaign, table)
        step = "fit"
        record["fit"] = fitted(campaign, table)
        record["wrong"] = of_wrong_model(campaign, table)
    except Interrupted:
        raise
    except GonioError as error:
        record["failed"] = {"step": step, "message": str(error).replace(f"{folder}/", "")}
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    record["seconds"] = round(time.perf_counter() - began, 3)
    return record


def _write(campaign: Campaign, folder: Path) -> None:
    sample = {"name": campaign.model, "model": campaign.model, "parameters": campaign.given}
    plan = {"name": campaign.plan, "wavelength_nm": [campaign.wavelength_nm], "points": [{"file": "points.csv"}]}
    for name, tables in {"rig": campaign.rig, "truth": campaign.true, "sample": sample, "plan": plan}.items():
        (folder / f"{name}.toml").write_text(to_toml(tables), encoding="utf-8", newline="\n")
    text = io.StringIO()
    csv.writer(text).writerows([ANGLES_DEG, *campaign.points])
    (folder / "points.csv").write_text(text.getvalue(), encoding="utf-8", newline="\n")


# --- calibrations -------------------------------------------------------------------------------------------------


def watch_lamp(campaign: Campaign, rig: Path, record: Record) -> Path:
    """`gonio calibrate light --only lamp`: noise of the lamp, and how long it takes to warm up."""
    bench = _bench(campaign, rig)
    series = rig.with_name("series.csv")
    with bench:
        lamp_scan.take_series(bench, *SERIES_S, keep=lambda table: table.to_csv(series, index=False))
    table = lamp_stability.read_series(series)
    stability = lamp_stability.fit(*(table[name].to_numpy() for name in lamp_stability.COLUMNS[:3]))
    stability.require_model()
    values, names, covariance = lamp_stability.values(stability)
    u = np.sqrt(np.diag(covariance))
    safe = np.where(u > 0.0, u, 1.0)
    uncertainty = {
        "parameters": [f"lamp.{name}" for name in names],
        "u": u.tolist(),
        "correlation": _correlation(covariance, safe),
    }
    # the warm-up is not compared: a simulated lamp's begins with the bench's clock, which is before the lamp is lit
    known = {name: float(one) for name, one in zip(names, u, strict=True) if not name.startswith("warm_up")}
    _found(campaign, bench.description, record, "lamp", values, known)
    return _with_file(rig, _calibration("light", bench.description, {"lamp": values}, uncertainty), "light.toml")


def certified(campaign: Campaign, rig: Path, record: Record) -> Path:
    """The calibration file of a geometry that somebody else measured, with an error of his; no file, where none is."""
    c = campaign.certificate
    if c is None:
        return rig
    description = find_rig(str(rig)).description
    true = numbers_in(with_keys(description, campaign.true, "truth.toml").model_dump(mode="json"))
    numbers = {name: true.get(name, 0.0) + off for name, off in zip(c.parameters, c.off, strict=True)}
    arms = {
        arm: {
            "zero_offset_deg": 0.0,
            **{k: v for k, v in campaign.true["arms"][arm].items() if not k.startswith("zero_")},
            **c.values["arms"][arm],
        }
        for arm in ("light", "camera")
    }
    for arm in arms.values():
        for key in ("encoder_step_deg", "backlash_deg"):
            arm.pop(key, None)
    holder = {"tilt_zero_offset_deg": 0.0, "spin_zero_offset_deg": 0.0, "surface_tilt_deg": [0.0, 0.0]}
    values = with_numbers({"arms": arms, "holder": holder | c.values["holder"]}, numbers)
    uncertainty = {"parameters": c.parameters, "u": c.u, "correlation": c.correlation}
    return _with_file(rig, _calibration("geometry", description, values, uncertainty), "geometry.toml")


def align(campaign: Campaign, rig: Path, record: Record) -> Path:
    """`gonio rig align`: the rig file with the zeros that were found; as it is, where they are known."""
    bench = _bench(campaign, rig)
    description = bench.description
    if all(axis.zero_offset_known for axis in description.axes().values()):
        return rig
    scans = Scans(bench, search_deg=SEARCH_DEG, say=lambda text: None)
    with bench:
        bench.put("mirror")
        scans.mirror()
        bench.lamp(False)
        bench.put("empty")
        scans.straight_through()
        bench.lamp(False)
        bench.put("sample")
    found = alignment.align(scans.table, description)
    aligned = rig.with_name("aligned.toml")
    rig_file.write_values(rig, alignment.zero_values(found, description), out=aligned)
    arms, holder = campaign.true["arms"], campaign.true["holder"]
    true = {name: arms[name]["zero_offset_deg"] for name in ("light", "camera")}
    true["tilt"] = holder["tilt_zero_offset_deg"]
    record["calibrated"] |= {
        f"zero of {name}": {"true": true[name], "value": zero.offset_deg, "u": zero.u_deg}
        for name, zero in found.zeros.items()
    }
    return aligned


def calibrate_camera(campaign: Campaign, rig: Path, record: Record) -> Path:
    """`gonio calibrate camera`: gain, noise, linearity, maps, vignetting and stray light."""
    bench = _bench(campaign, rig)
    frames = rig.with_name("camera-frames")
    frames.mkdir()
    scan = CameraScan(bench, frames, pairs=PAIRS, say=lambda text: None)
    with bench:
        bench.put("reference")
        scan.go()
        scan.darks()
        scan.flats()
        scan.field()
        for kind in STRAYS:
            bench.lamp(False)
            bench.put(kind)
            scan.stray(kind)
        bench.put("sample")
    description = uncalibrated(bench.description)
    found = camera.calibrate(scan.frames, description, bench.band.channel)
    assert found.maps is not None
    maps = rig.with_name("camera-maps.npz")
    found.maps.write(maps)
    u = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    _found(campaign, bench.description, record, "camera", found.values, u)
    return _with_file(rig, found.file(description, valid_days=None, maps=maps.name), "camera.toml")


def _bench(campaign: Campaign, rig: Path) -> ManualRig:
    bench = open_rig(str(rig), seed=campaign.seed, only=("arms", "light", "camera"))
    bench.choose_band(campaign.wavelength_nm)
    return bench


def _calibration(
    kind: Literal["geometry", "light"], description: RigDescription, values: Record, uncertainty: Record
) -> Calibration:
    return Calibration(
        kind=kind, rig=description.name, rig_identity=identity(description), made=datetime.date.today(),
        values=values, uncertainty=ParameterUncertainty(**uncertainty),
    )  # fmt: skip


def _correlation(covariance: Floats, u: Floats) -> list[list[float]]:
    """Rounding may leave a correlation of a number with itself that is not 1."""
    out = np.clip(covariance / np.outer(u, u), -1.0, 1.0)
    np.fill_diagonal(out, 1.0)
    return [[float(x) for x in row] for row in out]


def _with_file(rig: Path, calibration: Calibration, name: str) -> Path:
    """The rig file, with one calibration more."""
    write_calibration(calibration, rig.with_name(name))
    tables = read_toml(rig)
    tables.setdefault("calibration", {}).setdefault("files", []).append(name)
    rig.write_text(to_toml(tables), encoding="utf-8", newline="\n")
    return rig


def _found(
    campaign: Campaign, description: RigDescription, record: Record, table: str, values: Record, u: Mapping[str, float]
) -> None:
    """Note what came out of a table of the rig file, beside what is true."""
    true = numbers_in(with_keys(description, campaign.true, "truth.toml").model_dump(mode="json")[table])
    found = numbers_in(values)
    record["calibrated"] |= {
        f"{table}.{name}": {"true": true[name], "value": found[name], "u": float(u[name])}
        for name in u
        if name in true and u[name] > 0.0
    }


CALIBRATIONS: dict[str, tuple[str, Callable[[Campaign, Path, Record], Path]]] = {
    "lamp": ("calibration of the lamp", watch_lamp),
    "geometry": ("certificate of the geometry", certified),
    "zeros": ("alignment", align),
    "camera": ("calibration of the camera", calibrate_camera),
}
"""By the error that it is for, in their order: its name, and what takes the campaign, the rig file as it stands and the
record, and gives the rig file to go on with."""


# --- comparison with the truth ------------------------------------------------------------------------------------


def points(campaign: Campaign, table: DataFrame) -> Record:
    """Every usable row, with what the instrument's cones would have seen of the true sample in the row's directions."""
    used = table[table["flag"] == ""]
    model = models.build(campaign.model, campaign.given)
    directions = Directions.from_table(used)
    truth = instrument.apparent_brdf(
        model,
        *directions.angles,
        wavelength_nm=campaign.wavelength_nm,
        source_solid_angle_sr=table.attrs["source_solid_angle_sr"],
        receiver_solid_angle_sr=table.attrs["receiver_solid_angle_sr"],
        spike="exact",
    )
    random, common, causes = measurement.uncertainty(used)
    out: Record = {name: used[name].tolist() for name in ("theta_i_deg", "theta_r_deg", "brdf", "u_brdf")}
    out["dphi_deg"] = np.degrees(directions.dphi).tolist()
    out |= {"truth": truth.tolist(), "u_random": random.tolist()}
    out["common"] = dict(zip(causes, np.nan_to_num(common).T.tolist(), strict=True))
    reach = math.radians(campaign.rig["lamp"]["half_angle_deg"] + campaign.rig["camera"]["lens_half_angle_deg"])
    out["region"] = regions(directions, reach if model.has_spike else None)
    out["flags"] = dict(table["flag"][table["flag"] != ""].value_counts())
    out["flags"] = {str(name): int(count) for name, count in out["flags"].items()}
    out["notes"] = [str(note) for note in table.attrs.get("notes", [])]
    return out


def regions(directions: Directions, spike_rad: float | None) -> list[str]:
    """Where each point lies; `spike_rad` is how far from the mirror direction a specular spike may be seen."""
    offset = np.atleast_1d(directions.mirror_offset)
    out = np.full(offset.shape, "elsewhere", dtype=object)
    retro = np.atleast_1d(Directions(directions.theta_i, directions.phi_i, directions.theta_r,
                                     directions.phi_r + math.pi).mirror_offset)  # fmt: skip
    out[retro <= AROUND_MIRROR] = "around retro"
    out[np.maximum(directions.theta_i, directions.theta_r) >= GRAZING] = "grazing"
    out[offset <= AROUND_MIRROR] = "around the mirror"
    if spike_rad is not None:
        out[offset <= spike_rad + EDGE] = "specular spike"
    return [str(name) for name in out]


def fitted(campaign: Campaign, table: DataFrame) -> Record:
    """The campaign's own model fitted to a table, with the 95 % intervals that `gonio fit --intervals` states."""
    first = fit(table, campaign.model, ior=campaign.ior)
    result, intervals = walked(first, lambda start: fit(table, campaign.model, ior=campaign.ior, start=start))
    parameters = {}
    for name in result.free:
        found, interval = result.parameters[name], intervals[name]
        parameters[name] = {
            "true": campaign.truth[name], "value": found.value, "u": finite(found.u), "at_bound": found.at_bound,
            "low": interval.low, "high": interval.high,
            "open_low": interval.open_low, "open_high": interval.open_high,
        }  # fmt: skip
    return {
        "parameters": parameters, "free": list(result.free), "covariance": _plain(result.covariance),
        "chi_square": finite(result.chi_square), "freedom": result.degrees_of_freedom,
        "p_value": finite(result.p_value), "notes": list(result.notes),
    }  # fmt: skip


def of_wrong_model(campaign: Campaign, table: DataFrame) -> Record:
    """What a model that the sample does not have says of rho_dh, and of a direction beside a measured one.

    Nothing where the data do not reject that model.
    """
    other = WRONG.get(campaign.model)
    result = fit(table, other) if other is not None else None
    if result is None or not result.rejected:
        return {}
    true, nm = models.build(campaign.model, campaign.given), campaign.wavelength_nm
    at = result.data.directions
    k = campaign.number % len(result.data)
    rho = [r for r in of_model(result) if r.u]
    picked = rho[campaign.number % len(rho)] if rho else None
    theta, phi = (float(at.theta_i[k]) if picked is None else math.radians(picked.theta_i_deg)), float(at.phi_i[k])
    whole = float(true.directional_hemispherical(theta, phi_i=phi, wavelength_nm=nm))
    if float(true.specular_reflectivity(theta, wavelength_nm=nm)) > SPIKE * whole:
        return {}  # how much of a spike a lobe takes is no question of a smooth misfit
    inward = np.where(at.theta_r > BESIDE, -BESIDE, BESIDE)
    beside = Directions(at.theta_i, at.phi_i, at.theta_r + inward, at.phi_r)[k : k + 1]
    value, u = result.predict(beside)
    there = float(np.asarray(true.brdf(*beside.angles, wavelength_nm=nm))[0])
    out: Record = {"a value beside a measured one": {"true": there, "value": float(value[0]), "u": float(u[0])}}
    if picked is not None:
        out["rho_dh"] = {"true": whole, "value": picked.rho_dh, "u": picked.u}
    return out


def _plain(matrix: Any) -> list[list[float | None]]:
    return [[finite(x) for x in row] for row in np.asarray(matrix)]
