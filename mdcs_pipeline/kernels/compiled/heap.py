"""A binary min-heap on two arrays."""

from __future__ import annotations

from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray


@njit(cache=True, nogil=True, inline="always")
def heap_push(keys: FloatArray, values: IntArray, size: int, key: float, value: int) -> int:
    """Add (key, value) to a heap of `size` entries and return its new size."""
    i = size
    while i > 0 and keys[(i - 1) // 2] > key:
        keys[i] = keys[(i - 1) // 2]
        values[i] = values[(i - 1) // 2]
        i = (i - 1) // 2
    keys[i] = key
    values[i] = value
    return size + 1


@njit(cache=True, nogil=True, inline="always")
def heap_drop(keys: FloatArray, values: IntArray, size: int) -> int:
    """Remove the least entry, which is at 0, and return the new size."""
    size -= 1
    key, value = keys[size], values[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i] = keys[child]
        values[i] = values[child]
        i = child
    keys[i] = key
    values[i] = value
    return size
