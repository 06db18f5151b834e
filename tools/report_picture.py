"""Makes the picture of README: the first screen of the demonstration's report, in a browser.

    python tools/report_picture.py

Its metadata say which version of the page it shows; a test fails where that is not today's.
"""

import subprocess
import sys
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from PIL.PngImagePlugin import PngInfo

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "report.png"
WIDTH, HEIGHT, SCALE = 1280, 800, 1.5
COLOURS = 256


def make(page: Path, made_by: str, folder: Path) -> bytes:
    """The first screen of a page as PNG."""
    from tests.browser import browser

    with browser(folder / "profile") as tab:
        tab.open(page, WIDTH, HEIGHT)
        size = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": SCALE, "mobile": False}
        tab.send("Emulation.setDeviceMetricsOverride", **size)
        tab.run("new Promise(done => setTimeout(done, 500))")
        tab.screenshot(folder / "shot.png")
    words, out = PngInfo(), BytesIO()
    words.add_text("Software", made_by)
    with Image.open(folder / "shot.png") as shot:
        shot.convert("RGB").quantize(COLOURS).save(out, "PNG", optimize=True, pnginfo=words)
    return out.getvalue()


def main() -> None:
    """Make the demonstration, and the picture of its report."""
    sys.path.insert(0, str(ROOT))
    from gonio_analysis.report.html import made_by

    with TemporaryDirectory() as name:
        folder = Path(name)
        command = [Path(sys.executable).parent / "gonio", "demo", "--out", "demo"]
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        PICTURE.write_bytes(make(folder / "demo" / "run" / "report" / "index.html", made_by(), folder))
    print(f"{PICTURE.relative_to(ROOT)}: {PICTURE.stat().st_size / 1000:.0f} kB, {made_by()}")


if __name__ == "__main__":
    main()
