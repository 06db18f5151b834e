"""What a run's own record says of how its table was made."""

from __future__ import annotations

from pathlib import Path

from gonio_analysis.result_records import RunFacts, SampleFacts

REFERENCE = {"beside": "beside the sample", "axis": "brought by an axis", "swap": "swapped with the sample by hand"}


def run_facts(path: Path) -> RunFacts | None:
    """What a RUN folder's record says of how its table was made; None for a path that is no run."""
    folder = path if path.is_dir() else path.parent
    if path.is_file() and path.name != "brdf.csv":
        return None
    if not (folder / "run.toml").is_file():
        return None
    from gonio.acquisition.run import Run

    run = Run.open(folder)
    settings = run.settings
    plan = run.plan
    cannot = plan["flag"].astype(str)
    rig = settings.rig
    return RunFacts(
        folder=str(folder),
        plan=settings.run.plan,
        plan_sha256=settings.run.plan_sha256,
        points=len(plan),
        points_not_reachable={str(k): int(v) for k, v in cannot[cannot != ""].value_counts().items()},
        created=settings.run.created,
        command=settings.run.command,
        rig=rig.name,
        driver=settings.run.rig,
        seed=settings.run.seed,
        bands=list(settings.run.bands),
        steps=len(run.steps()),
        versions=dict(settings.versions),
        lamp_half_angle_deg=rig.lamp.half_angle_deg,
        lens_half_angle_deg=rig.camera.lens_half_angle_deg,
        reference=f"{REFERENCE[rig.reference.how]}; standard uncertainty {100 * rig.reference.u_rel:g} %",
        sample=None
        if settings.sample is None
        else SampleFacts(settings.sample.name, settings.sample.model, dict(settings.sample.parameters)),
    )
