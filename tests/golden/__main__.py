"""`python -m tests.golden [CASE ...]`: what changed since the golden set was made; `--update` makes it again."""

import argparse
import difflib
import tempfile
from pathlib import Path

from tests.golden.cases import CASES
from tests.golden.comparison import difference, same_for_all
from tests.golden.stored import MADE_ON, carried_out, processor, read, tolerance, write


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}, help; all by default")
    parser.add_argument("--update", action="store_true", help="write what is printed and written now")
    parser.add_argument("--lines", type=int, default=20, help="lines of each difference that are shown")
    asked = parser.parse_args()
    for name in asked.cases or [*CASES, "help"]:
        with tempfile.TemporaryDirectory() as folder:
            now = carried_out(name, Path(folder))
        before = read(name)
        changed = [
            file for file in sorted({*before, *now})
            if file not in before or file not in now or difference(before[file], now[file], tolerance(name))
        ]  # fmt: skip
        print(f"{name}: {', '.join(changed) or 'the same'}")
        for file in changed:
            one, other = (same_for_all(texts.get(file, "")).splitlines() for texts in (before, now))
            lines = list(difflib.unified_diff(one, other, f"{name}/{file}, golden", "now", lineterm="", n=1))
            print("\n".join(line[:200] for line in lines[: asked.lines]))
        if asked.update and (changed or not asked.cases):
            write(name, now)
    if asked.update and not asked.cases:
        MADE_ON.write_text(processor() + "\n", encoding="utf-8")


main()
