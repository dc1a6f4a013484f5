"""Points summed up by the voxel that they lie in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

_FREE = np.int64(-1)


@njit(cache=True, nogil=True)
def _slot(table: IntArray, keys: IntArray, key: Any) -> Any:
    """Return where `key` is in a hash table of indices into `keys`, or where it would go."""
    mask = len(table) - 1
    # Fibonacci's multiplier spreads neighbouring cells; the high bits are the mixed ones.
    at = ((np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20)) & np.uint64(mask)
    place = np.int64(at)
    while table[place] != _FREE and keys[table[place]] != key:
        place = (place + 1) & mask
    return place


@njit(cache=True, nogil=True)
def _grown(table: IntArray, keys: IntArray, sums: FloatArray, count: int) -> Any:
    """Return table, keys and sums of twice the room."""
    wider = np.full(2 * len(table), _FREE)
    names, totals = np.empty(2 * len(keys), np.int64), np.zeros((2 * len(sums), 4))
    names[:count], totals[:count] = keys[:count], sums[:count]
    for k in range(count):
        wider[_slot(wider, names, names[k])] = k
    return wider, names, totals


@njit(cache=True, nogil=True)
def cell_sums(
    points: Any,
    weights: Any,
    centre: FloatArray,
    axes: FloatArray,
    length: float,
    size: float,
    most: int,
    bits: int,
) -> tuple[IntArray, FloatArray]:
    """Return the code of each occupied voxel, and the sums of w u and w over its points.

    u = axes · (point − centre) / length, taken point by point: nothing of the cloud is copied.

    Parameters
    ----------
    points : (N, 3) float32 or float64
    weights : (N,) float64
        Or empty: all are then 1.
    size : float
        Edge of a voxel, of u.
    most, bits : int
        Largest grid coordinate, and bits of a code for each.

    Returns
    -------
    codes : (V,) int64
        In no order. Empty if a grid coordinate is larger than `most`.
    sums : (V, 4) float64
    """
    keys, sums = np.empty(2048, np.int64), np.zeros((2048, 4))
    table = np.full(4096, _FREE)
    count, last, at = 0, _FREE, 0
    x, u = np.empty(3), np.empty(3)
    for j in range(len(points)):
        for a in range(3):
            x[a] = (np.float64(points[j, a]) - centre[a]) / length
        code = np.int64(0)
        for a in range(3):
            u[a] = x[0] * axes[a, 0] + x[1] * axes[a, 1] + x[2] * axes[a, 2]
            cell = np.floor(u[a] / size + 0.5)
            if abs(cell) > most:
                return keys[:0], sums[:0]
            code = (code << bits) | (np.int64(cell) + most + 1)
        if code != last:
            # Scans hold neighbours in a row: most points need no look into the table.
            place = _slot(table, keys, code)
            if table[place] == _FREE:
                if count == len(keys):
                    table, keys, sums = _grown(table, keys, sums, count)
                    place = _slot(table, keys, code)
                table[place], keys[count] = count, code
                count += 1
            at, last = table[place], code
        w = weights[j] if len(weights) else 1.0
        sums[at, 0] += w * u[0]
        sums[at, 1] += w * u[1]
        sums[at, 2] += w * u[2]
        sums[at, 3] += w
    return keys[:count].copy(), sums[:count].copy()
