"""What holds for all tests of reports."""

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def no_pdf() -> Iterator[None]:
    """A PDF is a third of a report's time, and says what the page says. Tests of it have a fixture of this name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gonio_analysis.report.pdf.write", lambda *given, **named: None)
        yield
