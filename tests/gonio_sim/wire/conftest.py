"""The line of servos that the drivers' tests stand on as well."""

from tests.gonio_drivers.conftest import line, sdk  # noqa: F401
