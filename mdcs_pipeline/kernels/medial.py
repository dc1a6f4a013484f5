"""Medial places: the centre of the limb, seen from each point of its surface.

A point of a tube lies on a ball around the axis that touches the surface all around. That ball
is known from the point, its normal, and whatever other points it meets: half a shell shows it
as well as a whole one, and two shells that no surface joins show the same one. So mass that is
carried from the balls' centres, y − r n, instead of from the points y themselves, meets on the
axis: E‖x − y‖² over a ring is ‖x − c‖² + r², and c is all of it that depends on x.

Neighbours on one limb have their places on one line, its axis: where the places scatter about
their line they say nothing, whatever the reason (noise, a patch that reaches around its limb or
across a gap), and points stay where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.grid import Grid, covering, grid_of, near_any, scattered
from mdcs_pipeline.kernels.compiled.linking import between_groups, within_limbs
from mdcs_pipeline.kernels.compiled.tangent import (
    ANY,
    RING,
    agreed,
    bends,
    medians_alike,
    patch_planes,
    scatters,
)
from mdcs_pipeline.kernels.compiled.touching import tangent_radii
from mdcs_pipeline.kernels.workers import shared_out

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# A patch with fewer points has no normal to speak of.
_LEAST = 8
# A patch narrower than this against its length is a line.
_LINE = 0.1
# Less evidence than this of what is outside is none.
_TOLD = 0.01
# Rounds in which neighbours agree on what is outside; each reaches one link farther.
_ROUNDS = 60
# Weight of a point's own evidence beside its neighbours'.
_OWN = 0.03
# A patch that had to grow for its points is judged together with what is around it, this many
# times as wide: where limbs are that sparse, the places of one patch agree by chance.
_AROUND = 2.0
# Scatter is measured in the ball's radius, but in no more than so many first ones.
_WIDE = 3.0
# Trust from which a remembered ball tells where the surface is without its noise.
_SURE = 0.9
# Neighbours whose normals are farther apart than this cosine are on another side of the limb.
_ALIKE = 0.2


class MedialRule(NamedTuple):
    """How medial places are found.

    Parameters
    ----------
    coarse : float
        Points this near to another, in local radii, have its ball.
    patch : float
        Radius of the patch that a normal is fitted to, in local radii.
    apart : float
        Angle, in radians and seen from a ball's centre, from which points limit it.
    pierced : int
        Points that may lie inside a ball.
    widest : float
        Largest ball, in local radii.
    rough : float
        Spread of a patch along its normal beyond that of a tube, in local radii, from which it
        is fitted again.
    passes : int
        How often patches are fitted, each time to the points as the last fit smoothed them.
    sure, unsure : float
        Scatter of neighbours' places about a line, in their radius, up to which they count
        fully, and from which they do not count.
    """

    coarse: float = 0.15
    patch: float = 0.7
    apart: float = 1.4
    pierced: int = 3
    widest: float = 8.0
    rough: float = 0.08
    passes: int = 3
    sure: float = 0.15
    unsure: float = 0.35


class Medial(NamedTuple):
    """Where the middle is, and how far away.

    Parameters
    ----------
    places : (n, 3) float64
    radius : (n,) float64
    trust : (n,) float64
        1 where neighbours agree on their limb's axis, 0 where their places scatter.
    normals : (n, 3) float64
        Unit, outwards.
    """

    places: FloatArray
    radius: FloatArray
    trust: FloatArray
    normals: FloatArray


class Remembered(NamedTuple):
    """What was measured before of some of the points.

    Parameters
    ----------
    asked : (n,) bool
        Points to measure.
    balls : Medial
        Of the others.
    """

    asked: BoolArray
    balls: Medial


def medial_places(
    points: FloatArray,
    mass: FloatArray,
    graph: sparse.csr_array,
    radius: FloatArray,
    rule: MedialRule,
    known: Remembered | None = None,
) -> Medial:
    """Return each point's medial place, and its distance from the surface.

    Parameters
    ----------
    points : (n, 3) float64
    mass : (n,) float64
    graph : csr_array, (n, n)
        Neighbours along the surface; they agree on what is outside.
    radius : (n,) float64
        First estimate of the local radius, positive.
    rule : MedialRule
    known : Remembered, optional
        What need not be measured again; it stays, and is what its neighbours are judged by.

    Returns
    -------
    Medial
    """
    if known is None:
        known = _nothing_known(points)
    if not known.asked.any():
        return known.balls
    grid = grid_of(points, float(np.median(rule.coarse * radius)))
    chosen, stands = covering(grid, rule.coarse * radius[grid.order])
    # Which of the chosen stands for each point, in the cloud's order.
    stands = scattered(grid, stands)
    chosen = grid.order[chosen]
    held = np.bincount(stands, mass).astype(np.float64)
    # What stands for a point that is asked for is measured.
    asked = np.bincount(stands, known.asked) > 0
    before = Remembered(asked, _picked(known.balls, chosen))
    found = _balls(points[chosen], held, graph, stands, radius[chosen], rule, before)
    trust = found.trust[stands]
    new = known.asked
    return Medial(
        _where(new, points + trust[:, None] * (found.places[stands] - points), known.balls.places),
        _where(new, radius + trust * (found.radius[stands] - radius), known.balls.radius),
        _where(new, trust, known.balls.trust),
        _where(new, found.normals[stands], known.balls.normals),
    )


def _nothing_known(points: FloatArray) -> Remembered:
    n, none = len(points), np.zeros((len(points), 3))
    return Remembered(np.ones(n, dtype=bool), Medial(none, np.zeros(n), np.zeros(n), none))


def _picked(balls: Medial, rows: NDArray[np.int64]) -> Medial:
    return Medial(*(held[rows] for held in balls))


def _where(asked: BoolArray, found: FloatArray, known: FloatArray) -> FloatArray:
    return np.where(asked[:, None] if found.ndim > 1 else asked, found, known)


def _balls(
    points: FloatArray,
    mass: FloatArray,
    graph: sparse.csr_array,
    stands: IntArray,
    radius: FloatArray,
    rule: MedialRule,
    known: Remembered,
) -> Medial:
    """Return centre and radius of the ball inside that touches the surface at each point.

    The graph is of all the points that these stand for.
    """
    grid = grid_of(points, float(np.median(rule.patch * radius)))
    order = grid.order
    first, reach = radius[order], rule.patch * radius[order]
    asked, before = known.asked[order], _picked(known.balls, order)
    which = np.flatnonzero(asked)
    rank = scattered(grid, np.arange(len(order)))
    links = between_groups(graph.indptr, graph.indices, rank[stands], len(order))
    fitted = level = _levelled(grid, asked, before)
    patches = raw, heights, spreads, widths, bend = _unfitted(reach)
    raw[~asked] = before.normals[~asked]
    changed = asked
    for turn in range(rule.passes):
        _fit(fitted, mass[order], reach, first, which, changed, patches)
        said = _outwards(raw, np.where(asked, bend, before.trust), links, which)
        side = np.where(asked & (said < 0.0), -1.0, 1.0)
        normals = raw * side[:, None]
        if not turn:
            lines = spreads[:, 1] < _LINE * widths
        # A disc of radius ρ on a tube has its mean ρ²/8r under its top, and spreads as much.
        sagging = widths**2 / (8.0 * first)
        moved = np.where(asked, sagging - heights * side, 0.0)
        level = fitted._replace(points=fitted.points + moved[:, None] * normals)
        rough = np.sqrt(np.maximum(spreads[:, 0] ** 2 - sagging**2, 0.0)) / first
        again = asked & (_median_of_asked(grid, which, normals, reach, rough) > rule.rough)
        if not again.any():
            break
        # What is smooth would only lose its shape.
        settled = fitted.points
        fitted = grid._replace(points=np.where(again[:, None], level.points, settled))
        changed = (fitted.points != settled).any(axis=1)
    apart = float(np.sqrt(((level.points - grid.points) ** 2).sum(axis=1).max()))
    most = rule.widest * first
    ball = before.radius.copy()
    ball[which] = _shared(which, tangent_radii, level, normals, most, rule.apart, rule.pierced, apart)
    ball[which] = _shared(which, medians_alike, grid, normals, reach, ball, _ALIKE)
    places = level.points - ball[:, None] * normals
    grown = widths > reach
    around = np.where(grown, _AROUND, 1.0) * widths
    trust = before.trust.copy()
    # A ball far larger than its limb would make any scatter small.
    scatter = _shared(which, scatters, grid, around, places) / np.minimum(ball, _WIDE * first)[which]
    trust[which] = np.clip((rule.unsure - scatter) / (rule.unsure - rule.sure), 0.0, 1.0)
    beyond = np.where(grown, _AROUND * np.maximum(first, widths), 0.0)
    trust[which] = _shared(which, medians_alike, grid, normals, beyond, trust, ANY)
    # A ball that nothing stops says nothing of a middle.
    trust[ball >= most * (1.0 - 1e-9)] = 0.0
    # Nor has a line a normal, and what does not bend has no inside.
    trust[lines | (np.abs(said) < _TOLD)] = 0.0
    return Medial(
        scattered(grid, places),
        scattered(grid, ball),
        scattered(grid, trust),
        scattered(grid, normals),
    )


def _levelled(grid: Grid, asked: BoolArray, before: Medial) -> Grid:
    """Return the grid with the points whose balls are sure on these: there noise has gone."""
    sure = ~asked & (before.trust >= _SURE)
    if not sure.any():
        return grid
    on_balls = before.places + before.radius[:, None] * before.normals
    return grid._replace(points=np.where(sure[:, None], on_balls, grid.points))


def _unfitted(reach: FloatArray) -> tuple[FloatArray, ...]:
    """Return room for normals, heights, spreads, widths and bends of as many patches."""
    n = len(reach)
    return np.zeros((n, 3)), np.zeros(n), np.zeros((n, 2)), reach.copy(), np.zeros(n)


def _fit(
    grid: Grid,
    mass: FloatArray,
    reach: FloatArray,
    radius: FloatArray,
    asked: IntArray,
    changed: BoolArray,
    patches: tuple[FloatArray, ...],
) -> None:
    """Fit the patches again of those that are asked for that any changed point may be in."""
    normals, heights, spreads, widths, bend = patches
    which = asked[near_any(grid, np.maximum(widths, RING * radius), changed, asked)]
    made = shared_out(lambda some: patch_planes(grid, mass, reach, _LEAST, some), which)
    normals[which], heights[which], spreads[which], widths[which] = made
    (bend[which],) = shared_out(lambda some: (bends(grid, normals, radius, some),), which)


def _median_of_asked(
    grid: Grid, which: IntArray, normals: FloatArray, reach: FloatArray, values: FloatArray
) -> FloatArray:
    """Return medians over the patches of the points that are asked for, among these alone."""
    result = np.zeros(len(values))
    if len(which) == len(values):
        return _shared(which, medians_alike, grid, normals, reach, values, ANY)
    own = grid_of(grid.points[which], grid.size)
    rows = which[own.order]
    every = np.arange(len(rows))
    given = normals[rows], reach[rows], values[rows], ANY
    result[rows] = _shared(every, medians_alike, own, *given)
    return result


def _shared(
    which: IntArray, kernel: Callable[..., FloatArray], grid: Grid, *given: Any
) -> FloatArray:
    """Return what a kernel gives for some points of a grid, shared out to threads."""
    return shared_out(lambda some: (kernel(grid, *given, some),), which)[0]


def _outwards(
    normals: FloatArray, bend: FloatArray, links: tuple[IntArray, IntArray], which: IntArray
) -> FloatArray:
    """Return the evidence, in [−1, 1], that normals point outwards: negative where inwards.

    Each point's own evidence is the bend of the surface; neighbours whose normals are parallel
    lend each other theirs. Only those of `which` listen.
    """
    own = np.clip(3.0 * bend, -1.0, 1.0)
    return agreed(*links, normals, own, _OWN, _ROUNDS, which)


def without_gaps(
    graph: sparse.csr_array, points: FloatArray, found: Medial, gap: float
) -> sparse.csr_array:
    """Return the graph without links through the air between two limbs.

    Along a limb two neighbours' medial places are as far apart as they are themselves; across a
    gap each has its own on the far side.

    Parameters
    ----------
    graph : csr_array, (n, n)
    points : (n, 3) float64
    found : Medial
    gap : float
        How much farther apart medial places may be than their points, in the smaller radius.

    Returns
    -------
    csr_array, (n, n)
    """
    kept, rows = within_limbs(
        graph.indptr, graph.indices, points, found.places, found.radius, found.trust, gap
    )
    return sparse.csr_array((graph.data[kept], graph.indices[kept], rows), graph.shape)
