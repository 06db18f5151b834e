"""Sweeps that choose their own points: samplers of the entry-point group `gonio.choosers` (docs/adaptive_sweeps.md)."""
