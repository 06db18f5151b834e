"""Colours and line styles of all plots."""

INK, FAINT = "#222222", "#c9ced6"
