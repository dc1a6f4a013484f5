"""Points summed up by the voxel that they lie in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

_FREE = np.int64(-1)
# Points whose voxels are reckoned together: a loop without branches runs in the processor's
# full width.
_RUN = 1024
# Places of the hash table for each voxel, at least: few searches then go on to a second.
_ROOM = 4


@njit(cache=True, nogil=True)
def _located(
    points: Any,
    span: tuple[int, int],
    centre: FloatArray,
    turn: FloatArray,
    size: float,
    most: int,
    bits: int,
    codes: IntArray,
    places: FloatArray,
) -> bool:
    """Write codes and places, (3, _RUN), of a span of points; return whether all have a code."""
    far, shift, across = 0.0, most + 1, 1.0 / size
    for j in range(span[0], span[1]):
        x = np.float64(points[j, 0]) - centre[0]
        y = np.float64(points[j, 1]) - centre[1]
        z = np.float64(points[j, 2]) - centre[2]
        u = x * turn[0, 0] + y * turn[0, 1] + z * turn[0, 2]
        v = x * turn[1, 0] + y * turn[1, 1] + z * turn[1, 2]
        w = x * turn[2, 0] + y * turn[2, 1] + z * turn[2, 2]
        k = j - span[0]
        places[0, k], places[1, k], places[2, k] = u, v, w
        u, v, w = np.floor(u * across + 0.5), np.floor(v * across + 0.5), np.floor(w * across + 0.5)
        far = max(far, abs(u), abs(v), abs(w))
        code = ((np.int64(u) + shift) << bits) | (np.int64(v) + shift)
        codes[k] = (code << bits) | (np.int64(w) + shift)
    return far <= most


@njit(cache=True, nogil=True)
def _home(code: Any, shift: int) -> Any:
    """Return where the search for a code begins."""
    # Fibonacci's multiplier spreads neighbouring cells; only its highest bits are mixed well.
    return np.int64((np.uint64(code) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(shift))


@njit(cache=True, nogil=True)
def _table(codes: IntArray, count: int) -> tuple[IntArray, IntArray, int]:
    """Return a hash table with room for twice as many codes: names, their slots, and its shift."""
    room, shift = 2, 63
    while room < 2 * _ROOM * max(count, _RUN):
        room, shift = 2 * room, shift - 1
    names, slots = np.full(room, _FREE), np.empty(room, np.int32)
    for k in range(count):
        at = _home(codes[k], shift)
        while names[at] != _FREE:
            at = (at + 1) & (room - 1)
        names[at], slots[at] = codes[k], k
    return names, slots, shift


@njit(cache=True, nogil=True)
def _widened(codes: IntArray, sums: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return codes and sums with twice the room."""
    count = len(codes)
    more, totals = np.empty(2 * count, np.int64), np.zeros((2 * count, 4))
    more[:count], totals[:count] = codes, sums
    return more, totals


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

    u = axes · (point − centre) / length, taken run by run: nothing of the cloud is copied.

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
    found, sums = np.empty(2 * _RUN, np.int64), np.zeros((2 * _RUN, 4))
    names, slots, shift = _table(found, 0)
    codes, places, turn = np.empty(_RUN, np.int64), np.empty((3, _RUN)), axes / length
    count, last, slot = 0, _FREE, 0
    for first in range(0, len(points), _RUN):
        span = first, min(len(points), first + _RUN)
        if not _located(points, span, centre, turn, size, most, bits, codes, places):
            return found[:0], sums[:0]
        if count + _RUN > len(found):
            found, sums = _widened(found, sums)
        if _ROOM * (count + _RUN) > len(names):
            names, slots, shift = _table(found, count)
        for k in range(span[1] - first):
            code = codes[k]
            if code != last:
                # Scans hold neighbours in a row: most points need no look into the table.
                at, last = _home(code, shift), code
                while names[at] != code:
                    if names[at] == _FREE:
                        names[at], slots[at], found[count] = code, count, code
                        count += 1
                        break
                    at = (at + 1) & (len(names) - 1)
                slot = slots[at]
            w = weights[first + k] if len(weights) else 1.0
            sums[slot, 0] += w * places[0, k]
            sums[slot, 1] += w * places[1, k]
            sums[slot, 2] += w * places[2, k]
            sums[slot, 3] += w
    return found[:count].copy(), sums[:count].copy()
