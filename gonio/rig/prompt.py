"""What a rig asks of the person beside it, on the terminal."""

from __future__ import annotations

import sys

from gonio.errors import DeviceError
from gonio.rig.protocols import Target

PROMPTS: dict[Target, str] = {
    "reference": "Put the white reference into the holder, then press Enter (Ctrl-C twice stops): ",
    "sample": "Put the sample back into the holder, then press Enter (Ctrl-C twice stops): ",
}


def ask_for(target: Target) -> None:
    """Ask on the terminal for sample or white reference to be put into the holder by hand, and wait until it is.

    Raises
    ------
    DeviceError
        There is no terminal.
    """
    print(PROMPTS[target], end="", file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise DeviceError(
            f"the {target} must be put into the holder, and there is no terminal to confirm it; --yes asks for none"
        )
