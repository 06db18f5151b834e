"""Fits of very many: every pixel of a map, every table of a folder, and materials that pixels share (docs/maps.md)."""
