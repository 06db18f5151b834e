"""Colours and line styles of all plots."""

from __future__ import annotations

INK, FAINT = "#222222", "#c9ced6"
