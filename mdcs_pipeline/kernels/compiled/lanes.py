"""One link relaxed for many sources at once, in vector instructions that are asked for.

Compilers find the vectors of long loops; rows of 32 numbers they take one by one.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic

from mdcs_pipeline.kernels.compiled.types import BoolArray

# Sources whose distances stand in one row: two or more vector registers.
LANES = 32
_WIDTH = 16


@intrinsic
def _shorten(
    typing_context: Any,  # noqa: ARG001
    distance: Any,  # noqa: ARG001
    source: Any,  # noqa: ARG001
    target: Any,  # noqa: ARG001
    length: Any,  # noqa: ARG001
) -> tuple[Any, Any]:
    # distance[target] = min(distance[target], distance[source] + length); whether that changed.
    signature = types.boolean(
        types.Array(types.float32, 2, "C"), types.int64, types.int64, types.float32
    )

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        vector = ir.VectorType(ir.FloatType(), _WIDTH)
        lanes = ir.Constant(ir.IntType(64), LANES)
        own, their = (builder.mul(place, lanes) for place in args[1:3])
        splat = ir.Constant(vector, ir.Undefined)
        for k in range(_WIDTH):
            splat = builder.insert_element(splat, args[3], ir.Constant(ir.IntType(32), k))
        shorter = ir.Constant(ir.IntType(1), 0)
        for first in range(0, LANES, _WIDTH):
            offset = ir.Constant(ir.IntType(64), first)
            pointers = [
                builder.bitcast(
                    builder.gep(array.data, [builder.add(row, offset)]), vector.as_pointer()
                )
                for row in (own, their)
            ]
            here, there = (builder.load(pointer, align=4) for pointer in pointers)
            way = builder.fadd(here, splat)
            less = builder.fcmp_ordered("<", way, there)
            builder.store(builder.select(less, way, there), pointers[1], align=4)
            mask = builder.bitcast(less, ir.IntType(_WIDTH))
            some = builder.icmp_unsigned("!=", mask, ir.Constant(mask.type, 0))
            shorter = builder.or_(shorter, some)
        return shorter

    return signature, generate


@njit(cache=True, nogil=True, inline="always")
def relax_links(
    v: int, first: int, last: int, indices: Any, lengths: Any, distance: Any, dirty: BoolArray
) -> None:
    """Lower the rows of the points that links first … last lead to from point v.

    Parameters
    ----------
    distance : (n, LANES) float32, C order
    dirty : (n,) bool
        Set where a row was lowered.
    """
    for e in range(first, last):
        # Written in any case: what gets shorter cannot be foretold.
        dirty[indices[e]] |= _shorten(distance, v, indices[e], lengths[e])  # type: ignore[call-arg]
