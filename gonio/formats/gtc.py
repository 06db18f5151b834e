"""Archives of GTC (GUM Tree Calculator): values with all their correlations, to go on computing with.

Each value is an uncertain number: its independent part, and one influence for each common cause, which all values of
the table have in common. Tags are "brdf_0", "brdf_1", ... by row; the label of a value names its directions. Where a
direction of incidence covers the hemisphere, its directional-hemispherical reflectance is computed by GTC from these
values, and tagged "rho_dh_<theta_i>". Degrees of freedom count as infinite. A flagged value is left out, and so is
one without an uncertainty. `GTC.persistence.load_json` opens the file.
"""

from pathlib import Path
from typing import Any

import numpy as np

from gonio.checks import hemisphere
from gonio.checks.values import CheckedValues
from gonio.errors import ConfigError, DataError
from gonio.formats.native import uncertainty
from gonio.formats.reader import Format, write_bytes
from gonio.geometry import Directions
from gonio.typing import DataFrame

MOST = 20_000
"""Values of one archive: each is some hundred bytes for every cause."""


def write(frame: DataFrame, path: Path) -> None:
    """The table's usable values as uncertain numbers, and rho_dh where they surround the hemisphere."""
    try:
        import GTC  # type: ignore[import-untyped]
        from GTC import persistence
    except ImportError:
        raise ConfigError("GTC archives need the package GTC: pip install gonio[gtc]") from None
    random, common, causes = uncertainty(frame)
    rows = np.flatnonzero(_usable(frame) & np.isfinite(random) & np.isfinite(common).all(axis=1))
    if not rows.size:
        raise DataError(f"{path}: no value has an uncertainty and no flag; an archive would be empty")
    if rows.size > MOST:
        raise DataError(f"{path}: an archive holds at most {MOST} values, and {rows.size} are usable; take a part")
    influences = [GTC.ureal(0.0, 1.0, label=f"s_{name}") for name in causes]
    archive = persistence.Archive()
    values: dict[int, Any] = {}
    for k, (row, labelled) in enumerate(zip(rows.tolist(), _labels(frame.iloc[rows]), strict=True)):
        own = GTC.ureal(float(frame["brdf"].iloc[row]), float(random[row]), label=f"u_random {k}")
        whole = own + sum((float(s) * z for s, z in zip(common[row], influences, strict=True) if s), start=0.0)
        values[row] = GTC.result(whole, label=labelled)
        archive.add(**{f"brdf_{row}": values[row]})
    for tag, rho in _reflectances(frame, rows, random, common, values):
        archive.add(**{tag: GTC.result(rho, label=tag)})
    write_bytes(path, persistence.dumps_json(archive).encode())


def _usable(frame: DataFrame) -> Any:
    side = frame["side"].fillna("reflection") if "side" in frame.columns else "reflection"
    return ((frame["flag"].fillna("") == "") & frame["brdf"].notna() & (side == "reflection")).to_numpy()


def _labels(frame: DataFrame) -> list[str]:
    columns = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm")
    texts = zip(*(frame[name] for name in columns), strict=True)
    return [f"BRDF 1/sr at {i:g}, {a:g}; {r:g}, {b:g} deg; {nm:g} nm" for i, a, r, b, nm in texts]


def _reflectances(
    frame: DataFrame, rows: Any, random: Any, common: Any, values: dict[int, Any]
) -> list[tuple[str, Any]]:
    """rho_dh by tags, as sums of uncertain numbers; by wavelength and angle of incidence."""
    out = []
    waves = frame["wavelength_nm"].to_numpy(float)[rows]
    several = np.unique(waves[np.isfinite(waves)])
    for wave in several if several.size else [np.nan]:
        here = rows[waves == wave] if np.isfinite(wave) else rows
        part = frame.iloc[here]
        data = CheckedValues(Directions.from_table(part), part["brdf"].to_numpy(float), random[here], common[here])
        for found in hemisphere.reflectances(data):
            if found.rho_dh is None:
                continue
            tag = f"rho_dh_{found.theta_i_deg:g}" + (f"_{wave:g}_nm" if several.size > 1 else "")
            pairs = [(float(w), int(row)) for w, row in zip(found.weights, here, strict=True) if w]
            out.append((tag, sum((w * values[row] for w, row in pairs), start=0.0)))
    return out


def _refused(data: bytes, path: Path) -> DataFrame:
    raise DataError(f"{path}: GTC archives are written, not read: they do not keep what was measured where")


FORMAT = Format(
    name="gtc",
    title="GTC archive",
    endings=(".gtc.json",),
    sniff=lambda head: b"/gtc/json_" in head,
    read=_refused,
    write=write,
    carries=frozenset({"uncertainty"}),
)
