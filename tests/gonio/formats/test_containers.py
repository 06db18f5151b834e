"""Tables in NeXus, Parquet and workbooks: what comes back, what others see in them, and what damaged ones say."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.formats import curve_sheets
from gonio.formats.reader import table

ENDINGS = (".h5", ".nxs", ".parquet", ".xlsx")


@pytest.fixture
def frame() -> pd.DataFrame:
    """Two incidences, two planes, two wavelengths, a flag, a hole, and numbers whose last bit counts."""
    rows = [
        (theta, phi_r, theta_r, nm)
        for nm in (450.0, 632.8)
        for theta in (10.0, 45.03)
        for phi_r in (0.0, 180.0, 90.0, 270.0)
        for theta_r in (0.0, 20.0, 70.1)
    ]
    theta_i, phi_r, theta_r, nm = (np.array(column) for column in zip(*rows, strict=True))
    brdf = np.nextafter(0.1 + 0.01 * np.arange(len(rows)), 1.0) / 3.0
    brdf[5] = np.nan
    out = table(
        theta_i_deg=theta_i, phi_i_deg=0.0, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=nm, brdf=brdf,
        u_brdf=0.01 * brdf, u_random=0.004 * brdf, flag=np.where(np.arange(len(rows)) == 7, "saturated", ""),
        attrs={"sample": "Höhe [1/2]: rough", "source_solid_angle_sr": 1e-4, "provenance": {"rig": {"name": "θ"}}},
    )  # fmt: skip
    out.insert(9, "s_lamp", 0.002 * np.nan_to_num(brdf))
    return out


def same(a: pd.DataFrame, b: pd.DataFrame, *, relative: float) -> None:
    assert list(a.columns) == list(b.columns)
    for name in a.columns:
        if a[name].dtype.kind == "f":
            np.testing.assert_allclose(a[name], b[name], rtol=relative, atol=0.0)
        else:
            assert a[name].tolist() == b[name].tolist()
    attrs = [
        json.dumps({k: v for k, v in x.attrs.items() if k not in ("format", "notes", "source_file")}) for x in (a, b)
    ]
    assert attrs[0] == attrs[1]


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_table_comes_back_as_it_was(frame: pd.DataFrame, tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"table{ending}"
    assert measurement.write(frame, file) == []
    # workbooks hold 16 digits: a unit in the 16th at most
    same(frame, measurement.read(file), relative=1e-15 if ending == ".xlsx" else 0.0)


def test_h5py_alone_draws_a_curve(frame: pd.DataFrame, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed (pip install gonio[hdf5])")
    measurement.write(frame, tmp_path / "t.h5")
    with h5py.File(tmp_path / "t.h5") as file:
        entry = file[file.attrs["default"]]
        curve = entry[entry.attrs["default"]]
        assert [node.attrs["NX_class"] for node in (file, entry, curve)] == ["NXroot", "NXentry", "NXdata"]
        signal, axis = curve[curve.attrs["signal"]], curve[curve.attrs["axes"][0]]
        assert (signal.attrs["units"], axis.attrs["units"]) == ("1/sr", "degree")
        # two rows stand for the normal, one of each half plane, and one of the other plane
        assert axis[()].tolist() == [-70.1, -20.0, 0.0, 0.0, 0.0, 0.0, 20.0, 70.1]
        assert curve["brdf_errors"].shape == signal.shape
        assert len([name for name in entry if name.startswith("curve_")]) == len(
            list(curve_sheets.curves(frame, tmp_path))
        )
        assert entry["table/brdf"].shape == (len(frame),)
        assert entry["sample/name"].asstr()[()] == "Höhe [1/2]: rough"


def test_pandas_alone_opens_workbook_and_parquet(frame: pd.DataFrame, tmp_path: Path) -> None:
    for ending in (".xlsx", ".parquet"):
        measurement.write(frame, tmp_path / f"t{ending}")
    np.testing.assert_array_equal(pd.read_parquet(tmp_path / "t.parquet")["brdf"], frame["brdf"])
    sheets = pd.read_excel(tmp_path / "t.xlsx", sheet_name=None)
    first, *_, last = sheets
    assert (first, last) == ("table", "about")
    curves = list(sheets.values())[1:-1]
    assert sum(len(one) for one in curves) == len(frame)
    for one in curves:
        assert (np.diff(one["viewing angle [deg]"].to_numpy()) >= 0).all()
    assert all(len(name) <= 31 and not set(name) & set("[]:*?/\\'") for name in sheets)


def test_the_mirror_side_of_a_curve_is_positive(frame: pd.DataFrame, tmp_path: Path) -> None:
    first = next(iter(curve_sheets.curves(frame, tmp_path)))
    assert set(first.rows["phi_r_deg"][first.signed_deg > 0]) == {180.0}
    assert set(first.rows["phi_r_deg"][first.signed_deg < 0]) == {0.0}


def test_a_table_of_many_curves_is_written_whole(tmp_path: Path) -> None:
    many = table(
        theta_i_deg=np.linspace(0, 80, curve_sheets.MOST + 1), phi_i_deg=0.0, theta_r_deg=30.0, phi_r_deg=180.0,
        wavelength_nm=550.0, brdf=0.3, attrs={},
    )  # fmt: skip
    assert "more than 500 curves" in " ".join(measurement.write(many, tmp_path / "t.h5"))
    same(many, measurement.read(tmp_path / "t.h5"), relative=0.0)
    with pytest.raises(DataError, match="501 curves, and at most 500"):
        measurement.write(many, tmp_path / "t.xlsx")
    assert not (tmp_path / "t.xlsx").exists()


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_damaged_file_is_named(frame: pd.DataFrame, tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"table{ending}"
    measurement.write(frame, file)
    data = file.read_bytes()
    for cut in (12, len(data) // 2, len(data) - 30):
        file.write_bytes(data[:cut])
        with pytest.raises(DataError, match=f"table{ending}"):
            measurement.read(file)


@pytest.mark.parametrize(("ending", "package", "extra"), [(".h5", "h5py", "hdf5"), (".parquet", "pyarrow", "parquet")])
def test_a_missing_package_is_named(
    frame: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, package: str, extra: str
) -> None:
    frame = frame.astype({name: object for name in frame.columns if frame[name].dtype.kind == "O"})  # none of Arrow's
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=rf"{package}: pip install gonio\[{extra}\]"):
        measurement.write(frame, tmp_path / f"t{ending}")
    assert not list(tmp_path.iterdir())


def test_an_hdf5_file_of_somebody_else_is_no_table(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed (pip install gonio[hdf5])")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["data"] = np.arange(3.0)
    with pytest.raises(DataError, match="HDF5 without a table of gonio"):
        measurement.read(tmp_path / "x.h5")


def test_what_the_header_of_astm_lacks_is_named(frame: pd.DataFrame, tmp_path: Path) -> None:
    plain = frame.assign(flag="")[frame["brdf"].notna()]
    plain.attrs = dict(frame.attrs) | {"provenance": {"reduced_by": "gonio"}}
    said = " ".join(measurement.write(plain, tmp_path / "t.astm"))
    assert "LAB_NAME (laboratory.organisation), LAB_OPERATOR (laboratory.operator), MEAS_DATE" in said
    laboratory = {"organisation": "PTB", "operator": "A. B.", "measured": "2026-11-23T10:00:00+00:00"}
    plain.attrs["provenance"] = {"reduced_by": "gonio", "laboratory": laboratory}
    assert "header lacks" not in " ".join(measurement.write(plain, tmp_path / "t.astm"))
    assert (tmp_path / "t.astm").read_text(encoding="utf-8").startswith("LAB_NAME PTB\n")
