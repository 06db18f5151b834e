"""The surfaces of HTSG's figures, the cones that they are seen through, and their simulated measurements."""

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypedDict

import numpy as np
from gonio_analysis.curves.in_plane import Curve, curves
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import Observations, observations

from gonio import geometry
from gonio.models import HeTorrance, Model
from gonio.typing import Floats, TomlTable
from gonio_validation.papers.figure import FigureParameter

PAPER = "He, Torrance, Sillion and Greenberg, A Comprehensive Physical Model for Light Reflection, SIGGRAPH 1991"
CONE_SR = math.pi / 1024
"""HTSG sec. 4: the solid angles of incident and received light in the experiments of Figs. 7 and 8."""


class FigureCones(TypedDict):
    """What lamp and lens subtend [sr], as `gonio.instrument` takes it."""

    source_solid_angle_sr: float
    receiver_solid_angle_sr: float


CONES: FigureCones = {"source_solid_angle_sr": CONE_SR, "receiver_solid_angle_sr": CONE_SR}


@dataclass(frozen=True)
class HtsgSurface:
    """A surface of He and Torrance's model."""

    sigma0_um: float
    tau_um: float
    ior: str | float
    """A material, or n."""
    diffuse_albedo: float = 0.0

    @property
    def model(self) -> HeTorrance:
        """Its BRDF."""
        return HeTorrance(self.sigma0_um, self.tau_um, self.ior, self.diffuse_albedo)

    @property
    def parameters(self) -> Mapping[str, str | float]:
        """As a sample file has them; without a diffuse part where there is none."""
        return {name: value for name, value in vars(self).items() if name != "diffuse_albedo" or value}


def index_parameter(material: str, wavelength_nm: float) -> FigureParameter:
    """The optical constants that a figure is made with."""
    from gonio import materials

    found = materials.ior(material)
    n = complex(found(wavelength_nm))
    text = f"{n.real:.4g} + {n.imag:.4g}i" if n.imag else f"{n.real:.5g} (k = 0)"
    return FigureParameter(
        f"n + ik at {wavelength_nm:g} nm", text, "database", f"{material}: {found.source}; the paper gives none"
    )


def cones_parameter(reason: str = "") -> FigureParameter:
    """The solid angles of light and detector."""
    value = f"π/1024 sr = {CONE_SR:.5f} sr each"
    if reason:
        return FigureParameter("solid angles dω_i, dω_r", value, "assumed", reason)
    return FigureParameter("solid angles dω_i, dω_r", value, "paper", "sec. 4, with Fig. 7")


def energy_limit(model: Any, wavelength_nm: float) -> tuple[float | None, float]:
    """The incidence [deg] beyond which more is reflected than falls in (None: nowhere), and the largest possible a."""
    from scipy.optimize import brentq

    def excess(theta_deg: float) -> float:
        return float(model.directional_hemispherical(math.radians(theta_deg), wavelength_nm=wavelength_nm)) - 1.0

    allowed = float(model.max_diffuse_albedo(wavelength_nm=wavelength_nm))
    tried = np.append(np.arange(0.0, 90.0, 5.0), 89.99)
    above = np.flatnonzero([excess(float(t)) > 0 for t in tried])
    if not above.size or above[0] == 0:
        return (0.0 if above.size else None), allowed
    return float(brentq(excess, tried[above[0] - 1], tried[above[0]], xtol=1e-3)), allowed


# --- the dashed curves: the simulated goniometer measures a surface, frames and reduction included ----------------


SEED = 1
BAND_NM = 10.0
AROUND_DEG = (-5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 5.0)
"""Angles from the mirror direction, beside the even steps: the spike, and the lobe on both sides of it."""

AROUND = float(np.radians(11.0))
"""How far from the mirror direction [rad] the lobe below a spike is read."""


@dataclass(frozen=True)
class Simulated:
    """What the simulated goniometer measured."""

    data: Observations
    curves: list[Curve]
    chi_square: float
    """Reduced, against the model through the rig's own apertures; nothing is fitted."""
    files: Mapping[str, bytes]
    """Rig, plan, sample and table, by their path in the page's folder."""
    words: str
    """What was done, for the page."""

    def curve(self, theta_i_deg: float) -> Curve:
        """The curve of an incidence."""
        return min(self.curves, key=lambda c: abs(np.degrees(c.parameter) - theta_i_deg))


def scan(theta_i_deg: float, step_deg: float = 5.0) -> list[float]:
    """Signed angles of one incidence [deg]: even steps from -80 to 85, finer around the mirror direction."""
    angles = np.concatenate([np.arange(-80.0, 85.1, step_deg), theta_i_deg + np.array(AROUND_DEG)])
    return [float(a) for a in np.unique(np.round(angles, 6)) if abs(a) <= 85.0]


class Measurable(Protocol):
    """A surface that the simulated goniometer can measure."""

    @property
    def model(self) -> Model:
        """Its BRDF."""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """As a sample file has them."""


def measure(
    surface: Measurable,
    *,
    name: str,
    wavelength_nm: float,
    scans: Mapping[float, Sequence[float]],
    solid_angle_sr: float,
    progress: Callable[[str], None],
) -> Simulated:
    """Measure and reduce one surface on the rig "sim", whose lamp, lens and band are made those of the figure.

    Parameters
    ----------
    surface
        What is measured.
    name
        Of the surface.
    wavelength_nm
        Centre of the rig's only band [nm].
    scans
        Incidence [deg] -> signed angles of reflection [deg].
    solid_angle_sr
        Of lamp and lens, each [sr].
    progress
        Called with a line before the measurement.
    """
    from gonio import measurement
    from gonio.config import to_toml
    from gonio.lab.acquisition.measure import carry_out, find_rig
    from gonio.lab.acquisition.plan import load_plan
    from gonio.lab.reduction import brdf
    from gonio.samples.files import load_sample

    points = sum(map(len, scans.values()))
    progress(f"{name}: measuring {points} directions on the simulated goniometer")
    with tempfile.TemporaryDirectory(prefix="gonio-figure-") as temporary:
        folder = Path(temporary)
        sweeps = [{"theta_i_deg": [i], "theta_r_deg": list(r)} for i, r in scans.items()]
        plan = {"name": name, "wavelength_nm": [wavelength_nm], "sweep": sweeps}
        sample = {"name": name, "model": surface.model.name, "parameters": dict(surface.parameters)}
        tables = {"rig": _rig(name, wavelength_nm, solid_angle_sr), "plan": plan, "sample": sample}
        for kind, table in tables.items():
            (folder / f"{kind}.toml").write_text(to_toml(table), encoding="utf-8", newline="\n")
        asked = load_plan(folder / "plan.toml"), find_rig(str(folder / "rig.toml")), folder / "run"
        frame = brdf.reduce(carry_out(*asked, sample=load_sample(folder / "sample.toml"), seed=SEED, yes=True))
        frame.attrs["source_file"] = "RUN"  # the temporary folder is nobody's business
        measurement.write(frame, folder / "brdf.csv")
        kept = [*(f"{kind}.toml" for kind in tables), "brdf.csv", "brdf.meta.json"]
        files = {f"simulated/{file}": (folder / file).read_bytes() for file in kept}
    data = observations(frame, name)
    assert data.covariance is not None  # the rig "sim" states its uncertainties
    seen = apparent(surface.model, data)
    chi = data.covariance.scaled(seen / data.brdf, seen).chi_square(data.brdf - seen) / len(data)
    words = (
        f"{len(data)} of {points} directions on the rig sim, seed {SEED}, lamp and lens of {solid_angle_sr:.5f} sr "
        "each; to repeat it, in simulated/: gonio measure plan.toml --rig rig.toml --sample sample.toml --seed "
        f"{SEED} --out RUN --yes; gonio reduce RUN"
    )
    return Simulated(data, curves(data), chi, files, words)


def beside(curve: Curve, theta_i_deg: float, width: float) -> float | None:
    """Measured spike over measured lobe in the mirror direction.

    The lobe there is a parabola through the logarithms of the values around, from `width` (the sum of the cones'
    half-angles [rad], as far as a spike reaches) to `AROUND`. None where the mirror direction or the lobe on one side
    of it was not measured.
    """
    away = curve.angle - np.radians(theta_i_deg)
    k = curve.mirror
    near = (np.abs(away) > width) & (np.abs(away) <= AROUND) & (curve.brdf > 0)
    if k is None or np.count_nonzero(near & (away < 0)) < 1 or np.count_nonzero(near & (away > 0)) < 1:
        return None
    degree = 2 if np.count_nonzero(near) > 2 else 1
    lobe = float(np.exp(np.polynomial.Polynomial.fit(away[near], np.log(curve.brdf[near]), degree)(0.0)))
    return float(curve.brdf[k]) / lobe - 1.0


def divided(curve: Curve, by: float) -> tuple[Floats, Floats, Floats]:
    """Angles [rad], values and uncertainties of a curve, divided."""
    return curve.angle, curve.brdf / by, curve.u / by


def _rig(name: str, wavelength_nm: float, solid_angle_sr: float) -> TomlTable:
    """The tables of the rig "sim", with a lamp and a lens of this solid angle, one band, and a small sensor."""
    from gonio.lab.acquisition.measure import find_rig

    half = float(geometry.half_angle_of_cone(solid_angle_sr))
    tables: TomlTable = find_rig("sim").description.model_dump(mode="json", exclude_none=True, exclude={"devices"})
    tables["name"] = f"simulated goniometer for {name}"
    tables["lamp"]["half_angle_deg"] = tables["camera"]["lens_half_angle_deg"] = float(np.degrees(half))
    tables["camera"].update(width=64, height=48)  # the region of interest, and little else
    for arm in ("light", "camera"):  # a body is wider than the disc that it carries
        distance = tables["geometry"][f"{arm}_distance_mm"]
        tables["geometry"][f"{arm}_body_radius_mm"] = round(float(np.tan(half)) * distance + 4.0, 1)
    tables["bands"] = {"list": [{"name": f"{wavelength_nm:g} nm", "centre_nm": wavelength_nm, "fwhm_nm": BAND_NM}]}
    return tables
