"""What a rig asks of the person beside it, on the terminal."""

import sys

from gonio.errors import DeviceError
from gonio.lab.rig.protocols import Target

PROMPTS: dict[Target, str] = {
    "reference": "Put the white reference into the holder, then press Enter (Ctrl-C twice stops): ",
    "sample": "Put the sample back into the holder, then press Enter (Ctrl-C twice stops): ",
}


STRAIGHT: dict[Target, str] = {
    "reference": "Take the sample out of the holder, and put the attenuator before the lamp, then press Enter "
    "(Ctrl-C twice stops): ",
    "sample": "Take the attenuator away, and put the sample back into the holder, then press Enter (Ctrl-C twice "
    "stops): ",
}


def ask_for(target: Target, *, beam: bool = False) -> None:
    """Ask on the terminal for sample or white reference to be put into the holder by hand, and wait until it is.

    With `beam` the lamp itself, seen through an attenuator and an empty holder, is the reference.

    Raises
    ------
    DeviceError
        There is no terminal.
    """
    print((STRAIGHT if beam else PROMPTS)[target], end="", file=sys.stderr, flush=True)
    try:
        answer = sys.stdin.readline()
    except OSError:  # the terminal has gone
        answer = ""
    if not answer:
        raise DeviceError(
            f"the {target} must be put into the holder, and there is no terminal to confirm it; --yes asks for none"
        )
