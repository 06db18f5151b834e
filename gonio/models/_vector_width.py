"""Compiled functions that use whole vector registers, several side by side, and keep their constants at hand.

LLVM halves 512-bit vectors on many processors, to spare mixed code a lower clock; the loops over kernels are all
vectors. It takes one vector at a time through most loops, and waits for roots and divisions where others could go on.
And it fetches a constant anew, with two instructions, wherever registers are short: a polynomial then spends a third
of its instructions on that. A constant that it cannot see through is set up once before the loop and is an operand in
memory (on an aligned stack). All are properties of each function, so that no other compiled code of the process is
touched.

This rests on names inside numba. Where one is gone, importing this module fails, and `_compile` leaves kernels to
numba's stock pipeline: the same results but for roundings, slower.
"""

# mypy: allow-any-generics, disallow-subclassing-any=False

import functools
import math
from typing import Any

import numpy as np
from llvmlite import ir as llvm
from llvmlite.ir.values import MDValue
from numba.core import ir
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering
from numba.core.untyped_passes import IRProcessing

ATTRIBUTES = ('"prefer-vector-width"="512"', '"frame-pointer"="all"')  # with a frame pointer the stack can be aligned
PLAIN = (0.0, 0.5, 1.0, 2.0)  # what arithmetic with these can be simplified to is worth more
SIDE_BY_SIDE = 4  # vectors that a loop takes, unless it asks for another number
BITS = {llvm.DoubleType(): llvm.IntType(64), llvm.FloatType(): llvm.IntType(32)}
NEEDED = (
    Lower.lower_normal_function,
    Lower.lower_assign,
    NativeLowering.lowering_class,
    DefaultPassBuilder.define_nopython_pipeline,
    FunctionPass.run_pass,
    IRProcessing.run_pass,
)
"""What is overridden or called beside the names imported above: a numba without one of them fails here."""
BEYOND = {1e-75: 1e-9}
"""What stands in float32 for a bound whose products would leave its range."""


class _Lower(Lower):
    side_by_side = SIDE_BY_SIDE
    in_single = False

    def lower_normal_function(self, fndesc: Any) -> None:
        super().lower_normal_function(fndesc)
        for attribute in ATTRIBUTES:  # llvmlite's own `add` knows only attributes without a value
            set.add(self.function.attributes, attribute)
        hints = [("interleave.count", self.side_by_side)]
        if self.in_single:  # LLVM would go by the width of a loop's integers
            hints.append(("vectorize.width", 16))
        seen = set()
        for block in self.function.blocks:
            seen.add(block)
            if not seen.isdisjoint(block.terminator.operands):  # the end of a loop
                asked = [
                    self.module.add_metadata([f"llvm.loop.{name}", llvm.Constant(llvm.IntType(32), number)])
                    for name, number in hints
                ]
                loop = MDValue(self.module, asked, name=str(len(self.module.metadata)))
                loop.operands = (loop, *asked)  # a loop's node names itself
                block.terminator.set_metadata("llvm.loop", loop)

    def lower_assign(self, ty: Any, inst: Any) -> Any:
        value = super().lower_assign(ty, inst)
        source = inst.value
        if not isinstance(source, (ir.Const, ir.Global, ir.FreeVar)) or not isinstance(
            source.value, (float, np.float32)
        ):
            return value
        real = self.context.get_value_type(ty)
        if abs(source.value) in PLAIN or real not in BITS:
            return value
        bits = BITS[real]
        with self.builder.goto_entry_block():  # empty inline assembly: LLVM cannot see the value, but may move it
            kind = llvm.FunctionType(bits, [bits])
            held = self.builder.asm(kind, "", "=r,0", [self.builder.bitcast(value, bits)], False)
            held.attributes.add("readnone")
            held.attributes.add("nounwind")
            return self.builder.bitcast(held, real)


def single(value: float) -> np.float32:
    """A constant in float32; a bound far outside its range becomes 1e-18 or 1e18, whose squares are within it."""
    size = abs(value)
    size = BEYOND.get(size, 1e-18 if 0.0 < size < 1e-37 else 1e18 if 1e37 < size < math.inf else size)
    return np.float32(math.copysign(size, value))


@register_pass(mutates_CFG=False, analysis_only=False)
class _SingleConstants(FunctionPass):
    """Makes a function's constants float32, so that float32 arguments stay what they are."""

    _name = "single_constants"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        for block in state.func_ir.blocks.values():
            for step in block.find_insts(ir.Assign):
                if isinstance(step.value, (ir.Const, ir.Global, ir.FreeVar)) and type(step.value.value) is float:
                    step.value = ir.Const(single(step.value.value), step.loc)
        return True


@functools.cache
def wide(side_by_side: int = SIDE_BY_SIDE, in_single: bool = False) -> type[CompilerBase]:
    """numba's usual pipeline, with the attributes on what it lowers and so many vectors side by side in its loops.

    `in_single`: constants are float32.
    """
    lower = type("_Lower", (_Lower,), {"side_by_side": side_by_side, "in_single": in_single})

    @register_pass(mutates_CFG=True, analysis_only=False)
    class Lowering(NativeLowering):
        _name = f"wide_native_lowering_{side_by_side}_{in_single}"

        @property
        def lowering_class(self) -> type[Lower]:
            return lower

    class Wide(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state)
            pipeline.passes = [(Lowering if step is NativeLowering else step, text) for step, text in pipeline.passes]
            if in_single:
                pipeline.add_pass_after(_SingleConstants, IRProcessing)
            pipeline.finalize()
            return [pipeline]

    return Wide
