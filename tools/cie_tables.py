"""Writes gonio/colour/observer.csv and illuminants.csv from the CIE's data in the package `colour-science`.

    python tools/cie_tables.py

The observer is that of CIE 018, at 1 nm from 360 to 830 nm. The illuminants are those of CIE 15, at 5 nm. There the
tables end at 780 nm; from 785 to 830 nm illuminant A follows its defining formula and D65 and D50 the CIE's daylight
components, which have to give the tabulated values below 780 nm too.
"""

from __future__ import annotations

from pathlib import Path

import colour
import numpy as np

OUT = Path(__file__).resolve().parents[1] / "gonio" / "colour"
NM = np.arange(360, 831, 5)
PLANCK_NM_K = 1.435e7  # c_2 as CIE 15 has it in the definition of illuminant A


def tungsten(nm: np.ndarray) -> np.ndarray:
    """Illuminant A by its definition."""
    shape = nm**-5.0 / np.expm1(PLANCK_NM_K / (2848.0 * nm))
    return 100.0 * shape / (560.0**-5.0 / np.expm1(PLANCK_NM_K / (2848.0 * 560.0)))


def daylight(nm: np.ndarray, kelvin: float) -> np.ndarray:
    """A daylight illuminant by its components, whose correlated temperature was named when c_2 was 1.4380."""
    xy = colour.temperature.CCT_to_xy_CIE_D(kelvin * 1.4388 / 1.4380)
    components = colour.colorimetry.sd_CIE_illuminant_D_series(xy)
    return np.interp(nm, components.wavelengths, components.values)


def extended(name: str, by_rule: np.ndarray) -> np.ndarray:
    table = colour.SDS_ILLUMINANTS[name]
    known = table.wavelengths[-1] >= NM
    values = by_rule.copy()
    values[known] = [table[float(nm)] for nm in NM[known]]
    worst = float(np.max(np.abs(by_rule - values)))
    if worst > 1e-3:  # the tables have three to four decimals
        raise SystemExit(f"illuminant {name}: the rule differs from the table by {worst:g}")
    print(f"illuminant {name}: the rule gives the table to {worst:.1g} of 100")
    return np.round(values, 6)


def main() -> None:
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    rows = ["wavelength_nm,x,y,z"]
    rows += [
        f"{nm:.0f}," + ",".join(f"{v:.12g}" for v in row)
        for nm, row in zip(observer.wavelengths, observer.values, strict=True)
    ]
    (OUT / "observer.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    lights = [
        extended("D65", daylight(NM, 6500.0)),
        extended("A", tungsten(NM.astype(float))),
        extended("D50", daylight(NM, 5000.0)),
    ]
    rows = ["wavelength_nm,D65,A,D50"]
    rows += [f"{nm}," + ",".join(f"{v:.9g}" for v in row) for nm, row in zip(NM, np.transpose(lights), strict=True)]
    (OUT / "illuminants.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
