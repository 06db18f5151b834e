"""From the raw frames of a run to BRDF with its uncertainty (docs/radiometry.md)."""
