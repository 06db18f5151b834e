"""The notebooks of docs/notebooks run from top to bottom, and what is kept of them is what they show."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.places import ROOT, measured
from tests.test_site import tool

pytestmark = pytest.mark.slow

FOLDER = ROOT / "docs" / "notebooks"
NAMES = ("measure_a_sample", "two_paints", "my_own_model")
VOLATILE = re.compile(r"/tmp/|/home/|/root/|/work/|/Users/| at 0x|\x1b")

pytest.importorskip("nbclient", reason="the notebooks run with the extra gonio[docs]")
notebooks = tool("notebooks")


def outputs(notebook: Any) -> list[Any]:
    return [output for cell in notebook["cells"] if cell["cell_type"] == "code" for output in cell["outputs"]]


def test_these_are_all() -> None:
    assert {p.stem for p in FOLDER.glob("*.ipynb")} == set(NAMES)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the kernel's client, which is not ours
@pytest.mark.parametrize("name", NAMES)
def test_it_runs_and_shows_what_is_kept(name: str, tmp_path: Path) -> None:
    """Its asserts hold; and it shows as many things of the same kinds as the file that is kept."""
    kept = json.loads((FOLDER / f"{name}.ipynb").read_text("utf-8"))
    again = notebooks.lasting(notebooks.executed(FOLDER / f"{name}.ipynb", tmp_path))
    assert any("assert " in "".join(cell["source"]) for cell in kept["cells"]), "nothing that it says is checked"

    def kinds(notebook: Any) -> list[Any]:
        return [(o["output_type"], sorted(o.get("data", ()))) for o in outputs(notebook)]

    assert kinds(again) == kinds(kept)
    assert [cell["source"] for cell in again["cells"]] == ["".join(cell["source"]) for cell in kept["cells"]]


@pytest.mark.parametrize("name", NAMES)
def test_what_is_kept_is_executed_small_and_says_nothing_of_this_machine(name: str) -> None:
    path = FOLDER / f"{name}.ipynb"
    notebook = json.loads(path.read_text("utf-8"))
    assert path.stat().st_size <= notebooks.LARGEST_BYTES
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    assert set(notebook["metadata"]) == {"kernelspec"}
    assert not any(cell["metadata"] for cell in notebook["cells"])
    texts = [
        json.dumps({k: v for k, v in o.get("data", {"text": o.get("text")}).items() if k != "image/png"})
        for o in outputs(notebook)
    ]
    assert not [text for text in texts if VOLATILE.search(text)]
    assert any("image/png" in o.get("data", {}) for o in outputs(notebook))


def test_what_is_kept_of_the_paints_is_simulated() -> None:
    """Measured files may be looked at in it, and never land in the file."""
    notebook = json.loads((FOLDER / "two_paints.ipynb").read_text("utf-8"))
    source = "\n".join("".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code")
    assert re.search(r"(?m)^FILES = \[\]", source)
    tables = [text for o in outputs(notebook) if (text := "".join(o.get("data", {}).get("text/html", "")))]
    assert len(tables) >= 4
    assert sum("simulated" in text for text in tables) == len(tables)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_the_paints_may_be_anybodys(tmp_path: Path) -> None:
    files = [str(measured(f"brdf/cornell_astm/{name}.astm").resolve()) for name in ("cayman", "krylon_blue")]
    few = '["lambert", "oren-nayar"]'  # the others take their time at every wavelength of the files
    shown = notebooks.executed(FOLDER / "two_paints.ipynb", tmp_path, FILES=repr(files), MODELS=few)
    text = json.dumps(outputs(shown))
    assert "krylon blue" in text
    assert "simulated satin blue" not in text
