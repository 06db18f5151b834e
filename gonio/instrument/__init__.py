"""What an instrument with a finite source and a finite receiver sees of a model."""

from gonio.instrument.apparent import Cones, Rules, apparent_brdf, apparent_lobe, apparent_spike
from gonio.instrument.lobe import LOBE_TOLERANCE

__all__ = ["LOBE_TOLERANCE", "Cones", "Rules", "apparent_brdf", "apparent_lobe", "apparent_spike"]
