"""Geodesic patches that grow until they close into a tube.

Patches are grown for many sources at once: a link is then one vector operation on all their
distances, and what a heap would order is set right by a few sweeps.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.ball import ball_around, local_graph
from mdcs_pipeline.kernels.compiled.boxes import box_order
from mdcs_pipeline.kernels.compiled.lanes import LANES, relax_links
from mdcs_pipeline.kernels.compiled.symmetric import middle_eigenvalue
from mdcs_pipeline.kernels.compiled.types import FloatArray, IntArray

# Points that are set right before the next are looked at. All sources lie within it, mostly:
# farther out ways lead outwards, and one visit is nearly enough.
_WINDOW = 2048
# A patch's moments: Σ m, Σ m x, y, z and Σ m xx, xy, xz, yy, yz, zz.
_MOMENTS = 10
_FAR = np.float32(1e30)
# Sources that grow their patches together lie within so much of the ball that holds them all:
# one around scattered sources would be the whole cloud.
_SPREAD = 0.3
#: Stands for the radius of a patch that has not closed within those that were tried.
WIDER = -1.0


@njit(cache=True, nogil=True)
def sweep_distances(
    links: tuple[IntArray, IntArray, NDArray[np.float32]], starts: IntArray
) -> NDArray[np.float32]:
    """Return the shortest ways from each of `starts` to all points, (k, LANES) float32.

    Points lie in the order of their distance from the middle of the sources, and most ways
    lead outwards: swept window by window, few points are visited more than twice. Ways are
    exact but for float32, whose last digit is a ten-thousandth of a link.
    """
    indptr, indices, lengths = links
    distance = np.full((len(indptr) - 1, LANES), _FAR)
    dirty = np.zeros(len(indptr) - 1, np.bool_)
    for k in range(len(starts)):
        if starts[k] >= 0:
            distance[starts[k], k] = 0.0
            dirty[starts[k]] = True
    n, first = len(dirty), 0
    ahead = True
    while first < n or dirty.any():
        # A way may lead back into the window before; what led farther is found at the end.
        low, high = (max(0, first - _WINDOW), min(n, first + _WINDOW)) if first < n else (0, n)
        found = True
        while found:
            found = False
            for k in range(high - low):
                v = low + k if ahead else high - 1 - k
                if not dirty[v]:
                    continue
                dirty[v] = False
                found = True
                relax_links(v, indptr[v], indptr[v + 1], indices, lengths, distance, dirty)
            ahead = not ahead
        first += _WINDOW
    return distance


@njit(cache=True, nogil=True, fastmath=True)
def _add(moments: FloatArray, to: FloatArray) -> None:
    for a in range(len(to)):
        to[a] += moments[a]


@njit(cache=True, nogil=True)
def ring_moments(
    distance: NDArray[np.float32], places: FloatArray, mass: FloatArray, radii: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return the moments of the points between each two radii, for every lane.

    Returns
    -------
    rings : (lanes, len(radii) + 1, 10) float64
        The last ring is what lies beyond all radii.
    counts : (lanes, len(radii) + 1) int64
        Points in each ring.
    """
    n, lanes = distance.shape
    rings = np.zeros((lanes, len(radii) + 1, _MOMENTS))
    counts = np.zeros((lanes, len(radii) + 1), np.int64)
    cells = 4096
    step = radii[-1] / cells
    # The first radius that a distance in each small cell, or by round-off in the one before, may
    # lie within.
    first = np.searchsorted(radii, np.maximum(np.arange(cells + 3) - 1, 0) * step)
    moments, within, per_cell = np.zeros(_MOMENTS), np.empty(lanes, np.int64), 1.0 / step
    for v in range(n):
        x, y, z, m = places[v, 0], places[v, 1], places[v, 2], mass[v]
        moments[0], moments[1], moments[2], moments[3] = m, m * x, m * y, m * z
        moments[4], moments[5], moments[6] = m * x * x, m * x * y, m * x * z
        moments[7], moments[8], moments[9] = m * y * y, m * y * z, m * z * z
        for lane in range(lanes):
            within[lane] = np.int64(min(distance[v, lane] * per_cell, float(cells + 2)))
        for lane in range(lanes):
            far = distance[v, lane]
            if far >= _FAR:
                continue
            at = first[within[lane]]
            while at < len(radii) and far > radii[at]:
                at += 1
            counts[lane, at] += 1
            # Written out: to hand over a slice takes longer than to add it.
            for a in range(_MOMENTS):
                rings[lane, at, a] += moments[a]
    return rings, counts


@njit(cache=True, nogil=True)
def closing_radius(
    rings: FloatArray,
    counts: IntArray,
    radii: FloatArray,
    closed: float,
    sure: float,
    final: bool,
    middle: FloatArray,
) -> tuple[float, float]:
    """Return √(2 λ2) and radius of the first ball that has closed, from one lane's rings.

    `middle` is filled with its centre of mass.

    A radius only counts where points lie beyond it. Balls wider than `sure` are not whole:
    the radius is then NaN. Where all are and none has closed, it is infinite; but where there
    are wider ones to try, which is not `final`, it is `WIDER`.
    """
    total = np.zeros(_MOMENTS)
    beyond = counts.sum()
    for at in range(len(radii)):
        _add(rings[at], total)
        beyond -= counts[at]
        if radii[at] > sure:
            return 0.0, np.nan
        if beyond == 0 and sure == np.inf:
            break
        variance = middle_eigenvalue(total)
        if variance <= closed * radii[at] ** 2:
            middle[:] = total[1:4] / total[0]
            return np.sqrt(2.0 * variance), radii[at]
    if not final and (beyond > 0 or sure < np.inf):
        return 0.0, WIDER
    if sure < np.inf:
        return 0.0, np.nan
    _add(rings[len(radii)], total)
    middle[:] = total[1:4] / total[0]
    return np.sqrt(2.0 * middle_eigenvalue(total)), np.inf


@njit(cache=True, nogil=True)
def closing_patches(
    indptr: IntArray,
    indices: IntArray,
    lengths: FloatArray,
    points: FloatArray,
    mass: FloatArray,
    sources: IntArray,
    radii: FloatArray,
    closed: float,
    final: bool = True,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return √(2 λ2) of each source's geodesic ball where it has closed, its radius and centre.

    A ball of radius s has closed at the first of `radii` with λ2 ≤ closed · s². Where it never
    does, the whole part's λ2 is taken and the radius is infinite; unless `final` is false, which
    says that wider ones will be tried: the radius is then `WIDER`.
    """
    scale = np.zeros(len(sources))
    reach = np.full(len(sources), np.nan)
    centre = np.zeros((len(sources), 3))
    place = np.full(len(points), -1)
    todo, wanted = np.arange(len(sources)), radii[-1] / (3.0 if final else 1.0)
    while len(todo) > 0:
        # What a ball was too small for waits for the next round, with others of its kind.
        order, widest = box_order(points[sources[todo]], LANES), wanted
        for start in range(0, len(todo), LANES):
            lanes = todo[order[start : start + LANES]]
            lanes = _near_middle(points, sources, lanes, _SPREAD * wanted)
            needed = _grow_together(
                indptr, indices, lengths, points, mass, sources, radii, closed, final, lanes,
                wanted, place, scale, reach, centre,
            )  # fmt: skip
            widest = max(widest, wanted)
            # Neighbours close at like sizes; a ball too small is grown in vain.
            wanted = max(0.8 * wanted, needed) if needed > 0.0 else wanted
        todo, wanted = todo[np.isnan(reach[todo])], (2.0 if final else 1.0) * widest
    return scale, reach, centre


@njit(cache=True, nogil=True)
def _near_middle(points: FloatArray, sources: IntArray, lanes: IntArray, away: float) -> IntArray:
    """Return the lanes whose sources are within `away` of the middle one."""
    middle = points[sources[lanes[_central(points, sources[lanes])]]]
    kept, count = np.empty_like(lanes), 0
    for lane in lanes:
        kept[count] = lane
        count += np.square(points[sources[lane]] - middle).sum() <= away * away
    return kept[:count]


@njit(cache=True, nogil=True)
def _central(points: FloatArray, some: IntArray) -> int:
    """Return which of some points is nearest to their mean."""
    mean = np.zeros(3)
    for i in some:
        mean += points[i] / len(some)
    best, found = np.inf, 0
    for k in range(len(some)):
        away = np.square(points[some[k]] - mean).sum()
        if away < best:
            best, found = away, k
    return found


@njit(cache=True, nogil=True)
def _grow_together(
    indptr: IntArray,
    indices: IntArray,
    lengths: FloatArray,
    points: FloatArray,
    mass: FloatArray,
    sources: IntArray,
    radii: FloatArray,
    closed: float,
    final: bool,
    lanes: IntArray,
    wanted: float,
    place: IntArray,
    scale: FloatArray,
    reach: FloatArray,
    middle: FloatArray,
) -> float:
    """Fill in `scale`, `reach` and `middle` of some lanes as far as a ball `wanted` wide tells.

    Returns
    -------
    float
        Radius of the ball that those which closed have needed, a little more; 0 for none.
    """
    centre = sources[lanes[_central(points, sources[lanes])]]
    ball, from_centre, whole = ball_around(indptr, indices, lengths, centre, wanted, place)
    links = local_graph(indptr, indices, lengths, ball, place)
    places, masses = points[ball] - points[centre], mass[ball]
    widest = 0.0
    for first in range(0, len(lanes), LANES):
        some = lanes[first : first + LANES]
        starts = place[sources[some]]
        distance = sweep_distances(links, starts)
        rings, counts = ring_moments(distance, places, masses, radii)
        for k in range(len(some)):
            # Others lie in another part, or out of reach of this ball.
            if starts[k] >= 0:
                sure = np.inf if whole else wanted - from_centre[starts[k]]
                found = closing_radius(
                    rings[k], counts[k], radii, closed, sure, final, middle[some[k]]
                )
                scale[some[k]], reach[some[k]] = found
                middle[some[k]] += points[centre]
                if 0.0 < found[1] < np.inf:
                    widest = max(widest, found[1] + from_centre[starts[k]])
                elif found[1] == WIDER:
                    widest = max(widest, (radii[-1] + from_centre[starts[k]]) / 1.2)
    for v in ball:
        place[v] = -1
    return 1.2 * widest
