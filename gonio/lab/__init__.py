"""How a BRDF is measured: rigs, plans, acquisition, reduction, calibration, and work by hand.

What comes out is the measurement table (`gonio.measurement`); whoever reads tables needs nothing of this.
"""
