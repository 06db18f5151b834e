"""Chromium without a window, driven through its debugging pipe (file descriptors 3 and 4, no network, no library)."""

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ARGUMENTS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage"),
    "--remote-debugging-pipe",
)
PATIENCE_S = 300.0
"""Longest wait for an answer; a loaded machine takes seconds to start the browser."""


class Page:
    """One tab. Messages of the page's console and its uncaught errors gather in `complaints`."""

    def __init__(self, read: int, write: int) -> None:
        self._read, self._write = read, write
        self._buffer = b""
        self._count = 0
        self._session: str | None = None
        self._loaded = False
        self.complaints: list[str] = []
        self.new_tab()

    def new_tab(self, address: str = "about:blank") -> str:
        """Open another tab in front of the others, and go on in it; a word for `to_tab`."""
        self._session = None
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        assert self._session is not None
        for domain in ("Page", "Runtime", "Log"):
            self.send(f"{domain}.enable")
        if address != "about:blank":
            self.send("Page.navigate", url=address)
        return self._session

    def to_tab(self, tab: str) -> None:
        """Go on in a tab that was opened before; it comes to the front."""
        self._session = tab
        self.send("Page.bringToFront")

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the DevTools protocol; its result."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._write, data) :]
        while True:
            answer = self._receive()
            if answer.get("id") == self._count:
                assert "error" not in answer, f"{method}: {answer['error']['message']}"
                result: dict[str, Any] = answer["result"]
                return result

    def _receive(self) -> dict[str, Any]:
        until = time.monotonic() + PATIENCE_S
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(0.0, until - time.monotonic()))
            assert ready, "the browser did not answer"
            chunk = os.read(self._read, 1 << 20)
            assert chunk, "the browser ended"
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        if message.get("method") in ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded"):
            self.complaints.append(json.dumps(message["params"]))
        self._loaded = self._loaded or message.get("method") == "Page.loadEventFired"
        return message

    def resize(self, width: int, height: int = 900) -> None:
        """The size of the window."""
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

    def open(self, path: Path | str, width: int, height: int = 900, *, scripts: bool = True) -> None:
        """Load a file or an address at a window size, with its scripts or without; wait until it has been drawn."""
        self.send("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.resize(width, height)
        self._loaded = False
        self.send("Page.navigate", url=path if isinstance(path, str) else path.resolve().as_uri())
        while not self._loaded:
            self._receive()
        if scripts:
            self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def until(self, expression: str, patience_s: float = 180.0) -> float:
        """Wait until a JavaScript expression is true; how long that took [s]."""
        began = time.monotonic()
        while not self.run(expression):
            assert time.monotonic() - began < patience_s, f"not within {patience_s:g} s: {expression}"
            time.sleep(0.01)
        return time.monotonic() - began

    def run(self, expression: str) -> Any:
        """The value of a JavaScript expression; a promise is awaited."""
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def press(self, key: str) -> None:
        """One key, by its DOM name."""
        codes = {"Tab": 9, "Enter": 13, "Escape": 27, " ": 32, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39}
        code = {"key": key, "windowsVirtualKeyCode": codes.get(key, 40), "code": "Space" if key == " " else key}
        self.send("Input.dispatchKeyEvent", type="keyDown", **code, **({"text": " "} if key == " " else {}))
        self.send("Input.dispatchKeyEvent", type="keyUp", **code)

    def move(self, x: float, y: float) -> None:
        """The mouse, to a place in the window."""
        self.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """What the window shows (or the whole page) as a PNG."""
        data = self.send("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))

    def pdf(self) -> bytes:
        """The page as it would be printed, in the paper size that its style sheet asks for."""
        data: str = self.send("Page.printToPDF", preferCSSPageSize=True)["data"]
        return base64.b64decode(data)


@contextmanager
def browser(profile: Path) -> Iterator[Page]:
    """Start Chromium with a profile folder of its own; its tab. It ends with the block."""
    assert CHROMIUM is not None
    low = [*os.pipe(), *os.pipe(), os.open(os.devnull, os.O_RDWR)]
    ends = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 20) for fd in low]  # out of the way of 3 and 4
    for fd in low:
        os.close(fd)
    their_read, our_write, our_read, their_write, null = ends
    actions = [(os.POSIX_SPAWN_DUP2, their_read, 3), (os.POSIX_SPAWN_DUP2, their_write, 4)]
    actions += [(os.POSIX_SPAWN_DUP2, null, fd) for fd in (0, 1, 2)]
    command = [CHROMIUM, *ARGUMENTS, f"--user-data-dir={profile}"]
    child = os.posix_spawn(CHROMIUM, command, dict(os.environ), file_actions=actions, setsid=True)
    for fd in (their_read, their_write, null):
        os.close(fd)
    try:
        yield Page(our_read, our_write)
    finally:
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(our_read)
        os.close(our_write)
