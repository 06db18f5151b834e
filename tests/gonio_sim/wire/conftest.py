"""The line to a twin, and the SDK on it, as the tests of the drivers have them."""

from tests.gonio_drivers.conftest import line, sdk, wired

__all__ = ["line", "sdk", "wired"]
