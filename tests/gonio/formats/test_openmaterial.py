"""OpenMATERIAL's look-up tables: metres, radians, and an azimuth from the direction of incidence."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError

ROWS: list[list[float | None]] = [
    [5.5e-07, 0.174533, 0.0, 0.0, 0.11],
    [5.5e-07, 0.174533, 0.174533, math.pi, 0.35],
    [5.5e-07, 0.523599, 0.872665, 1.570796, None],
    [9.05e-07, 0.523599, 1.570796, 0.0, 0.02],
]
NAMES = {"name": "grey tile", "sources": "measurement"}


def document(rows: object = ROWS, **more: object) -> bytes:
    return json.dumps({"metadata": NAMES, "brdf": {"wavelengths": [5.5e-07], "lookupTable": rows, **more}}).encode()


def parse(data: bytes) -> pd.DataFrame:
    return measurement.parse(data, Path("tile.xompt"))


def test_six_decimals_are_degrees_and_pi_is_the_mirror() -> None:
    frame = parse(document(receiverSolidAngles=[{"wavelength": 5.5e-07, "solidAngle": 0.002}]))
    assert (frame.attrs["format"], frame.attrs["sample"]) == ("openmaterial", "grey tile")
    assert frame["wavelength_nm"].tolist() == [550.0, 550.0, 550.0, 905.0]
    assert frame["theta_i_deg"].tolist() == [10.0, 10.0, 30.0, 30.0]
    assert frame["theta_r_deg"].tolist() == [0.0, 10.0, 50.0, 90.0]  # 1.570796 is the schema's largest
    assert frame["phi_r_deg"].tolist()[:2] == [0.0, 180.0]
    assert frame["brdf"].tolist()[:2] == [0.11, 0.35]
    assert frame["flag"].tolist() == ["", "", "not_measured", ""]
    assert frame.attrs["receiver_solid_angle_sr"] == 0.002
    assert "taken as the BRDF in 1/sr" in frame.attrs["notes"][0]


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (document([row[:4] for row in ROWS]), "brdf.lookupTable[0] has 4 numbers; five are needed: wavelength [m]"),
        (document([[550.0, 0, 0, 0, 0.1]]), "brdf.lookupTable[0][0] = 550, a wavelength in metres is needed"),
        (document([[5e-7, 30.0, 0, 0, 0.1]]), "brdf.lookupTable[0][1] = 30: incident zenith angle in radians"),
        (document([[5e-7, None, 0, 0, 0.1]]), "brdf.lookupTable[0][1] is None, not a number"),
        (document("no"), "brdf.lookupTable is 'no'; an array of rows is needed"),
        (
            document(receiverSolidAngles=[{"solidAngle": "x"}]),
            "brdf.receiverSolidAngles[0].solidAngle is 'x', not a number",
        ),
        (b'{"reflectionCoefficient": {"lookupTable": []}}', 'has no object "brdf"'),
    ],
)
def test_damage_is_located(data: bytes, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(f"tile.xompt: {told}")):
        parse(data)


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(document(), "tile.xompt", format="openmaterial")


def written(frame: pd.DataFrame, path: Path) -> Any:
    measurement.write(frame, path)
    return json.loads(path.read_text(encoding="utf-8"))


def test_round_trip(small: pd.DataFrame, tmp_path: Path) -> None:
    small["brdf"] = small["brdf"].abs()
    small["phi_i_deg"], small["phi_r_deg"] = 40.0, (small["phi_r_deg"] + 40.0) % 360.0
    small.loc[0, "theta_r_deg"] = 90.0
    small.attrs["receiver_solid_angle_sr"] = 0.01
    content = written(small, tmp_path / "a.xompt")
    table = np.array(content["brdf"]["lookupTable"])
    assert table.shape == (11, 5)  # one row is flagged
    assert (np.lexsort(table.T[::-1]) == np.arange(11)).all()  # sorted by the columns, as the schema asks
    assert set(content["metadata"]) >= {
        "name",
        "uuid",
        "materialVersion",
        "copyrights",
        "license",
        "authors",
        "sources",
    }
    again = measurement.read(tmp_path / "a.xompt")
    assert again.attrs["receiver_solid_angle_sr"] == 0.01
    place = ["wavelength_nm", "theta_i_deg", "theta_r_deg", "dphi", "brdf"]
    used = small[small["flag"] == ""]
    expected, found = (
        f.assign(dphi=(f["phi_r_deg"] - f["phi_i_deg"]) % 360)[place].sort_values(place[:4]).to_numpy()
        for f in (used, again)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)  # radians of 16 digits
    assert content["metadata"]["uuid"] == written(small, tmp_path / "b.xompt")["metadata"]["uuid"]


def test_what_a_file_cannot_hold_is_refused(small: pd.DataFrame, tmp_path: Path) -> None:
    usable = small[small["flag"] == ""].assign(brdf=0.1).reset_index(drop=True)
    usable.attrs = small.attrs
    for changed, told in (
        (usable.assign(wavelength_nm=math.nan), "a wavelength in each"),
        (usable.assign(phi_i_deg=np.arange(len(usable)) * 1.0), "several azimuths of incidence"),
        (usable.assign(brdf=-0.1), "11 values are below zero, which the schema forbids"),
        (usable.assign(theta_r_deg=5.0, phi_r_deg=0.0, brdf=np.arange(len(usable))), "one value for a direction"),
    ):
        with pytest.raises(DataError, match=re.escape(told)):
            measurement.write(changed, tmp_path / "a.xompt")
    assert list(tmp_path.iterdir()) == []
