"""Measured tables and models for renderers: what each takes, what of it was measured, and how far a translation is off.

A renderer asks for every pair of directions. A table is interpolated between its directions and beyond them
(`interpolated`), and the file says how much of it was not measured. Blender and glTF take
parameters of a model of their own: it is fitted, and the file says what it misses (`translation`).
"""
