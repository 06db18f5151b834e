"""The look of all pages: `style.css` and `page.js`; `live.css` of those that update themselves."""

from importlib.resources import files


def part(name: str) -> str:
    """The text of one of its files."""
    return files(__name__).joinpath(name).read_text(encoding="utf-8")
