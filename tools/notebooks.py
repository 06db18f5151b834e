"""Runs the notebooks of docs/notebooks from top to bottom, and keeps what they show.

    python tools/notebooks.py [NAME ...]

Each runs in a folder of its own that is removed afterwards. What changes from run to run without meaning anything
(times, the kernel's name, identifiers of cells, addresses in memory) is left out, so that a second run changes nothing.
"""

import os
import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
LARGEST_BYTES = 300_000
PATIENCE_S = 300
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
"""Colours and cursor movements of a terminal."""


def executed(path: Path, folder: Path, **changed: str) -> Any:
    """The notebook after all of its cells have run in a folder.

    Parameters
    ----------
    path
        Of the notebook.
    folder
        Where it runs, and finds no files but its own.
    changed
        Lines `NAME = ...` of its cells with another right-hand side, by their names.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        A cell raises.
    """
    notebook = nbformat.read(path, as_version=4)
    for name, value in changed.items():
        pattern = re.compile(rf"(?m)^{name} = .*?$")
        found = [cell for cell in notebook.cells if cell.cell_type == "code" and pattern.search(cell.source)]
        if len(found) != 1:
            raise ValueError(f"{path.name}: {len(found)} cells say {name} = ...")
        found[0].source = pattern.sub(lambda _, line=f"{name} = {value}": line, found[0].source)
    beside = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"}
    client = NotebookClient(notebook, timeout=PATIENCE_S, resources={"metadata": {"path": str(folder)}})
    client.execute(env=beside)
    return notebook


def lasting(notebook: Any) -> Any:
    """The notebook without what changes from run to run."""
    notebook.metadata = nbformat.from_dict(
        {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    )
    for count, cell in enumerate(notebook.cells):
        cell.id = f"cell-{count:02}"
        cell.metadata = nbformat.from_dict({k: v for k, v in cell.metadata.items() if k == "tags"})
        if cell.cell_type == "code":
            cell.outputs = _joined(cell.outputs)
        for output in cell.get("outputs", []):
            if "text" in output:
                output.text = ESCAPES.sub("", output.text).replace("\r\n", "\n").rstrip() + "\n"
            if "data" in output:
                output.data = nbformat.from_dict({k: v for k, v in output.data.items() if _kept(k, output.data)})
    return notebook


def _joined(outputs: list[Any]) -> list[Any]:
    """Outputs, with printed text joined: into which pieces it was split is chance."""
    out: list[Any] = []
    for one in outputs:
        if one.output_type == "stream" and out and out[-1].output_type == "stream" and out[-1].name == one.name:
            out[-1].text += one.text
        else:
            out.append(one)
    return out


def _kept(kind: str, data: Any) -> bool:
    """A picture needs no words beside it but its own; an address in memory is none."""
    return kind != "text/plain" or " at 0x" not in data[kind]


def main(names: list[str]) -> None:
    """Run the named notebooks, or all."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        if names and path.stem not in names:
            continue
        with TemporaryDirectory() as folder:
            text = nbformat.writes(lasting(executed(path, Path(folder)))) + "\n"
        path.write_text(text, encoding="utf-8")
        print(f"{path.name}: {len(text.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
