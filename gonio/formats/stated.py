"""What a table's provenance states of its laboratory (`[laboratory]` of the run), and what a record still needs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gonio.documents import JsonObject
from gonio.errors import ConfigError
from gonio.typing import DataFrame

Need = str | tuple[str, ...]
"""A key that a record needs; of several keys in a tuple one is enough."""


def laboratory_of(frame: DataFrame) -> JsonObject | None:
    """The table `[laboratory]` of the run that a table was reduced from; None where it had none."""
    provenance = frame.attrs.get("provenance")
    stated = provenance.get("laboratory") if isinstance(provenance, Mapping) else None
    return stated if isinstance(stated, dict) else None


def get(stated: Mapping[str, Any], key: str) -> Any:
    """A value by its key, as `address.city`; None where it is not stated."""
    inner: Any = stated
    for part in key.split("."):
        inner = inner.get(part) if isinstance(inner, Mapping) else None
    return inner


def require(stated: Mapping[str, Any], keys: Sequence[Need], what: str, path: Path) -> None:
    """Raise `ConfigError` that names every key that a record needs and nobody has stated."""
    missing = [
        one if isinstance(one, str) else f"{one[0]} (or {', '.join(one[1:])})"
        for one in keys
        if all(get(stated, key) in (None, [], "") for key in ([one] if isinstance(one, str) else one))
    ]
    if missing:
        named = "".join(f"\n  laboratory.{key}" for key in missing)
        raise ConfigError(
            f"{path}: {what} needs what nobody has stated, and nothing is invented:{named}\n"
            "state these keys in [laboratory] of the plan or of the rig file; for a run that is measured, say the same "
            "`gonio measure` with --resume, and `gonio reduce` again"
        )
