"""A parameter is stated once: checks, bounds of a fit and words come from the fields of a model's class."""

import inspect
from dataclasses import InitVar, dataclass

import numpy as np
import pytest

from gonio.errors import ArgumentError
from gonio.models import RPV, ArrayModel, Blinn, CookTorrance, Fitted, GGXMultiscatter, OrenNayar, parameter
from gonio.models.parameters import described
from gonio.typing import Floats


@dataclass(frozen=True)
class Own(ArrayModel):
    """A level."""

    level: float = parameter(0.1, "(0, 1]", "How bright.", "1/sr", scale="log", bounds=(0.01, 1.0), starts=(0.5,))
    turn: float = parameter(0.0, "[0, 90)", "Where to.", "deg", scale="linear")
    other: float | None = parameter(None, "[0, inf)", "What else.")
    form: str = parameter("a", ("a", "b"), "Which.")
    name = "own"

    @property
    def convention(self) -> str:
        return "Own."

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        return np.full(len(omega_i), self.level)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"level": 0.0}, r"level = 0 1/sr: must be finite and in \(0, 1\]"),
        ({"turn": 90.0}, r"turn = 90 deg: must be finite and in \[0, 90\)"),
        ({"other": -1}, "other = -1: must be finite and at least 0"),
        ({"other": np.inf}, "other = inf: must be finite"),
        ({"level": np.nan}, "level = nan"),
        ({"level": None}, "level must be one real number"),
        ({"form": "c"}, 'form = \'c\': must be one of "a", "b"'),
    ],
)
def test_the_constructor_checks_what_the_table_says(given: dict[str, float], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        Own(**given)  # type: ignore[arg-type]


def test_the_ends_of_a_range_are_taken_or_not_as_it_is_written() -> None:
    own = Own(level=1, turn=np.nextafter(90.0, 0.0), other=0)
    assert (own.level, own.other, Own().other) == (1.0, 0.0, None)
    assert isinstance(own.level, float)


def test_a_fit_moves_what_has_a_scale_within_bounds_or_the_range() -> None:
    assert Own.fitted == {
        "level": Fitted(0.01, 1.0, "log", "1/sr", (0.5,)),
        "turn": Fitted(0.0, np.nextafter(90.0, 0.0), "linear", "deg"),
    }
    assert Own.declaration().free == ("level", "turn")


def test_words_stand_in_the_docstring_and_in_reports() -> None:
    assert "level\n    How bright. In (0, 1] 1/sr.\n" in (Own.__doc__ or "")
    assert described(Own)["form"] == 'Which. One of "a", "b".'
    assert described(GGXMultiscatter)["alpha"].endswith("In [0.001, 1].")


def test_a_class_with_a_check_of_its_own_and_plain_fields_goes_on_as_it_was() -> None:
    @dataclass(frozen=True)
    class Former(Own):
        plain: float = 3.0
        twice: InitVar[float] = 2.0
        fitted = {"plain": Fitted(0.0, 9.0)}  # noqa: RUF012

    assert Former(plain=-5.0).plain == -5.0
    assert list(Former.declaration().parameters) == ["plain"]
    with pytest.raises(ArgumentError, match="turn"):
        Former(turn=-1.0)


@pytest.mark.parametrize("kind", [RPV, Blinn, CookTorrance, OrenNayar, GGXMultiscatter])
def test_all_arguments_of_a_constructor_are_in_the_table(kind: type[RPV]) -> None:
    assert set(inspect.signature(kind).parameters) == {*kind.table, *kind.besides}
