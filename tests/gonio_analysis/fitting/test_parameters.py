"""Every model as a fit sees it: its starts are inside its bounds, and its arguments make the model."""

from __future__ import annotations

import pytest
from gonio_analysis.fitting import parameters

from gonio.errors import ConfigError
from gonio.models import build

NAMES = ("lambert", "oren-nayar", "phong", "blinn", "cook-torrance", "he-torrance")


@pytest.mark.parametrize("name", NAMES)
def test_arguments_build_the_model(name: str) -> None:
    family = parameters.family(name)
    middle = {}
    for own, p in family.parameters.items():
        middle[own] = (p.lower * p.upper) ** 0.5 if p.scale == "log" else (p.lower + p.upper) / 2
    form = {"form": "exact"} if name == "oren-nayar" else {}  # the form that takes a mean slope
    assert build(name, {**family.arguments({**middle, **family.fixed}), **form}).name == name


def test_an_unknown_parameter_is_named() -> None:
    with pytest.raises(ConfigError, match="sigma0_um"):
        parameters.family("he-torrance").parameter("sigma_um")


def test_a_sum_is_its_parts() -> None:
    assert parameters.parts("oren-nayar + cook-torrance") == ("oren-nayar", "cook-torrance")
    assert parameters.needs_ior("oren-nayar+cook-torrance")
    assert not parameters.needs_ior("lambert")
