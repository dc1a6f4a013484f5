"""A hash table from voxels to the slots of their arrays, by open addressing."""

from __future__ import annotations

import numpy as np
from numba import njit

from mdcs_pipeline.kernels.compiled.types import BoolArray, FloatArray, IntArray

# Grid coordinates are packed into one int64, 21 bits an axis.
_BITS = 21
_HALF = 1 << (_BITS - 1)
EMPTY = -1
# Edge of the block of voxels that are remembered while others look at them; no voxel is `_UNKNOWN`.
_KEPT, _UNKNOWN = 32, -2
#: Coordinates, in voxels, that a packed one can hold.
FARTHEST = _HALF - 2


@njit(cache=True, nogil=True, inline="always")
def pack(x: int, y: int, z: int) -> int:
    """Return one whole number for the voxel (x, y, z)."""
    return ((x + _HALF) << (2 * _BITS)) | ((y + _HALF) << _BITS) | (z + _HALF)


@njit(cache=True, nogil=True, inline="always")
def place_of(key: int, mask: int) -> np.int64:
    """Return where the search for a key begins (Fibonacci hashing, folded)."""
    mixed = key * np.int64(-7046029254386353131)
    place: np.int64 = (mixed ^ (mixed >> 29)) & mask
    return place


@njit(cache=True, nogil=True)
def find_key(keys: IntArray, slots: IntArray, key: int) -> int:
    """Return the slot of a key, or −1."""
    mask = len(keys) - 1
    at = place_of(key, mask)
    while keys[at] != EMPTY:
        if keys[at] == key:
            found: int = slots[at]
            return found
        at = (at + 1) & mask
    return EMPTY


@njit(cache=True, nogil=True)
def add_key(keys: IntArray, slots: IntArray, key: int, slot: int) -> None:
    """Put an absent key into a table that has room."""
    mask = len(keys) - 1
    at = place_of(key, mask)
    while keys[at] != EMPTY:
        at = (at + 1) & mask
    keys[at] = key
    slots[at] = slot


@njit(cache=True, nogil=True)
def add_keys(keys: IntArray, slots: IntArray, given: IntArray, where: IntArray) -> None:
    """Put absent keys with their slots into a table that has room."""
    for k in range(len(given)):
        add_key(keys, slots, given[k], where[k])


@njit(cache=True, nogil=True)
def remove_keys(keys: IntArray, slots: IntArray, given: IntArray) -> None:
    """Take keys out; what was moved past them is moved back, so that no graves are left."""
    mask = len(keys) - 1
    for k in range(len(given)):
        hole = place_of(given[k], mask)
        while keys[hole] != given[k]:
            hole = (hole + 1) & mask
        at = hole
        while True:
            at = (at + 1) & mask
            if keys[at] == EMPTY:
                break
            home = place_of(keys[at], mask)
            # Only what began its search at or before the hole may move into it.
            if ((at - home) & mask) >= ((at - hole) & mask):
                keys[hole] = keys[at]
                slots[hole] = slots[at]
                hole = at
        keys[hole] = EMPTY


@njit(cache=True, nogil=True)
def add_points(
    points: FloatArray,
    size: float,
    stamp: int,
    patience: int,
    keys: IntArray,
    slots: IntArray,
    free: IntArray,
    free_count: int,
    used: int,
    key: IntArray,
    count: IntArray,
    total: FloatArray,
    seen: IntArray,
    since: IntArray,
    live: BoolArray,
) -> tuple[IntArray, int, int, int]:
    """Add points to their voxels; return who was touched, how many are new, free_count, used.

    All from `key` on is by slot. A voxel that is not live `patience` frames after its first
    point begins anew: what noise hits now and then is no surface. New voxels take slots from
    the stack `free`, then from `used` on; there must be room for as many as there are points.
    """
    touched = np.empty(len(points), np.int64)
    t = 0
    new = 0
    for p in range(len(points)):
        x = int(np.floor(points[p, 0] / size))
        y = int(np.floor(points[p, 1] / size))
        z = int(np.floor(points[p, 2] / size))
        code = pack(x, y, z)
        slot = find_key(keys, slots, code)
        if slot == EMPTY:
            if free_count > 0:
                free_count -= 1
                slot = free[free_count]
            else:
                slot = used
                used += 1
            add_key(keys, slots, code, slot)
            key[slot] = code
            count[slot] = 0
            total[slot, :] = 0.0
            seen[slot] = -1
            since[slot] = stamp
            new += 1
        elif not live[slot] and stamp - since[slot] >= patience:
            count[slot] = 0
            total[slot, :] = 0.0
            since[slot] = stamp
        if seen[slot] != stamp:
            seen[slot] = stamp
            touched[t] = slot
            t += 1
        count[slot] += 1
        for a in range(3):
            total[slot, a] += points[p, a]
    return touched[:t].copy(), new, free_count, used


@njit(cache=True, nogil=True)
def cells_around(reach: int) -> IntArray:
    """Return the steps to all cells up to `reach` away along each axis, (k, 3), nearest first."""
    side = 2 * reach + 1
    steps, away = np.empty((side**3, 3), np.int64), np.empty(side**3, np.int64)
    for s in range(side**3):
        x, y, z = s // (side * side) - reach, s // side % side - reach, s % side - reach
        steps[s, 0], steps[s, 1], steps[s, 2] = x, y, z
        away[s] = x * x + y * y + z * z
    return steps[np.argsort(away, kind="mergesort")]


@njit(cache=True, nogil=True)
def nearest_owned(
    asked: IntArray,
    reach: int,
    size: float,
    keys: IntArray,
    slots: IntArray,
    place: FloatArray,
    owner: IntArray,
) -> IntArray:
    """Return the owner of the nearest owned voxel around each voxel, −1 where there is none.

    Voxels up to `reach` cells away along each axis are looked at, but not in cells that are
    farther than what was found; of equally near ones the smallest owner counts.
    """
    found, steps = np.full(len(asked), -1, np.int64), cells_around(reach)
    # Those asked for lie side by side and look at the same voxels, most of them empty.
    code_of, slot_of = np.full(_KEPT**3, _UNKNOWN), np.empty(_KEPT**3, np.int64)
    for at in range(len(asked)):
        px, py, pz = place[asked[at], 0], place[asked[at], 1], place[asked[at], 2]
        x, y, z = px / size, py / size, pz / size
        i0, j0, k0 = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        best, nearest = np.inf, -1
        for s in range(len(steps)):
            i, j, k = i0 + steps[s, 0], j0 + steps[s, 1], k0 + steps[s, 2]
            if best < np.inf and (_gap(x, i) + _gap(y, j) + _gap(z, k)) * size * size > best:
                continue
            code = pack(i, j, k)
            kept = ((i % _KEPT) * _KEPT + j % _KEPT) * _KEPT + k % _KEPT
            if code_of[kept] != code:
                held = find_key(keys, slots, code)
                code_of[kept] = code
                slot_of[kept] = held if held != EMPTY and owner[held] >= 0 else EMPTY
            other = slot_of[kept]
            if other == EMPTY:
                continue
            u, v, w = px - place[other, 0], py - place[other, 1], pz - place[other, 2]
            square = u * u + v * v + w * w
            if square < best or (square == best and owner[other] < nearest):
                best, nearest = square, owner[other]
        found[at] = nearest
    return found


@njit(cache=True, nogil=True, inline="always")
def _gap(at: float, cell: int) -> float:
    """Return the square of a coordinate's distance from a cell, and a little less, in cells."""
    away = max(cell - at, at - cell - 1.0, 0.0)
    return away * away * (1.0 - 1e-9)


@njit(cache=True, nogil=True)
def settle_places(
    touched: IntArray,
    least: int,
    shift: float,
    count: IntArray,
    total: FloatArray,
    place: FloatArray,
    live: BoolArray,
) -> tuple[IntArray, IntArray]:
    """Return the voxels that have become surface, and those whose centroid has moved.

    A voxel becomes surface with its `least`-th point. `place` is the centroid that others
    have been told of; it follows once the present one is more than `shift` away.
    """
    fresh = np.empty(len(touched), np.int64)
    moved = np.empty(len(touched), np.int64)
    f = m = 0
    for k in range(len(touched)):
        slot = touched[k]
        if count[slot] < least:
            continue
        square = 0.0
        for a in range(3):
            step = total[slot, a] / count[slot] - place[slot, a]
            square += step * step
        if live[slot] and square <= shift * shift:
            continue
        for a in range(3):
            place[slot, a] = total[slot, a] / count[slot]
        if live[slot]:
            moved[m] = slot
            m += 1
        else:
            live[slot] = True
            fresh[f] = slot
            f += 1
    return fresh[:f].copy(), moved[:m].copy()
