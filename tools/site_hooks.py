"""What mkdocs does beside its own work for the site (mkdocs.yml, docs/site.md).

README.md becomes the first page, pages of studies and executed notebooks become pages, folders that the navigation
names become lists of their pages, and every link of the finished site is followed. A warning here ends
`mkdocs build --strict`.
"""

import base64
import json
import logging
import re
from collections.abc import Iterator
from html import escape, unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from mkdocs.structure.files import File

from gonio.typing import JsonObject

log = logging.getLogger("mkdocs.gonio")
ROOT = Path(__file__).resolve().parents[1]
ENTRY_POINT = re.compile(r"(?m)^# (.+)$")
RULES = '    options: {filters: ["!^_|^[a-z]|^[A-Z][a-z]"]}'
"""What pages of methods show of a module that they say no more about: its own words and its constants."""
STUDIES = {"studies/index.md": "tools/studies/readme.md", "studies/findings.md": "tools/studies/findings.md"}
"""Pages of the site that stand beside what they tell of."""


# --- before: files that mkdocs does not have by itself ---------------------------------------------------------------


def on_config(config: Any) -> Any:
    """Fill in the folders that the navigation names."""
    config.nav = _with_folders(config.nav, Path(config.docs_dir))
    return config


def _with_folders(items: Any, docs: Path) -> Any:
    if isinstance(items, list):
        return [_with_folders(one, docs) for one in items]
    if isinstance(items, dict):
        return {name: _with_folders(one, docs) for name, one in items.items()}
    if items.endswith("/"):
        return [items + "index.md", *(f"{items}{page.name}" for page in sorted((docs / items).glob("*.md")))]
    return items


def on_files(files: Any, config: Any) -> Any:
    """Add the first page, the lists of folders, and the notebooks' pages with their pictures."""
    docs = Path(config.docs_dir)
    files.append(File.generated(config, "index.md", content=first_page((ROOT / "README.md").read_text("utf-8"))))
    files.append(File.generated(config, "decisions/index.md", content=listed(docs / "decisions")))
    for page, source in STUDIES.items():
        files.append(File.generated(config, page, content=study((ROOT / source).read_text("utf-8"))))
    for path in sorted((docs / "notebooks").glob("*.ipynb")):
        text, pictures = page_of(json.loads(path.read_text("utf-8")), path.stem)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, data in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=data))
    return files


def first_page(readme: str) -> str:
    """README.md with its links as seen from docs/."""
    text = readme.replace("](docs/decisions)", "](decisions/index.md)")
    return re.sub(r"\]\(docs/", "](", _with_studies(text, "tools/studies/", "studies/"))


def study(text: str) -> str:
    """A page of tools/studies with its links as seen from the folder studies of the site."""
    return _with_studies(text.replace("](../../docs/", "](../"), "", "")


def _with_studies(text: str, seen_from: str, to: str) -> str:
    """Links to pages of tools/studies lead to where these stand in the site."""
    for page, source in STUDIES.items():
        text = text.replace(f"]({seen_from}{Path(source).name}", f"]({to}{Path(page).name}")
    return text


def listed(folder: Path) -> str:
    """A page that lists the pages of a folder by their headings."""
    lines = [f"# {folder.name.capitalize()}", ""]
    for path in sorted(folder.glob("*.md")):
        heading = ENTRY_POINT.search(path.read_text("utf-8"))
        lines.append(f"- [{heading[1] if heading else path.stem}]({path.name})")
    return "\n".join(lines) + "\n"


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to notebooks lead to their pages, and those to README.md to the first page; methods are filtered."""
    if page.file.src_uri.startswith("notebooks/"):
        return markdown
    if page.file.src_uri.startswith("reference/methods"):
        markdown = re.sub(r"(?m)^(::: \S+)$(?!\n    options)", rf"\1\n{RULES}", markdown)
    markdown = markdown.replace("](../README.md", "](index.md")
    up = page.file.src_uri.count("/")
    markdown = _with_studies(markdown, "../" * (up + 1) + "tools/studies/", "../" * up + "studies/")
    return re.sub(r"(\]\([\w/.-]*)\.ipynb\)", r"\1.md)", markdown)


# --- notebooks -------------------------------------------------------------------------------------------------------


def page_of(notebook: JsonObject, stem: str) -> tuple[str, dict[str, bytes]]:
    """The page of an executed notebook, and its pictures by file name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(re.sub(r"\.ipynb\)", ".md)", source))
            continue
        parts.append(_fenced(source, "python"))
        for output in cell["outputs"]:
            parts.append(_shown(output, stem, pictures))
    heading, rest = parts[0].split("\n", 1) if "\n" in parts[0] else (parts[0], "")
    taken = f"[Take this notebook]({stem}.ipynb){{ .download download={stem}.ipynb }}"
    return "\n\n".join([heading, taken, rest.strip(), *parts[1:]]) + "\n", pictures


def _shown(output: JsonObject, stem: str, pictures: dict[str, bytes]) -> str:
    if output["output_type"] == "stream":
        return _fenced("".join(output["text"]), "text", "output")
    data = {kind: "".join(value) for kind, value in output["data"].items() if isinstance(value, str | list)}
    if "image/png" in data:
        name = f"{stem}_{len(pictures) + 1}.png"
        pictures[name] = base64.b64decode(data["image/png"])
        alt = output["metadata"].get("alt") or data.get("text/plain", "")
        return f"![{alt.strip('<>')}]({name})"
    if "text/html" in data:
        return f'<div class="output" markdown="0">\n{_without_blank_lines(data["text/html"])}\n</div>'
    return _fenced(data["text/plain"], "text", "output")


def _without_blank_lines(html: str) -> str:
    """HTML that Markdown leaves alone, with tables in the site's style and not in their own."""
    html = re.sub(r"<style.*?</style>", "", html, flags=re.DOTALL)
    html = re.sub(r"<table[^>]*>", "<table>", html)
    return "\n".join(line.strip() for line in html.splitlines() if line.strip())


def _fenced(text: str, language: str, *classes: str) -> str:
    return f"``` {{ .{' .'.join((language, *classes))} }}\n{text.rstrip()}\n```"


# --- after: every link -----------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """What one page points at, and what can be pointed at in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        """Where a click leads."""
        self.loads: list[str] = []
        """What is needed to show the page."""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = {name: value for name, value in attrs if value}
        self.anchors |= {named[name] for name in ("id", "name") if name in named}
        if "href" in named and tag != "base":
            of_page = tag == "link" and named.get("rel") not in ("canonical", "prev", "next")
            (self.loads if of_page else self.links).append(named["href"])
        if "src" in named:
            self.loads.append(named["src"])
        self.loads += [part.split()[0] for part in named.get("srcset", "").split(",") if part.strip()]


def on_post_build(config: Any) -> None:
    """Say what is wrong with the links of the finished site."""
    (Path(config.site_dir) / "404.html").unlink(missing_ok=True)  # nobody serves it, and its links begin at a root
    for said in dead_links(Path(config.site_dir)):
        log.warning(said)


def dead_links(site: Path) -> Iterator[str]:
    """A sentence for each link that leads nowhere, and for each thing that a page would load from the network."""
    pages = {path.resolve(): Page(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        here = path.relative_to(site.resolve())
        for link in [*page.links, *page.loads]:
            parts = urlsplit(unescape(link))
            if parts.scheme in ("data", "javascript", "mailto"):
                continue
            if parts.scheme or parts.netloc:
                if link in page.loads:
                    yield f"{here}: needs the network for {escape(link)}"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target /= "index.html"
            if not target.is_file():
                yield f"{here}: {link} leads to no file"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                yield f"{here}: {link} leads to no place on its page"
