"""Scenes: curved samples in front of a camera, rendered through the models, in physical units."""
