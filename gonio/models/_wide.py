"""Compiled functions that use the whole width of the vector registers.

LLVM halves 512-bit vectors on many processors, to spare mixed code a lower clock; the loops over kernels are all
vectors. The preference is an attribute of each function, so that no other compiled code of the process is touched.
"""

# mypy: allow-any-generics, disallow-subclassing-any=False

from __future__ import annotations

from typing import Any

from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering

ATTRIBUTE = '"prefer-vector-width"="512"'


class _Lower(Lower):
    def lower_normal_function(self, fndesc: Any) -> None:
        super().lower_normal_function(fndesc)
        # llvmlite's own `add` knows only attributes without a value
        set.add(self.function.attributes, ATTRIBUTE)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    _name = "wide_native_lowering"

    @property
    def lowering_class(self) -> type[Lower]:
        return _Lower


class Wide(CompilerBase):
    """numba's usual pipeline, with the attribute on what it lowers."""

    def define_pipelines(self) -> list[Any]:
        pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state)
        pipeline.passes = [(_Lowering if step is NativeLowering else step, text) for step, text in pipeline.passes]
        pipeline.finalize()
        return [pipeline]
