"""Every formula of the papers once, in numpy, in their order and symbols: the specification of the models.

One module a paper. To find an equation, open its paper's module and search for its number, "eq. 25"; equations
without a number stand under their paper's section and go by their symbol, "Cook1982 R_s". All are listed in
docs/reference/equations.md. "Compiled:" in a docstring names what evaluates the formula in the models.

This is written from the papers and shares nothing with the models' kernels. It is slow and obvious: nothing is
rearranged for speed or for accuracy save where a docstring says so, no argument is checked, and where a formula
divides 0 by 0 so does the function.
Where it loses digits its docstring says how many, as a factor by which rounding errors grow. Where a print is wrong the
docstring says so; the formula is the corrected one, and `printed=True` gives the print where the models offer it too.
"""

from gonio.models.plain import (
    anisotropic,
    blinn,
    cook_torrance,
    fresnel,
    he_torrance,
    he_torrance_appendix_a,
    oren_nayar,
    retroreflecting,
)

__all__ = [
    "anisotropic",
    "blinn",
    "cook_torrance",
    "fresnel",
    "he_torrance",
    "he_torrance_appendix_a",
    "oren_nayar",
    "retroreflecting",
]
