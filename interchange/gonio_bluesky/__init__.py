"""Bluesky: a run as documents of its event model, and a rig as its devices."""
