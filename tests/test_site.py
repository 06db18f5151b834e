"""The site of docs/: it builds without a warning, no link is dead, and nothing comes from the network."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from gonio_analysis.report.html import made_by
from PIL import Image

from tests.command_line import some
from tests.places import ROOT

pytestmark = pytest.mark.slow


def tool(name: str) -> ModuleType:
    """A script of tools/ as a module."""
    spec = some(importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    some(spec.loader).exec_module(module)
    return module


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    pytest.importorskip("mkdocs", reason="the site is built with the extra gonio[docs]")
    return tool("site_hooks")


def build(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder), *options]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True)


@pytest.mark.slow
def test_it_builds_without_a_warning_and_holds_what_it_should(tmp_path: Path, hooks: ModuleType) -> None:
    done = build(tmp_path / "site")
    assert done.returncode == 0, done.stdout + done.stderr
    site = tmp_path / "site"
    pages = {str(p.relative_to(site).with_suffix("")) for p in site.rglob("*.html")}
    docs = {str(p.relative_to(ROOT / "docs").with_suffix("")) for p in (ROOT / "docs").rglob("*.[mi][dp]*")}
    assert pages >= docs | {"index"}
    reference = "".join(p.read_text("utf-8") for p in (site / "reference").glob("*.html"))
    for name in (
        "gonio.measurement.read",
        "gonio.models.Model.brdf",
        "gonio.models.HeTorrance",
        "gonio_analysis.report.notebook.fit",
    ):
        assert f'id="{name}"' in reference
    assert not list(hooks.dead_links(site))
    text = "".join(p.read_text("utf-8") for p in site.rglob("*.html"))
    assert str(ROOT) not in text


def test_public_names_are_all_in_the_reference() -> None:
    """What `gonio` and its parts, `gonio_analysis` and `gonio_bluesky` export."""
    import gonio_analysis
    import gonio_bluesky

    import gonio
    import gonio.instrument
    import gonio.lab.rig
    import gonio.models

    text = "\n".join(p.read_text("utf-8") for p in sorted((ROOT / "docs" / "reference").glob("*.md")))
    words = set(re.findall(r"\w+", text))
    for module in (gonio, gonio_analysis, gonio_bluesky, gonio.models, gonio.instrument, gonio.lab.rig):
        assert set(module.__all__) <= words, module.__name__


def test_a_dead_link_a_dead_anchor_and_a_font_from_elsewhere_are_found(tmp_path: Path, hooks: ModuleType) -> None:
    (tmp_path / "b.html").write_text('<h1 id="here">b</h1>')
    (tmp_path / "a.html").write_text(
        '<a href="b.html#here">good</a><a href="https://example.org/">elsewhere, not followed</a><a href="#top"></a>'
        '<p id="top"><a href="b.html#gone">1</a><a href="c.html">2</a><img src="none.png">'
        '<link rel="stylesheet" href="https://example.org/font.css">'
    )
    said = list(hooks.dead_links(tmp_path))
    assert [s.rsplit(" ", 2)[0].split(": ")[1].split()[0] for s in said] == [
        "b.html#gone",
        "c.html",
        "none.png",
        "needs",
    ]
    assert "font.css" in said[-1]


def test_the_first_page_is_the_readme_as_seen_from_docs(hooks: ModuleType) -> None:
    text = hooks.first_page("[a](docs/analysis.md) ![r](docs/report.png) [d](docs/decisions)")
    assert text == "[a](analysis.md) ![r](report.png) [d](decisions/index.md)"


def test_the_picture_of_the_readme_is_of_todays_page() -> None:
    with Image.open(ROOT / "docs" / "report.png") as picture:
        made = picture.info["Software"]
    assert made == made_by(), "the page has changed since: python tools/report_picture.py"


def test_a_notebook_becomes_a_page(hooks: ModuleType) -> None:
    notebook = {
        "cells": [
            {"cell_type": "markdown", "source": ["# Title\n", "words, and [another](two.ipynb)"]},
            {
                "cell_type": "code",
                "source": ["x = 1\n", "x"],
                "outputs": [
                    {"output_type": "stream", "text": ["said\n"]},
                    {"output_type": "execute_result", "metadata": {}, "data": {"text/plain": ["1"]}},
                    {"output_type": "display_data", "metadata": {}, "data": {"image/png": "iVBORw0KGgo="}},
                    {
                        "output_type": "execute_result",
                        "metadata": {},
                        "data": {
                            "text/html": [
                                '<style>p {}</style><table border="1" class="dataframe">\n\n<tr><td>1</td></tr></table>'
                            ],
                            "text/plain": "t",
                        },
                    },
                ],
            },
        ]
    }
    text, pictures = hooks.page_of(notebook, "one")
    assert text.startswith("# Title\n\n[Take this notebook](one.ipynb)")
    assert "[another](two.md)" in text
    assert pictures == {"one_1.png": b"\x89PNG\r\n\x1a\n"}
    assert "(one_1.png)" in text
    assert "<style" not in text
    assert "<table>\n<tr>" in text
    assert text.index("x = 1\nx") < text.index("said") < text.index("one_1.png") < text.index("<table>")


def test_the_gallery_shows_what_its_own_commands_make(hooks: ModuleType) -> None:
    gallery = tool("gallery")
    page = (ROOT / "docs" / "gallery.md").read_text("utf-8")
    shown = dict(gallery.PICTURE.findall(page))
    there = {f"gallery/{p.name}" for p in (ROOT / "docs" / "gallery").iterdir()}
    assert set(shown) == there
    assert len(shown) >= 6
    for name in there:
        assert (ROOT / "docs" / name).stat().st_size <= gallery.LARGEST_BYTES, name
    made = " ".join(text for _, text in gallery.BLOCK.findall(page))
    for source in shown.values():
        assert source.split("/")[0] in made, f"no block of the page makes {source}"


def test_the_gallery_runs_its_blocks_in_order(tmp_path: Path) -> None:
    page = (
        "```toml\n# a.toml\nx = 1\n```\n```sh\ncp a.toml b.toml\n```\n```python\n"
        'open("c", "w").write(open("b.toml").read())\n```\n![c](gallery/c.png "c")\n'
    )
    assert tool("gallery").make(page, tmp_path) == {"gallery/c.png": tmp_path / "c"}
    assert (tmp_path / "c").read_text() == "# a.toml\nx = 1\n"
    with pytest.raises(subprocess.CalledProcessError):
        tool("gallery").make("```sh\nfalse\ntrue\n```\n", tmp_path)
