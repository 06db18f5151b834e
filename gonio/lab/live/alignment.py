"""The page of `gonio rig align --live`: pictures of the camera, and what they show. It reads, and controls nothing."""

from importlib.resources import files
from typing import Protocol

from gonio.lab.live.event_log import EventLog
from gonio.lab.live.server import Content, Request, Route
from gonio.look import part
from gonio.typing import JsonObject

KEPT = 3
"""Frames whose pictures are kept: a browser asks for the one that it was just told of."""


class Pictures(Protocol):
    """Pictures of one frame."""

    @property
    def whole(self) -> bytes:
        """JPEG."""

    @property
    def zoom(self) -> bytes:
        """PNG."""


class AlignmentPage:
    """What the server serves of a session; whoever looks gets the newest frame, and a slow one fewer of them."""

    def __init__(self) -> None:
        self.events = EventLog()
        self.seen = False
        """Somebody has opened the page."""
        self._pictures: dict[int, Pictures] = {}

    @property
    def routes(self) -> dict[str, Route]:
        """For `Server`."""
        return {"/": self._page, "/frame": self._frame, "/zoom": self._zoom}

    def tell(self, told: JsonObject, pictures: Pictures | None) -> None:
        """What there is to show now, with the pictures of a new frame; as `gonio.lab.by_hand.assistant.Tell`."""
        if pictures is not None:
            newest = {number: kept for number, kept in self._pictures.items() if number > told["n"] - KEPT}
            self._pictures = newest | {told["n"]: pictures}  # a new one: threads of the server read the old one
        self.events.tell("look", told)

    def end(self, *, dark: bool) -> None:
        """The rig was left; `dark`: its lamp is known to be dark."""
        self.events.tell("end", {"dark": dark})

    def _page(self, request: Request) -> Content:
        self.seen = True
        folder = files(__package__)
        own = {"style": "alignment.css", "program": "alignment.js"}
        parts = {word: folder.joinpath(name).read_text(encoding="utf-8") for word, name in own.items()}
        parts |= {"look": part("style.css"), "live": part("live.css"), "every": part("page.js")}
        text = folder.joinpath("alignment.html").read_text(encoding="utf-8")
        for word, filled in (parts | {"nonce": request.nonce}).items():
            text = text.replace("{{" + word + "}}", filled)
        return Content(text.encode(), "text/html")

    def _of(self, request: Request) -> Pictures | None:
        kept, said = self._pictures, request.query.get("n", "")
        if not kept:
            return None
        number = int(said) if said.isascii() and said.isdigit() and len(said) < 16 else 0
        return kept.get(number, kept[max(kept)])

    def _frame(self, request: Request) -> Content | None:
        found = self._of(request)
        return None if found is None else Content(found.whole, "image/jpeg")

    def _zoom(self, request: Request) -> Content | None:
        found = self._of(request)
        return None if found is None else Content(found.zoom, "image/png")
