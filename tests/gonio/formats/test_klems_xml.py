"""Klems matrices: which element is which pair of directions, and both sides of a window."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats import klems_xml
from gonio.typing import Floats


def window(
    side: str = "Front",
    kind: str = "Reflection",
    structure: str = "Columns",
    data: str = "11 12 13 21 22 23 31 32 33",
) -> bytes:
    """One patch at the normal and two at 45 degrees, of azimuth 0 and 180."""
    return f"""<?xml version="1.0"?><WindowElement xmlns="http://windows.lbl.gov"><Optical><Layer>
    <Material><Name>Blind</Name></Material>
    <DataDefinition><IncidentDataStructure>{structure}</IncidentDataStructure><AngleBasis><AngleBasisName>B</AngleBasisName>
    <AngleBasisBlock><Theta>0</Theta><nPhis>1</nPhis></AngleBasisBlock>
    <AngleBasisBlock><Theta>45</Theta><nPhis>2</nPhis></AngleBasisBlock></AngleBasis></DataDefinition>
    <WavelengthData><Wavelength unit="Integral">Visible</Wavelength><WavelengthDataBlock>
    <WavelengthDataDirection>{kind} {side}</WavelengthDataDirection><ColumnAngleBasis>B</ColumnAngleBasis>
    <RowAngleBasis>B</RowAngleBasis><ScatteringData>{data}</ScatteringData></WavelengthDataBlock></WavelengthData>
    </Layer></Optical></WindowElement>""".encode()


def value(frame: pd.DataFrame, *angles: float) -> float:
    columns = ["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"]
    return float(frame.loc[(frame[columns] == list(angles)).all(axis=1), "brdf"].item())


def test_columns_are_incidence_and_the_diagonal_is_the_mirror() -> None:
    frame = measurement.parse(window(), Path("blind.xml"))
    assert frame.attrs["samples"] == ["Blind front Visible"]
    assert value(frame, 45, 180, 45, 0) == 22  # patch 2 in, patch 2 out: mirror, dphi = 180
    assert value(frame, 45, 180, 45, 180) == 32  # column 2, row 3: retro
    assert value(frame, 0, 180, 45, 0) == 21  # normal incidence is the first column
    assert value(measurement.parse(window(structure="Rows"), Path("blind.xml")), 0, 180, 45, 0) == 12
    assert frame["wavelength_nm"].isna().all()


def test_azimuths_are_radiances_and_its_normal_side_is_the_back(tmp_path: Path) -> None:
    """Radiance's rtrace (pyradiance 1.3.1) finds the value of this pair in these directions, of either side."""
    four = b"<AngleBasisBlock><Theta>45</Theta><nPhis>4</nPhis></AngleBasisBlock></AngleBasis>"
    for side, phi_i, phi_r in (("Back", 270.0, 0.0), ("Front", 90.0, 0.0)):
        data = window(side, data=" ".join(map(str, range(1, 17))))
        head, _, tail = data.partition(b"<AngleBasisBlock>")
        frame = measurement.parse(head + four + tail.partition(b"</AngleBasis>")[2], Path("blind.xml"))
        # the second column travels toward azimuth 90 on the back, and the first row leaves toward 0
        assert value(frame, 45, phi_i, 45, phi_r) == 2
    klems_xml.write(klems_xml.averaged(lambda ti, pi, tr, pr: 0.1 + 0 * (ti + pi + tr + pr), "a"), tmp_path / "a.xml")
    assert "<WavelengthDataDirection>Reflection Back<" in (tmp_path / "a.xml").read_text(encoding="utf-8")


def test_transmission_goes_on_behind_the_lit_side() -> None:
    frame = measurement.parse(window(kind="Transmission"), Path("blind.xml"))
    assert (set(frame["side"]), frame.attrs["quantity"]) == ({"transmission"}, "btdf")
    # patch 2 in, patch 2 out: straight through, theta_r = 180 - theta_i and phi_r = phi_i + 180
    assert (value(frame, 45, 180, 135, 0), value(frame, 0, 180, 180, 0)) == (22, 11)
    assert value(frame, 45, 180, 135, 180) == 32


def test_both_kinds_of_one_side_are_one_sample(tmp_path: Path) -> None:
    block = window().partition(b"<WavelengthData>")[2].partition(b"</Layer>")[0]
    through = block.replace(b"Reflection", b"Transmission").replace(b"11 12", b"81 82")
    both = window().replace(b"</Layer>", b"<WavelengthData>" + through + b"</Layer>")
    frame = measurement.parse(both, Path("blind.xml"))
    assert (frame.attrs["samples"], frame.attrs["quantity"]) == (["Blind front Visible"], "bsdf")
    assert value(frame[frame["side"] == "reflection"], 0, 180, 0, 0) == 11
    assert value(frame[frame["side"] == "transmission"], 0, 180, 180, 0) == 81


def test_a_screen_lets_most_light_straight_through(shared: Callable[[str], Path]) -> None:
    """A woven shade of 5 % openness: the largest BTDF of each incidence is in the direction that the light came in."""
    frame = measurement.read(shared("klems/2011-SA1.XML"), sample="Satine 5500 5%, White Pearl front Visible")
    through = frame[frame["side"] == "transmission"]
    brightest = through.loc[through.groupby(["theta_i_deg", "phi_i_deg"])["brdf"].idxmax()]
    near = brightest[brightest["theta_i_deg"] <= 60]  # beyond, the weave is closed
    assert len(near) == 1 + 8 + 16 + 20 + 24 + 24 + 24
    # centres of patches are whole degrees or halves, and no rounding is in 180 - theta
    np.testing.assert_allclose(near["theta_r_deg"], 180 - near["theta_i_deg"], rtol=0, atol=0)
    off_normal = near[near["theta_i_deg"] > 0]
    # of azimuths k 360 / n a difference is rounded once or twice: 360 times 2^-52, 8e-14, each
    np.testing.assert_allclose((off_normal["phi_r_deg"] - off_normal["phi_i_deg"]) % 360, 180, rtol=0, atol=2e-13)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (window(data="1 2 3"), "has 3 numbers; 3 x 3 are needed"),
        (window(data="1 2 3 4 5 6 7 8 x"), 'number 9 is "x"'),
        (window(structure="TensorTree3"), "TensorTree3"),
        (window(side="Sideways"), "Sideways"),
        (window().replace(b"<RowAngleBasis>B", b"<RowAngleBasis>C"), 'RowAngleBasis is "C"'),
        (window()[:500], "line 6"),
        (window().replace(b"<Window", b'<!DOCTYPE x [<!ENTITY a "b">]><Window', 1), "document type"),
        (window().replace(b"<nPhis>2<", b"<nPhis>900000<"), "nPhis = "),
        (
            window().replace(b'"Integral">Visible', b'"Micron">0.55'),
            'Wavelength is "0.55", unit "Micron"; read are bands',
        ),
        (window().replace(b">Visible<", b">550<"), 'Wavelength is "550"'),
        (
            window().replace(
                b"<Theta>45</Theta>",
                b"<Theta>45</Theta><ThetaBounds><LowerTheta>0</LowerTheta><UpperTheta>0.9</UpperTheta></ThetaBounds>",
            ),
            "Theta = 45 lies outside its ThetaBounds, 0 to 0.9 degrees",
        ),
    ],
)
def test_damage_is_named(data: bytes, told: str) -> None:
    with pytest.raises(DataError) as caught:
        measurement.parse(data, Path("blind.xml"), format="klems")
    assert "blind.xml" in str(caught.value)
    assert told in str(caught.value)


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(window(), "blind.xml", format="klems")


@pytest.mark.slow
def test_round_trip_of_measured_matrices(shared: Callable[[str], Path], tmp_path: Path) -> None:
    for name, blocks in (("2011-SA1.XML", 8), ("aerc6216_kf.xml", 3)):
        frame = measurement.read(shared(f"klems/{name}"))
        assert len(frame) == blocks * 145**2
        measurement.write(frame, tmp_path / "back.xml")
        pd.testing.assert_frame_equal(measurement.read(tmp_path / "back.xml"), frame, check_exact=True)


def test_other_directions_cannot_be_a_klems_matrix(tmp_path: Path, small: pd.DataFrame) -> None:
    small["flag"] = ""
    with pytest.raises(DataError, match="145 patches"):
        measurement.write(small, tmp_path / "a.xml")
    assert list(tmp_path.iterdir()) == []


def test_averages_are_those_over_projected_solid_angles() -> None:
    """Of (2 + x_i) (2 + x_r), x = sin(theta) cos(phi): in closed form, ring by ring."""

    def mean(theta_deg: pd.Series, phi_deg: pd.Series) -> Floats:
        edges = np.array([0.0, 5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 90.0])
        ring = np.searchsorted(edges, theta_deg, side="right") - 1
        low, high = np.sin(np.radians([edges[ring], edges[ring + 1]]))
        half = np.radians(180.0 / np.array([1, 8, 16, 20, 24, 24, 24, 16, 12])[ring])
        share = 2.0 / 3.0 * (high**3 - low**3) / (high**2 - low**2) * np.sinc(half / np.pi)
        return np.asarray(share * np.cos(np.radians(phi_deg)))

    def x(theta: Floats, phi: Floats) -> Floats:
        return np.asarray(np.sin(theta) * np.cos(phi))

    found = klems_xml.averaged(lambda ti, pi, tr, pr: (2.0 + x(ti, pi)) * (2.0 + x(tr, pr)), "a", samples=4)
    expected = (2.0 + mean(found["theta_i_deg"], found["phi_i_deg"])) * (
        2.0 + mean(found["theta_r_deg"], found["phi_r_deg"])
    )
    # midpoints of four: (45 deg / 4)^2 / 24 of x, which is at most 1
    np.testing.assert_allclose(found["brdf"], expected, rtol=2e-3)
