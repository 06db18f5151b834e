"""Versions, and whether the files are those that were released."""

import base64
import hashlib
import platform
from importlib import metadata
from pathlib import Path

import gonio
from gonio_validation.verify.finding import Finding

NEEDED = ("numpy", "scipy", "numba", "pandas", "matplotlib", "pydantic")
FOLDERS = ("gonio", "gonio_drivers", "gonio_bluesky", "gonio_sim", "gonio_scenes", "gonio_analysis", "gonio_sweeps",
           "gonio_watch", "gonio_maps", "gonio_validation")  # fmt: skip


def look(_folder: Path) -> list[Finding]:
    """See `gonio_validation.verify`."""
    stated = metadata.version("gonio")
    out = [Finding("version", stated == gonio.__version__, gonio.__version__, f"{stated}, as installed")]
    out += [Finding(name, True, metadata.version(name), "recorded") for name in NEEDED]
    out.append(Finding("python", True, f"{platform.python_version()} on {platform.machine()}", "recorded"))
    return [*out, *_checksums()]


def _checksums() -> list[Finding]:
    files = [one for one in metadata.files("gonio") or [] if one.parts[0] in FOLDERS and one.hash is not None]
    if not files:
        return [Finding(f"files of {name}", True, digest, "recorded") for name, digest in _own()]
    wrong = []
    for one in files:
        assert one.hash is not None
        path = Path(str(one.locate()))
        found = hashlib.new(one.hash.mode, path.read_bytes()).digest() if path.is_file() else b""
        if base64.urlsafe_b64encode(found).rstrip(b"=").decode() != one.hash.value:
            wrong.append(str(one))
    said = f"{len(wrong)} of {len(files)} differ: {', '.join(wrong[:5])}" if wrong else f"all {len(files)} agree"
    return [Finding("checksums of the files", not wrong, said, "as released")]


def _own() -> list[tuple[str, str]]:
    """For an installation for editing: one checksum a package, over names and contents."""
    import importlib.util

    out = []
    for name in FOLDERS:
        spec = importlib.util.find_spec(name)
        if spec is None or not spec.submodule_search_locations:
            continue
        root, digest = Path(spec.submodule_search_locations[0]), hashlib.sha256()
        for path in sorted(p for p in root.rglob("*") if p.is_file() and "__pycache__" not in p.parts):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
        out.append((name, f"sha256 {digest.hexdigest()[:16]}"))
    return out
