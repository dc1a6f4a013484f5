"""Which of some values would come where if they were sorted."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

#: Values up to which comparing all with all, which is foretold, is sooner done than halving.
FEW = 48
LANES = 8


@njit(cache=True, nogil=True)
def select(
    keys: FloatArray, first: int, last: int, middle: int, order: IntArray | None = None
) -> None:
    """Partition keys[first:last] so that `middle` is where sorting would put it (Hoare).

    `order`, where there is one, is turned about with the keys.
    """
    low, high = first, last - 1
    while low < high:
        pivot = keys[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while keys[i] < pivot:
                i += 1
            while keys[j] > pivot:
                j -= 1
            if i <= j:
                keys[i], keys[j] = keys[j], keys[i]
                if order is not None:
                    order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit(cache=True, nogil=True, inline="always")
def ranks_of(keys: FloatArray, count: int, ranks: IntArray) -> None:
    """Write the place that each of the first `count` keys has in their order.

    Of equal ones the first comes first. No branch depends on the keys. Both arrays must have
    room for `LANES` more: loops run in whole vectors.
    """
    wide = (count + LANES - 1) // LANES * LANES
    keys[count:wide] = np.inf
    ranks[:wide] = 0
    for j in range(count):
        one = keys[j]
        for k in range(wide):
            ranks[k] += (one < keys[k]) | ((one == keys[k]) & (j < k))


@njit(cache=True, nogil=True, inline="always")
def median_of(keys: FloatArray, count: int, ranks: IntArray) -> float:
    """Return the median of the first `count` keys, which are put out of order.

    Both arrays must have room for `LANES` more than there are keys, `ranks` for no more than
    `FEW` keys.
    """
    middle = count // 2
    if count > FEW:
        select(keys, 0, count, middle)
        upper = keys[middle]
        lower = upper if count % 2 == 1 else keys[:middle].max()
        return float((lower + upper) / 2.0)
    ranks_of(keys, count, ranks)
    lower = upper = 0.0
    for k in range(count):
        if ranks[k] == middle:
            upper = keys[k]
        if ranks[k] == (count - 1) // 2:
            lower = keys[k]
    return float((lower + upper) / 2.0)
