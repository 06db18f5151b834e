"""Checks that come with every table: symmetry, energy, repeats, and what was lost of a run, each with a verdict."""
