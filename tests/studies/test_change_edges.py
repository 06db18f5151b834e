"""Pairs of one model that are called changed, as `tools/studies/change_edges.py` counts them."""

import sys

import pytest

from tools.studies import change_edges


def test_pairs_of_one_model_with_edges_are_called_unchanged() -> None:
    """Of these 36 pairs, of Cook-Torrance, Oren-Nayar and Blinn, 8 were called changed."""
    pairs = [seed for seed in range(84) if seed % len(change_edges.KINDS) < 3]
    # 1 % of 36: more than 3 in 5 of 10 000 cases
    assert sum(change_edges.changed(seed, 5.0, 0.002) for seed in pairs) <= 3


def test_a_line_is_told_of_each_step_and_noise(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["change_edges.py", "--pairs", "1"])
    change_edges.main()
    assert len(capsys.readouterr().out.splitlines()) == len(change_edges.STEPS_DEG) * len(change_edges.NOISES)
