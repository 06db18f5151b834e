"""What a run was asked to be, as its run.toml holds it, and what keeps it from being resumed with something else."""

import contextlib
import datetime
import hashlib
import json
import platform
import secrets
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from gonio.config import Strict
from gonio.disk import read_file
from gonio.errors import ConfigError
from gonio.formats.native import meta_path
from gonio.lab.acquisition.plan import Adaptive, Assessed, Plan, assess
from gonio.lab.rig.calibration_use import CalibrationUse
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.laboratory import Laboratory, merged
from gonio.samples.description import SampleDescription

FORMAT = 1
NAMED_FILES = {
    ("reference", "table"): ("reference.csv", "the table of the white reference"),
    ("reference", "certificate"): ("certificate.xml", "the certificate of the white reference"),
    ("camera", "maps"): ("camera_maps.npz", "the maps of the camera's pixels"),
}
"""Files that a rig file may name: table and key, and what the run's copy is called."""
RECORDED = ("gonio", "numpy", "scipy", "numba", "pandas", "rawpy")


class Header(Strict):
    """The table [run] of a run.toml."""

    format: int
    created: str
    command: str
    plan: str
    plan_sha256: str
    wavelength_nm: tuple[float, ...]
    bands: tuple[str, ...]
    """Each in its state of polarisation."""
    polarisation: tuple[str, ...] = ()
    """States that all bands are measured in; none: unpolarised."""
    rig: str
    """The entry point that drove it."""
    seed: int
    id: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")] | None = None
    """128 random bits, which journal and frames hold too; None in runs from before there was one."""


class RunSettings(Strict):
    """A run.toml."""

    run: Header
    versions: dict[str, str]
    rig: RigDescription
    sample: SampleDescription | None = None
    adaptive: Adaptive | None = None
    """What was to be chosen beyond the points of plan.csv."""
    laboratory: Laboratory | None = None
    """Who measured what, as rig file and plan say; a later session may say it better."""


@dataclass(frozen=True)
class RunRequest:
    """What a run is asked to be."""

    plan: Plan
    description: RigDescription
    sample: SampleDescription | None
    seed: int
    command: str
    """The command line, for the record."""
    assessed: list[Assessed] | None = None
    """What `assess` made of the plan, where it has been called already."""

    @cached_property
    def points(self) -> list[Assessed]:
        """The plan's points, as `description` sees them: a second for ten thousand."""
        return assess(self.plan, self.description) if self.assessed is None else self.assessed


def settings_for(request: RunRequest, description: RigDescription) -> RunSettings:
    versions = {"python": platform.python_version()}
    for name in RECORDED:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    return RunSettings(
        run=Header(
            format=FORMAT,
            created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
            command=request.command,
            plan=request.plan.name,
            plan_sha256=request.plan.sha256,
            wavelength_nm=request.plan.wavelength_nm,
            bands=tuple(band.name for band in request.plan.bands(description)),
            polarisation=request.plan.polarisation,
            rig=description.rig,
            seed=request.seed,
            id=secrets.token_hex(16),
        ),
        versions=versions,
        rig=description.model_copy(update={"laboratory": None}),
        sample=request.sample,
        adaptive=request.plan.adaptive,
        laboratory=merged(description.laboratory, request.plan.laboratory),
    )


def differences(was: RunSettings, now: RunSettings) -> list[str]:
    """What keeps a run from being resumed with other settings, a line each."""
    out = []
    if was.run.plan_sha256 != now.run.plan_sha256:
        out.append(f'plan: the points or wavelengths of "{now.run.plan}" are not those of "{was.run.plan}"')
    if was.run.seed != now.run.seed:
        out.append(f"seed: {was.run.seed} in the run, {now.run.seed} now")
    out += _other_calibrations(was.rig, now.rig)
    out += _differing_keys("rig", *(_comparable(one.rig).model_dump(mode="json") for one in (was, now)))
    samples = [s.model_dump(mode="json") if s is not None else {} for s in (was.sample, now.sample)]
    return out + _differing_keys("sample", *samples)


def _other_calibrations(was: RigDescription, now: RigDescription) -> list[str]:
    """Calibrations that only one of two has, or that differ in content, a line each: their covariance is the run's."""
    before, after = ({known.file: known for known in rig.calibration.known} for rig in (was, now))
    out = []
    for file in dict.fromkeys([*before, *after]):
        old, new = before.get(file), after.get(file)
        if old is None:
            out.append(f"calibration {file}: not in the run")
        elif new is None:
            out.append(f"calibration {file}: in the run, and not in the rig file now")
        elif old.sha256 != new.sha256:
            out.append(f"calibration {file}: made on {old.made} in the run, and another one, made on {new.made}, now")
    return out


def _comparable(description: RigDescription) -> RigDescription:
    """Of files that the rig names the content counts, not where they lie; what pauses a run may change.

    So may what only warns of calibrations. Which these are is compared by `_other_calibrations`; the keys that they
    give, and what these keys replaced, with all others.
    """
    use = CalibrationUse(replaced=description.calibration.replaced)
    description = description.model_copy(update={"suspend": {}, "calibration": use})
    for table, key in NAMED_FILES:
        path = getattr(getattr(description, table), key)
        if path is not None:
            with contextlib.suppress(OSError):
                path = hashlib.sha256(read_file(path)).hexdigest()[:12]
        description = _with_file(description, table, key, path)
    return description


def _differing_keys(name: str, was: Any, now: Any) -> list[str]:
    if isinstance(was, dict) and isinstance(now, dict):
        return [
            line
            for key in dict.fromkeys([*was, *now])
            for line in _differing_keys(f"{name}.{key}", was.get(key), now.get(key))
        ]
    return [] if was == now else [f"{name}: {json.dumps(was)} in the run, {json.dumps(now)} now"]


def named_files(description: RigDescription) -> tuple[dict[str, bytes], RigDescription]:
    """The files that the rig names, to be copied into the run so that this can be reduced without their folders."""
    files: dict[str, bytes] = {}
    for (table, key), (name, what) in NAMED_FILES.items():
        path = getattr(getattr(description, table), key)
        if path is None:
            continue
        source = Path(path)
        try:
            files[name] = read_file(source)
            if name.endswith(".csv"):
                _require_whole(source, files[name])
                if meta_path(source).exists():
                    files[meta_path(Path(name)).name] = read_file(meta_path(source))
        except FileNotFoundError:
            raise ConfigError(f"{source}: {what} ([{table}] {key}) is not there") from None
        description = _with_file(description, table, key, name)
    return files, description


def _require_whole(source: Path, data: bytes) -> None:
    """`ConfigError` where a table is read with what lies beside it, from which its copy is taken away."""
    from gonio.formats import own_pairs, rt300s

    own = own_pairs.beside(source) is not None
    if own or rt300s.FORMAT.sniff(data):
        beside = own_pairs.beside_path(source).name if own else "a blank"
        raise ConfigError(
            f"{source}: reference.table is read with {beside} beside it, and a run keeps the table alone; "
            f"write it anew with `gonio convert {source} OUT.csv` and name that one"
        )


def resolved(settings: RunSettings, path: Path) -> RunSettings:
    """The settings with the paths of the files that the rig names made whole."""
    rig = settings.rig
    for table, key in NAMED_FILES:
        name = getattr(getattr(rig, table), key)
        rig = _with_file(rig, table, key, str(path / name) if name is not None else None)
    return settings.model_copy(update={"rig": rig})


def _with_file(description: RigDescription, table: str, key: str, path: str | None) -> RigDescription:
    inner = getattr(description, table)
    if getattr(inner, key) == path:
        return description
    return description.model_copy(update={table: inner.model_copy(update={key: path})})
