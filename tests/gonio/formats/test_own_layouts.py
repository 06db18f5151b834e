"""Tables of one's own in many layouts: read as `--columns` says, and as what made them knows."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats import own_guess, own_pairs
from gonio.formats.reader import ANGLES
from gonio.typing import Floats
from tests.command_line import gonio, says

PREAMBLE = ["BRF Values", "Measured on Jan 01 2020, by nobody; in a cellar", "", "# lamp: 3 V"]


@dataclass
class Layout:
    """A text in one layout, the pairs that read it, and its truth: rows of four angles, wavelength and BRDF."""

    text: str
    pairs: str
    truth: Floats


def written(value: float, comma: bool) -> str:
    return f"{value:.9g}".replace(".", ",") if comma else f"{value:.9g}"


def telling(name: str, angle: str, unit: str) -> str:
    """A name that says what the column is, and in what unit."""
    values = {"1/sr": "BRDF [1/sr]", "factor": "Panel BRF", "percent": "BRDF [%]", "cos": "BRDF_cos"}
    known = {"inc": "Incident Zenith", "det": "Viewing Zenith", "az_i": "Incident Azimuth", "az_r": "Viewing Azimuth"}
    known |= {"rel": "Relative Azimuth"}
    return values[unit] if name == "R" else f"{known[name]} [{angle}]" if name in known else name


def layout(seed: int, *, tells: bool = False) -> Layout:
    """One layout of those that people write, chosen by a seed; one that `tells` has names that say what is what."""
    rng = np.random.default_rng(seed)
    shape = ("long", "wide", "matrix")[seed % 3]
    mark = (";", "\t", ",", " ")[seed // 3 % 4]
    comma = mark != "," and bool(rng.integers(2))
    how = ("phi_r", "dphi", "signed", "signed-retro")[rng.integers(1 if shape == "matrix" else 0, 4)]
    angle = "rad" if rng.integers(3) == 0 else "deg"
    unit = ("1/sr", "factor", "percent", "cos")[rng.integers(4)]
    if tells:  # no file tells the side of a sign or, in names of wavelengths alone, a unit
        how = "signed" if how == "signed-retro" else how
        unit = "1/sr" if shape != "long" else unit
        angle = "deg" if shape == "matrix" else angle
        mark = ";" if mark == " " else mark
    waves = [450.0, 550.5, 1050.0] if shape == "wide" else [550.0]
    wave_unit = "um" if rng.integers(2) else "nm"
    theta_i = [10.0, 30.5, 60.0]
    plane = how.startswith("signed") or shape == "matrix"
    places = []
    for incidence in theta_i:
        for theta in (5.0, 20.0, 45.5, 70.0):
            for dphi in (
                [180.0] if shape == "matrix" and how == "dphi" else [0.0, 180.0] if plane else [0.0, 90.0, 180.0]
            ):
                places.append((incidence, 0.0 if plane or how == "dphi" else 40.0, theta, dphi))
    values = rng.uniform(0.01, 2.0, (len(places), len(waves)))
    truth = [
        [t_i, p_i, t_r, (p_i + dphi) % 360.0, wave if shape != "matrix" else np.nan, value]
        for (t_i, p_i, t_r, dphi), row in zip(places, values, strict=True)
        for wave, value in zip(waves, row, strict=True)
    ]

    def shown(degrees: float) -> str:
        return written(np.deg2rad(degrees) if angle == "rad" else degrees, comma)

    def stated(value: float, theta: float) -> str:
        by = {"1/sr": 1.0, "factor": np.pi, "percent": 100 * np.pi, "cos": np.cos(np.deg2rad(theta))}[unit]
        return written(value * by, comma)

    def sign(dphi: float) -> float:
        return 1.0 if not how.startswith("signed") or (dphi == 180.0) == (how == "signed") else -1.0

    suffix = f":{how}" if how.startswith("signed") else ""
    if shape == "matrix":
        column = {t: k for k, t in enumerate(theta_i)}
        grid: dict[float, list[str]] = {}
        for (t_i, _, t_r, dphi), row in zip(places, values, strict=True):
            grid.setdefault(sign(dphi) * t_r, [""] * 3)[column[t_i]] = stated(row[0], t_r)
        head = ["theta", *map(shown, theta_i)]
        rows = [[shown(theta), *cells] for theta, cells in grid.items()]
        pairs = f"theta_r=#1:{angle}{suffix},theta_i=header:{angle},brdf=matrix:{unit}"
        pairs += ",phi_i=0,dphi=180" if how == "dphi" else ""
    else:
        table = {"inc": [shown(p[0]) for p in places], "det": [shown(sign(p[3]) * p[2]) for p in places]}
        pairs = f"theta_i=inc:{angle},theta_r=det:{angle}{suffix}"
        if how == "phi_r":
            table |= {"az_i": [shown(p[1]) for p in places], "az_r": [shown((p[1] + p[3]) % 360) for p in places]}
            pairs += f",phi_i=az_i:{angle},phi_r=az_r:{angle}"
        elif how == "dphi":
            table["rel"] = [shown(p[3] if rng.integers(2) else p[3] - 360.0) for p in places]
            pairs += f",phi_i=0,dphi=rel:{angle}"
        if shape == "wide":
            blank = "" if mark == " " else " " * int(rng.integers(2))
            for k, wave in enumerate(waves):
                name = f"{wave / 1000:g}{blank}um" if wave_unit == "um" else f"{wave:g}{blank}NM"
                table[name] = [stated(v, p[2]) for p, v in zip(places, values[:, k], strict=True)]
            pairs += f",brdf=*{wave_unit}:{unit}"
        else:
            table |= {
                "R": [stated(v, p[2]) for p, v in zip(places, values[:, 0], strict=True)],
                "run": ["7"] * len(places),
            }
            pairs += f",brdf=R:{unit},wavelength=" + ("0.55:um" if wave_unit == "um" else "550")
        if tells and shape == "long":
            table["wavelength_nm"] = [written(550.0, comma)] * len(places)
        head = [str(name) for name in rng.permutation(list(table))]
        rows = [list(row) for row in zip(*(table[name] for name in head), strict=True)]
        head = [telling(name, angle, unit) for name in head] if tells else head
    join = "   " if mark == " " else mark
    top = (PREAMBLE[1:] if rng.integers(2) else []) + [("# " if rng.integers(3) == 0 else "") + join.join(head)]
    return Layout("\n".join([*top, *(join.join(row) for row in rows), ""]), pairs, np.array(truth))


def taken(frame: pd.DataFrame) -> Floats:
    rows = frame[[*ANGLES, "wavelength_nm", "brdf"]].to_numpy(np.float64)
    return rows[np.lexsort(rows[:, :5].T[::-1])]


@pytest.mark.parametrize("seed", range(48))
def test_a_layout_is_read_as_what_made_it_knows(seed: int) -> None:
    made = layout(seed)
    frame = measurement.parse(made.text.encode(), Path("a.csv"), columns=own_pairs.pairs(made.pairs))
    expected = made.truth[np.lexsort(made.truth[:, :5].T[::-1])]
    # nine digits are written: of an angle in radians 3e-8 degrees, of values 5e-9 of them, with cos(theta_r) 7e-9
    np.testing.assert_allclose(taken(frame), expected, rtol=2e-8, atol=1e-7)


def line_of(refusal: str) -> str:
    """The pairs in the line to try that a refusal ends with."""
    found = re.search(r'gonio convert \S+ \S+ --columns "(.*?)"', refusal)
    assert found is not None, refusal
    return found[1]


@pytest.mark.parametrize("seed", range(36))
def test_a_refusal_ends_with_the_line_that_reads_the_table(seed: int) -> None:
    made = layout(seed, tells=True)
    with pytest.raises(DataError) as caught:
        measurement.parse(made.text.encode(), Path("a.csv"))
    pairs = line_of(str(caught.value))
    if "dphi=NAME" in pairs:  # a matrix of one side tells not which
        assert "dphi=180" in made.pairs
        pairs = pairs.replace("NAME", "180")
    assert "NAME" not in pairs
    frame = measurement.parse(made.text.encode(), Path("a.csv"), columns=own_pairs.pairs(pairs))
    expected = made.truth[np.lexsort(made.truth[:, :5].T[::-1])]
    np.testing.assert_allclose(taken(frame), expected, rtol=2e-8, atol=1e-7)  # as above


def test_a_misspelt_name_is_put_right_in_the_line_to_try() -> None:
    made = layout(0)
    with pytest.raises(DataError) as caught:
        measurement.parse(made.text.encode(), Path("a.csv"), columns=own_pairs.pairs(made.pairs.replace("inc", "inv")))
    frame = measurement.parse(made.text.encode(), Path("a.csv"), columns=own_pairs.pairs(line_of(str(caught.value))))
    assert len(frame) == len(made.truth)


def test_convert_asks_and_writes_nothing_without_a_terminal(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(STUDENT.format(0, 0))
    done = gonio(tmp_path, "convert", "a.csv", "--ask", expect=0)
    says(done.stdout, "theta_r: 'theta_r_deg', by its name", "theta_r is negative", "2 rows; the first:")
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("gonio convert"))
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    gonio(tmp_path, *shlex.split(line)[1:], expect=0)
    assert measurement.read(tmp_path / "a-brdf.csv")["phi_r_deg"].tolist() == [0.0, 180.0]
    (tmp_path / "b.txt").write_text("30 0 20 180 0.5\n30 0 40 180 0.6\n")
    says(gonio(tmp_path, "convert", "b.txt", "--ask", expect=0).stdout, "they are #1 to #5", "theta_i=NAME")
    gonio(tmp_path, "convert", "b.txt", expect=2)


@pytest.mark.parametrize(
    ("header", "pairs"),
    [
        ("theta_s phi_s theta_v phi_v brdf", "theta_i=theta_s,phi_i=phi_s,theta_r=theta_v,phi_r=phi_v"),
        ("theta_i phi_i theta_s phi_s brdf", "theta_i=theta_i,phi_i=phi_i,theta_r=theta_s,phi_r=phi_s"),
        ("theta_l phi_l theta_v phi_v brdf", "theta_i=theta_l,phi_i=phi_l,theta_r=theta_v,phi_r=phi_v"),
        ("AOI phi_i Viewing_angle View_az brdf", "theta_i=AOI,phi_i=phi_i,theta_r=Viewing_angle,phi_r=View_az"),
    ],
)
def test_the_source_and_the_viewer_are_told_by_their_names(header: str, pairs: str) -> None:
    data = f"{header}\n30 0 20 180 0.5\n30 0 40 180 0.6\n".encode()
    told = own_guess.proposal(data, Path("a.txt"))
    assert told is not None
    assert told.text == pairs


@pytest.mark.parametrize("value", ["0,314159", "550,5"])
def test_names_of_another_language_are_the_table_s_names(value: str) -> None:
    header = "Einfallswinkel;Azimut;Beobachtungswinkel;Azimut Detektor;Leuchtdichtefaktor"
    told = own_guess.proposal((header + f"\n30,5;0,0;20,5;180,0;{value}" * 4).encode(), Path("a.csv"))
    assert told is not None
    assert told.header == header.split(";")
    assert told.text == "theta_i=NAME,phi_i=NAME,theta_r=NAME,phi_r=NAME,brdf=NAME"


@pytest.mark.parametrize("said", ["full red", "red", "RED", "full  Red"])
def test_a_sample_s_name_may_be_short_where_one_fits(tmp_path: Path, said: str) -> None:
    rows = "".join(f"30,0,20,180,{value},{name}\n" for value, name in ((0.1, "full red"), (0.2, "full green")))
    (tmp_path / "a.csv").write_text(f"theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf,sample\n{rows}")
    assert measurement.read(tmp_path / "a.csv", sample=said)["brdf"].tolist() == [0.1]
    for wrong, why in (("full", "2 samples whose names begin or end with"), ("blue", "no sample")):
        with pytest.raises(DataError, match=f'{why} "{wrong}"; name one of ".*a.csv:full red", ".*a.csv:full green"'):
            measurement.read(tmp_path / "a.csv", sample=wrong)


STUDENT = "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf\n30,0,-20,{0},0.1\n30,0,20,{1},0.2\n"


@pytest.mark.parametrize(
    ("azimuths", "pairs", "expected"),
    [
        ((0, 0), "theta_r=theta_r_deg:signed", [0.0, 180.0]),
        ((180, 180), "theta_r=theta_r_deg:signed", [0.0, 180.0]),
        ((0, 0), "theta_r=theta_r_deg:signed-retro", [180.0, 0.0]),
        ((0, 180), "theta_r=theta_r_deg:signed,dphi=180", [0.0, 180.0]),
        ((120, 120), "theta_r=theta_r_deg:signed", [300.0, 120.0]),  # out of plane: of positive theta_r
        ((90, 90), "theta_r=theta_r_deg:signed", [270.0, 90.0]),
    ],
)
def test_a_signed_polar_angle(azimuths: tuple[int, int], pairs: str, expected: list[float]) -> None:
    data = STUDENT.format(*azimuths).encode()
    frame = measurement.parse(data, Path("a.csv"), columns=own_pairs.pairs(pairs))
    assert frame["theta_r_deg"].tolist() == [20.0, 20.0]
    assert frame["phi_r_deg"].tolist() == expected
    says(" ".join(frame.attrs["notes"]), "theta_r is signed: positive is")


@pytest.mark.parametrize(
    ("azimuths", "sign"), [((0, 180), "signed"), ((60, 60), "signed"), ((120, 120), "signed-retro")]
)
def test_a_sign_that_the_azimuths_contradict_is_refused(azimuths: tuple[int, int], sign: str) -> None:
    with pytest.raises(DataError, match=r"a\.csv, line [23]: theta_r is signed.* add dphi="):
        measurement.parse(STUDENT.format(*azimuths).encode(), Path("a.csv"), columns={"theta_r": f"theta_r_deg:{sign}"})


def test_columns_by_place_need_no_header() -> None:
    for top in ("", "made by hand\n\n# of the 3rd\n"):
        data = f"{top}30 0,5 20 180\n40 0,6 20 180\n".encode()
        pairs = own_pairs.pairs("theta_i=#1,brdf=#2,theta_r=#3,phi_r=#4,phi_i=0,polarisation=s")
        frame = measurement.parse(data, Path("a.txt"), columns=pairs)
        assert frame["theta_i_deg"].tolist() == [30.0, 40.0]
        assert frame["brdf"].tolist() == [0.5, 0.6]
        assert set(frame["polarisation"]) == {"s"}
        says(" ".join(frame.attrs["notes"]), "phi_i is 0 in all rows", "polarisation is s in all rows")


def test_a_word_that_is_no_column_is_no_sample() -> None:
    pairs = own_pairs.pairs("theta_r=theta_r_deg:signed,sample=gold")
    with pytest.raises(DataError, match="missing, or there twice: gold"):
        measurement.parse(STUDENT.format(0, 0).encode(), Path("a.csv"), columns=pairs)


def test_what_is_remembered_reads_the_same(tmp_path: Path) -> None:
    for seed in (1, 2):
        made = layout(seed)
        table = tmp_path / f"a{seed}.csv"
        table.write_text(made.text)
        first = measurement.read(table, columns=own_pairs.pairs(made.pairs))
        assert own_pairs.remember(table, own_pairs.pairs(made.pairs)) is not None
        pd.testing.assert_frame_equal(measurement.read(table), first, check_exact=True)


def test_a_row_that_is_wrong_is_named_by_its_line() -> None:
    data = b"of a lamp\n\nti tr 400nm 500nm\n30 20 1 2\n30 95 1 2\n"
    with pytest.raises(DataError, match=r"a\.txt, line 5: theta_r_deg = 95"):
        measurement.parse(data, Path("a.txt"), columns=own_pairs.pairs("theta_i=ti,theta_r=tr:signed,brdf=*nm"))
