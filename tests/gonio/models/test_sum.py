"""Sums by name, as sample files have them."""

import pytest

from gonio.errors import ArgumentError, ConfigError
from gonio.models import Lambert, Phong, Sum, build


def test_a_sum_is_built_from_what_it_prints() -> None:
    model = Sum((Lambert(0.5), 0.4), (Phong(k_d=0.0, k_s=0.5, exponent=20), 0.6), (Phong(exponent=5), 0.1))
    assert build("sum", model.parameters) == model


def test_a_term_alone_has_its_model_s_name_and_full_weight() -> None:
    assert build("sum", {"lambert": {"albedo": 0.3}}) == Sum((Lambert(0.3), 1.0))


@pytest.mark.parametrize(
    ("terms", "error", "message"),
    [
        ({"lambrt": {}}, ConfigError, 'did you mean "lambert"'),
        ({"lambert": {"albdo": 0.3}}, ArgumentError, 'did you mean "albedo"'),
        ({"lambert": 0.3}, ArgumentError, "must be a table"),
        ({}, ArgumentError, "at least one pair"),
    ],
)
def test_wrong_terms_are_named(terms: dict[str, object], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        build("sum", terms)
