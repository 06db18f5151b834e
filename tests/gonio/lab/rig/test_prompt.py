"""What a rig asks of a person, where nobody can answer."""

import io

import pytest

from gonio.errors import DeviceError
from gonio.lab.rig import ask_for


class Gone(io.StringIO):
    """A terminal that was closed."""

    # typeshed's own StringIO carries the same mark: the base class of all streams reads bytes.
    def readline(self, size: int | None = -1, /) -> str:  # type: ignore[override]
        """What the system says then."""
        raise OSError(5, "Input/output error")


@pytest.mark.parametrize("stdin", [io.StringIO(), Gone()], ids=["at its end", "gone"])
def test_a_terminal_that_cannot_answer_is_an_error_of_the_rig(
    stdin: io.StringIO, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", stdin)
    with pytest.raises(DeviceError, match="the reference must be put into the holder, and there is no terminal"):
        ask_for("reference")
