"""Measured tables for renderers: what each takes, and what of it was measured.

A renderer asks for every pair of directions. A table is interpolated between its directions and beyond them
(`interpolated`), and the file says how much of it was not measured.
"""
