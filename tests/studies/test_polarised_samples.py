"""The study of blind polarised samples, on two of them: it runs, and its pulls are those of honest uncertainties."""

from pathlib import Path

import numpy as np
import pytest

from tools.studies.polarised_samples import WORDS, draw, pulls, summary


@pytest.mark.slow
def test_two_blind_polarised_samples_are_as_far_off_as_they_say(tmp_path: Path) -> None:
    found = [pulls(tmp_path / str(seed), seed) for seed in (3, 4)]
    for one in found:
        every = np.concatenate([v for name, v in one.items() if name.startswith(tuple(f"{w}, " for w in WORDS))])
        assert len(every) > 120
        # a shared cause of one table moves all of its pulls together: the study's 40 tell the standard deviation
        assert 0.5 < np.sqrt(np.mean(every**2)) < 1.6
        assert one["chi_square"] < 1.4  # of some 138 values: a standard deviation of 0.12
    assert "all: " in summary(found)


def test_the_draws_have_dielectrics_and_metals_of_every_model() -> None:
    drawn = [draw(np.random.default_rng([43, seed])) for seed in range(40)]
    assert {kind for kind, _ in drawn} == {"ggx", "cook-torrance", "he-torrance"}
    assert {parameters["ior"][1] > 0.0 for _, parameters in drawn} == {True, False}
