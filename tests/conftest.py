"""What holds for every test: none is timed, because machines that run them are busy with others."""

from __future__ import annotations

from hypothesis import settings

# the same examples in every run; `pytest --hypothesis-profile=default` draws others
settings.register_profile("gonio", deadline=None, derandomize=True)
settings.load_profile("gonio")
