"""Models as renderers' files: Mitsuba's tensor file, Klems XML for Radiance, MERL; and Mitsuba's own reading of one."""

import math
from pathlib import Path

import numpy as np
import pytest

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.formats.rgl import RglMeasured
from gonio.models import AnisotropicFacets, CookTorrance, HeTorrance, Lambert, OrenNayar

GLOSSY = CookTorrance(0.5, 0.5, 0.2, 1.5, diffuse_albedo=0.3, convention="normalised")


def directions(count: int) -> np.ndarray:
    """Pairs of directions to 75 degrees (4, count) [rad], every other one near the mirror direction."""
    dice = np.random.default_rng(7)
    theta_i, theta_r = np.arccos(dice.uniform(math.cos(math.radians(75)), 1.0, (2, count)))
    phi_i, phi_r = dice.uniform(0.0, 2 * math.pi, (2, count))
    theta_r[::2], phi_r[::2] = theta_i[::2], phi_i[::2] + math.pi + 0.05 * dice.standard_normal(count)[::2]
    return np.stack([theta_i, phi_i, theta_r, np.mod(phi_r, 2 * math.pi)])


def test_a_tensor_file_interpolates_its_model(tmp_path: Path) -> None:
    measurement.write_model(GLOSSY, tmp_path / "g.bsdf", name="glossy", format="rgl")
    measured = RglMeasured((tmp_path / "g.bsdf").read_bytes(), tmp_path / "g.bsdf")
    assert measured.name == "glossy"
    pairs = directions(2000)
    f, _ = measured.brdf(*pairs)
    error = np.abs(f[:, 1] / GLOSSY.brdf(*pairs) - 1.0)
    assert np.median(error) < 2e-3  # linear between the nodes of the grid
    assert error.max() < 0.02
    assert len(measurement.read(tmp_path / "g.bsdf")) > 10_000


def test_klems_holds_averages_over_patches(tmp_path: Path) -> None:
    assert measurement.write_model(Lambert(albedo=0.5), tmp_path / "white.xml", name="white") == []
    np.testing.assert_allclose(measurement.read(tmp_path / "white.xml")["brdf"], 0.5 / math.pi, rtol=1e-14)
    measurement.write_model(GLOSSY, tmp_path / "g.xml", name="glossy")
    frame = measurement.read(tmp_path / "g.xml")
    row = frame[(frame["theta_i_deg"] == 20) & (frame["phi_i_deg"] == 180) & (frame["theta_r_deg"] == 20)]
    peak = row.iloc[int(row["brdf"].argmax())]
    assert peak["phi_r_deg"] == 0.0  # the mirror patch
    # by random directions, even in sin^2 and azimuth, in the patches of 16 in the ring from 15 to 25 degrees
    dice = np.random.default_rng(3)
    low, high = np.sin(np.deg2rad([15.0, 25.0])) ** 2
    theta = np.arcsin(np.sqrt(dice.uniform(low, high, (2, 200_000))))
    phi = np.deg2rad(dice.uniform(-11.25, 11.25, (2, 200_000)))
    drawn = GLOSSY.brdf(theta[0], phi[0] + math.pi, theta[1], np.mod(phi[1], 2 * math.pi))
    # four by four points a patch; the mean of the draws is good to 0.1 %
    assert peak["brdf"] == pytest.approx(drawn.mean(), rel=0.01)


@pytest.mark.slow
def test_merl_cells_hold_the_model(tmp_path: Path) -> None:
    measurement.write_model(GLOSSY, tmp_path / "g.binary", name="glossy")
    frame = measurement.read(tmp_path / "g.binary", sample="g green").iloc[::997]
    angles = np.deg2rad(frame[["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"]].to_numpy()).T
    # rounding of the angles that the cells stand for
    np.testing.assert_allclose(frame["brdf"], GLOSSY.brdf(*angles), rtol=1e-12)


@pytest.mark.slow
def test_what_a_file_cannot_hold_is_said(tmp_path: Path) -> None:
    (remark,) = measurement.write_model(HeTorrance(), tmp_path / "m.xml", name="metal")
    assert "spike" in remark
    grooves = OrenNayar(form="single-slope", slope_deg=30, groove_azimuth_deg=0)
    with pytest.raises(DataError, match="azimuth"):
        measurement.write_model(grooves, tmp_path / "n.xml", name="grooves")
    for ending in ("n.xml", "n.binary"):
        with pytest.raises(DataError, match="azimuth"):
            measurement.write_model(AnisotropicFacets(0.1, 0.3, 20.0, 1.5), tmp_path / ending, name="brushed")
    assert not list(tmp_path.glob("n.*"))
    with pytest.raises(ConfigError, match="one of klems, merl, rgl"):
        measurement.write_model(GLOSSY, tmp_path / "n.astm", name="g")
    frame = measurement.read(tmp_path / "m.xml")
    with pytest.raises(ConfigError, match="written of models"):
        measurement.write(frame, tmp_path / "n.bsdf", format="rgl")
    assert [p.name for p in tmp_path.iterdir()] == ["m.xml"]
