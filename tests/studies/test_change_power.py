"""How often two measurements are called changed, as `tools/studies/change_power.py` counts it for docs/analysis.md."""

import sys

import pytest

from tools.studies import change_power as power


@pytest.mark.parametrize("apart", [False, True])
def test_a_zero_is_found_and_nothing_is_not(apart: bool) -> None:
    (zero,) = (case for case in power.CASES if case.words == "a zero of theta_r, 0.2 degrees")
    # 4.6 standard uncertainties and a level of 0.2 %: 93 % are found; of 30 fewer than 24 in 2 of 1000 cases
    assert power.changed(zero, 30, apart, 5) >= 24
    # 1 % of 60: more than 4 in 3 of 10 000 cases
    assert power.changed(power.NOTHING, 60, apart, 6) <= 4


def test_a_line_is_told_of_each_case(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["change_power.py", "--pairs", "1", "--nulls", "1"])
    power.main()
    said = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in said] == [case.words for case in (power.NOTHING, *power.CASES)]
