"""NIST's Mueller matrices: turned from the sample's x and y to s and p, and kept in the table."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from gonio import measurement
from gonio.formats.nist_mueller import in_sp
from gonio.formats.reader import MUELLER
from gonio.models import HeTorrance
from gonio.typing import Floats


def _axes(k: Floats, turn: float) -> tuple[Floats, Floats]:
    """SCATMECH's s and p of a ray (s = z x k, p = k x s), turned back by the azimuth that the ray travels with."""
    s = np.cross([0.0, 0.0, 1.0], k)
    s /= np.linalg.norm(s)
    p = np.cross(k, s)
    # carried from x and y: as the ray turns upright the first axis becomes the sample's y, whatever the azimuth
    up = np.sign(k[2])
    return np.cos(turn) * s - up * np.sin(turn) * p, up * np.sin(turn) * s + np.cos(turn) * p


def _stokes(e: Floats) -> Floats:
    """I, Q, U, V of a field (first, second)."""
    cross = e[0] * np.conj(e[1])
    return np.array([abs(e[0]) ** 2 + abs(e[1]) ** 2, abs(e[0]) ** 2 - abs(e[1]) ** 2, 2 * cross.real, -2 * cross.imag])


def _ray(theta: float, psi: float, up: float) -> Floats:
    return np.array([np.sin(theta) * np.cos(psi), np.sin(theta) * np.sin(psi), up * np.cos(theta)])


def test_the_turn_is_that_of_vectors_in_space() -> None:
    """Fields in space have two Stokes vectors, by dot products with either axes: the turn carries one to the other."""
    random = np.random.default_rng(5)
    for _ in range(20):
        theta_i, theta_r, psi_i, psi_r = random.uniform(0.1, 1.4, 4) * [1, 1, 4, 4]
        m_sp = random.normal(size=(4, 4))
        turns = {}
        for name, theta, psi, up in (("i", theta_i, psi_i, -1.0), ("r", theta_r, psi_r, 1.0)):
            k = _ray(theta, psi, up)
            ours_s = np.cross(k, [0.0, 0.0, 1.0])
            ours_s /= np.linalg.norm(ours_s)
            ours = np.array([ours_s, np.cross(ours_s, k)])
            theirs = np.array(_axes(k, psi))
            fields = [random.normal(size=2) @ ours + 1j * (random.normal(size=2) @ ours) for _ in range(4)]
            a = np.array([_stokes(ours @ e) for e in fields]).T
            b = np.array([_stokes(theirs @ e) for e in fields]).T
            turns[name] = a @ np.linalg.inv(b)  # from their frame to ours
        m_xy = np.linalg.inv(turns["r"]) @ m_sp @ turns["i"]
        found = in_sp(m_xy[np.newaxis], np.degrees([psi_i]), np.degrees([psi_r]))[0]
        np.testing.assert_allclose(found, m_sp, atol=1e-9)  # rounding, times the condition of four random vectors


def test_isotropy_at_normal_incidence(shared: Callable[[str], Path]) -> None:
    """Sintered PTFE knows no azimuth: from one angle the matrix is one, once the frame follows the detector."""
    frame = measurement.read(shared("nist_ptfe/PTFE.data.csv"))
    at = frame[(frame["theta_i_deg"] < 0.01) & (frame["theta_r_deg"].between(60, 66))]
    # At normal incidence the plane of incidence is a choice. Were it to follow the detector, s of the incident light
    # would turn by its azimuth, and Q by twice that: m01 is q cos(2 psi), and m02 is q sin(2 psi).
    psi = np.radians(at["phi_r_deg"].to_numpy())
    even, odd = np.cos(2 * psi), np.sin(2 * psi)
    q, u = (float(at[name] @ wave / (wave @ wave)) for name, wave in (("m01", even), ("m02", odd)))
    error = float(np.std(at["m01"] - q * even) / np.sqrt(even @ even))
    assert q > 5 * error
    assert abs(u - q) < 5 * error  # of the other sense, u = -q


def test_signs_are_those_of_facets(shared: Callable[[str], Path]) -> None:
    """PTFE's surface reflects as facets of n = 1.35 do: each element that facets have goes with theirs."""
    frame = measurement.read(shared("nist_ptfe/PTFE.data.csv"))
    far = frame[(frame["theta_i_deg"] > 20) & (frame["theta_r_deg"] > 20) & (frame["wavelength_nm"] == 633)].iloc[::3]
    angles = np.radians(far[["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"]].to_numpy()).T
    theory = HeTorrance(sigma0_um=2.0, tau_um=5.0, ior=1.35).mueller(*angles, wavelength_nm=633.0)
    for name in ("m01", "m02", "m10", "m11", "m12", "m20", "m21", "m22"):
        # volume scattering adds its own on top: a wrong sign would be below -0.4
        assert np.corrcoef(far[name], theory[:, int(name[1]), int(name[2])] / theory[:, 0, 0])[0, 1] > 0.4, name


def test_matrices_survive_the_projects_own_table(tmp_path: Path) -> None:
    head = "lambda,thetai,phii,thetar,phir,fr11," + ",".join(f"m{i}{j}" for i in range(1, 5) for j in range(1, 5))
    head = head.replace(",m11", "", 1)
    row = "0.633,-75,0,60,30,0.2," + ",".join(f"{0.01 * k:g}" for k in range(1, 16))
    frame = measurement.parse(f"{head}\n{row}\n{row}\n".encode(), Path("ptfe.csv"))
    assert [name for name in frame.columns if name in MUELLER] == list(MUELLER)
    frame["u_m01"] = 0.005
    frame = frame[[*(n for n in frame.columns if n != "flag"), "flag"]]
    measurement.write(frame, tmp_path / "own.csv")
    pd.testing.assert_frame_equal(measurement.read(tmp_path / "own.csv"), frame)
    told = measurement.write(frame.iloc[:1].assign(u_brdf=np.nan), tmp_path / "own.astm")
    assert any("Mueller" in line for line in told)
