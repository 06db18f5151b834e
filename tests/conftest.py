"""What holds for every test: none is timed, because machines that run them are busy with others."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("gonio", deadline=None)
settings.load_profile("gonio")
