"""docs/misfit.md says what its commands print, where the measured files lie beside the project."""

import re
import shlex
from pathlib import Path

import pytest

from tests.command_line import gonio
from tests.places import ROOT, measured

FILES = {
    "PTFE.data.csv": "brdf/nist_ptfe/PTFE.data.csv",
    "krylon_blue.astm": "brdf/cornell_astm/krylon_blue.astm",
    "acrylic_felt_green_rgb.bsdf": "brdf/rgl/acrylic_felt_green_rgb.bsdf",
}


def quoted() -> dict[str, str]:
    """Commands of the page, and what it shows of their output."""
    blocks = re.findall(r"(?m)(?:^    .*\n)+", (ROOT / "docs" / "misfit.md").read_text(encoding="utf-8"))
    return dict(zip((b.strip() for b in blocks[::2]), blocks[1::2], strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("command", quoted())
def test_the_page_shows_what_is_printed(command: str, tmp_path: Path) -> None:
    words = shlex.split(command)[1:]
    name, _, sample = words[1].partition(":")
    (tmp_path / name).symlink_to(measured(FILES[name]))
    done = gonio(tmp_path, *words, expect=0)
    printed = " ".join(done.stdout.split())
    for line in " ".join(quoted()[command].split()).split("  "):
        for row in re.split(r"(?<=fitted) ", line):
            assert row in printed, (sample, row)
