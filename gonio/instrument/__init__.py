"""What an instrument with a finite source and a finite receiver sees of a model."""

from gonio.instrument.apparent import Cones, Rules, apparent_brdf, apparent_lobe, apparent_spike

__all__ = ["Cones", "Rules", "apparent_brdf", "apparent_lobe", "apparent_spike"]
