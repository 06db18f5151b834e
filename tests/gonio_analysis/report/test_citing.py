"""The DataCite record beside a report: written where all that it needs is stated, and said where it is not."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from gonio_analysis.report.making import _cite

from gonio.formats.reader import table

STATED: dict[str, Any] = {"organisation": "Institute", "creators": [{"name": "Doe, Jane"}], "publication_year": 2026}


def measured(laboratory: dict[str, Any] | None) -> pd.DataFrame:
    """One value, of a laboratory."""
    return table(
        theta_i_deg=0.0,
        phi_i_deg=0.0,
        theta_r_deg=30.0,
        phi_r_deg=180.0,
        wavelength_nm=550.0,
        brdf=[0.2],
        attrs={"sample": "tile", "provenance": {} if laboratory is None else {"laboratory": laboratory}},
    )


def test_a_complete_laboratory_is_cited(tmp_path: Path) -> None:
    said: list[str] = []
    _cite([measured(STATED)], tmp_path, said.append)
    record = json.loads((tmp_path / "datacite.json").read_text())
    assert (record["titles"], record["publisher"]) == ([{"title": "BRDF of tile"}], {"name": "Institute"})
    assert said == []


def test_what_is_missing_is_said_and_the_report_goes_on(tmp_path: Path) -> None:
    said: list[str] = []
    _cite([measured({"organisation": "Institute"})], tmp_path, said.append)
    assert "laboratory.creators" in said[0]
    assert "laboratory.publication_year" in said[0]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("tables", [[measured(None)], [measured(STATED), measured(STATED)]])
def test_nothing_is_cited_where_nobody_or_several_are_meant(tables: list[pd.DataFrame], tmp_path: Path) -> None:
    said: list[str] = []
    _cite(tables, tmp_path, said.append)
    assert (said, list(tmp_path.iterdir())) == ([], [])
