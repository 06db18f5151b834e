"""Fits of very many pixels at once, compiled."""
