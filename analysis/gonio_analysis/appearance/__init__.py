"""Quantities of appearance, of tables and of models: gloss, haze, reflectances, colour over angle, retroreflection."""
