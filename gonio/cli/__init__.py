"""The command line `gonio`. What it does is in `application.py`.

This module imports next to nothing: from its `main` on a signal ends in one line, and before that it kills.
"""

import gc
import os
import sys

from gonio.cli.signals import Ending, deafen


def main() -> None:
    """Run the command line, and end the process with its exit code."""
    ending = Ending()
    ending.listen()
    # numpy's matrices are small here: threads of BLAS that wait for each other cost ten times what they save
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # what a command makes stays until it ends: at the usual 700 objects the collector walks over all of it in vain
    gc.set_threshold(50_000)
    try:
        from gonio.cli import application

        code = application.run(ending)
    except KeyboardInterrupt:
        deafen()
        print("gonio: interrupted", file=sys.stderr)
        code = 130
    gc.freeze()  # at its end Python would walk over all of it once more, for 0.3 to 0.5 s
    sys.exit(code)
