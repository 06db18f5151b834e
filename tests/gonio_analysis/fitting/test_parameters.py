"""Every model as a fit sees it: its starts are inside its bounds, and its arguments make the model."""

from __future__ import annotations

import pytest
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.observations import observations

from gonio.errors import ConfigError
from gonio.models import Lambert, build
from tests.gonio_analysis.synthetic import measure

NAMES = ("lambert", "oren-nayar", "phong", "blinn", "cook-torrance", "he-torrance")


@pytest.mark.parametrize("name", NAMES)
def test_starts_are_inside_the_bounds_and_free_parameters_are_known(name: str) -> None:
    family = parameters.family(name)
    assert family.name == name
    starts = family.starts(parameters.levels(observations(measure(Lambert(0.5)))))
    assert starts
    for start in starts:
        for parameter, value in start.items():
            assert family.parameter(parameter).inside(value) == value
    for parameter in (*family.free, *family.fixed):
        one = family.parameter(parameter)
        assert one.lower < one.upper
        assert one.scale == "linear" or one.lower > 0


@pytest.mark.parametrize("name", NAMES)
def test_arguments_build_the_model(name: str) -> None:
    family = parameters.family(name)
    middle = {}
    for own, p in family.parameters.items():
        middle[own] = (p.lower * p.upper) ** 0.5 if p.scale == "log" else (p.lower + p.upper) / 2
    assert build(name, family.arguments({**middle, **family.fixed})).name == name


def test_an_unknown_parameter_is_named() -> None:
    with pytest.raises(ConfigError, match="sigma0_um"):
        parameters.family("he-torrance").parameter("sigma_um")


def test_a_sum_is_its_parts() -> None:
    assert parameters.parts("oren-nayar + cook-torrance") == ("oren-nayar", "cook-torrance")
    assert parameters.needs_ior("oren-nayar+cook-torrance")
    assert not parameters.needs_ior("lambert")
