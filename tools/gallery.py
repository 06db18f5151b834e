"""Makes the pictures of docs/gallery.md by running what the page says.

    python tools/gallery.py

Blocks run in the order of the page in one folder, which is removed afterwards: `sh` and `python` are run, `toml` is
written under the name in its first line. A picture's title says which file it was.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

DOCS = Path(__file__).resolve().parents[1] / "docs"
BLOCK = re.compile(r"(?ms)^```(sh|python|toml)\n(.*?)^```$")
PICTURE = re.compile(r'!\[[^\]]*\]\((gallery/[\w.-]+) "([^"]+)"\)')
LARGEST_BYTES = 150_000


def make(page: str, folder: Path) -> dict[str, Path]:
    """Run the blocks of a page in a folder; the page's pictures by their names, and the files that they are."""
    beside = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"}
    for kind, text in BLOCK.findall(page):
        if kind == "toml":
            (folder / text.split("\n", 1)[0].removeprefix("# ")).write_text(text, encoding="utf-8")
            continue
        command = ["sh", "-ec", text] if kind == "sh" else [sys.executable, "-c", text]
        subprocess.run(command, cwd=folder, env=beside | {"MPLBACKEND": "agg"}, check=True)
    return {name: folder / source for name, source in PICTURE.findall(page)}


def main() -> None:
    """Make all of them."""
    with TemporaryDirectory() as name:
        for picture, source in make((DOCS / "gallery.md").read_text(encoding="utf-8"), Path(name)).items():
            shutil.copyfile(source, DOCS / picture)
            print(f"{picture}: {source.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
