"""The line to a twin, and the SDK on it, as the tests of the drivers have them."""

import pytest

from tests.gonio_drivers.conftest import Line, sdk, wired

__all__ = ["sdk", "wired"]


@pytest.fixture
def line(wired: Line) -> Line:
    return wired
