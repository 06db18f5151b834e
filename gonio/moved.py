"""Where modules went that earlier versions had elsewhere: their old paths go on working (docs/stability.md).

The module under its old path is the one under its new path, not a copy of it.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

MOVED = {
    **{f"gonio.{name}": f"gonio.lab.{name}" for name in ("rig", "acquisition", "reduction", "calibration", "by_hand")},
    **{
        f"gonio.live.{name}": f"gonio_watch.{name}"
        for name in ("follow", "provisional", "run_status", "shared", "watching", "worker", "picture")
    },
    "gonio.live": "gonio.lab.live",
    "gonio.maps": "gonio_maps.files",
    "gonio.models.batch": "gonio_maps.models.batch",
    "gonio.models.batch_spectra": "gonio_maps.models.batch_spectra",
    "gonio.reduction.maps": "gonio_maps.reduction.maps",
    "gonio_analysis.maps": "gonio_maps.fits",
    "gonio_analysis.maps.many_tables": "gonio_analysis.selection.many_tables",
    "gonio.acquisition.samples": "gonio.samples.files",
    "gonio.rig.textures": "gonio.samples.textures",
    "gonio.reduction.threads": "gonio.threads",
    "gonio_analysis.commands.demonstration": "gonio_validation.demonstration",
    "gonio_analysis.selection.run_record": "gonio.lab.run_facts",
}
"""Old path -> new path, of modules and of packages with all that is in them."""


def new_path(name: str) -> str | None:
    """The path today of a module that has moved; None of one that has not."""
    start = name
    while start:
        if start in MOVED:
            return MOVED[start] + name[len(start) :]
        start = start.rpartition(".")[0]
    return None


class _Mover(MetaPathFinder, Loader):
    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not name.startswith(("gonio.", "gonio_analysis.")) or new_path(name) is None:
            return None
        return ModuleSpec(name, self)

    def exec_module(self, module: ModuleType) -> None:
        new = new_path(module.__name__)
        assert new is not None
        sys.modules[module.__name__] = import_module(new)


def install() -> None:
    """Let old paths be found; once, whoever asks again."""
    if not any(isinstance(finder, _Mover) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Mover())
