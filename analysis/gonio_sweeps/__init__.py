"""Sweeps that choose their own points: choosers of the entry-point group `gonio.choosers` (docs/adaptive_sweeps.md)."""
