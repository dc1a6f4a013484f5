"""The balls inside that touch the surface: patches are fitted, turned outwards, and filled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.grid import Grid, grid_of, scattered
from mdcs_pipeline.kernels.compiled.linking import between_groups
from mdcs_pipeline.kernels.compiled.stirred import near_any
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

    def rows(self, some: IntArray) -> Medial:
        """Return what is held of some of the points."""
        return Medial(*(held[some] for held in self))


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


class _Fitted(NamedTuple):
    """The surface as patches show it.

    Parameters
    ----------
    level : Grid
        Points, freed of noise.
    normals : (n, 3) float64
        Unit, outwards.
    widths : (n,) float64
        Radii of patches.
    shapeless : (n,) bool
        Where patches are lines, or do not bend: there is no inside.
    """

    level: Grid
    normals: FloatArray
    widths: FloatArray
    shapeless: BoolArray


def limb_balls(
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
    known = Remembered(known.asked[order], known.balls.rows(order))
    rank = scattered(grid, np.arange(len(order)))
    links = between_groups(graph.indptr, graph.indices, rank[stands], len(order))
    level, normals, widths, shapeless = _fitted(grid, mass[order], first, links, rule, known)
    which = np.flatnonzero(known.asked)
    most, ball = rule.widest * first, known.balls.radius.copy()
    ball[which] = _touching(level.points, normals, first, rule, which)
    ball[which] = _shared(which, medians_alike, grid, normals, reach, ball, _ALIKE)
    places = level.points - ball[:, None] * normals
    grown = widths > reach
    around = np.where(grown, _AROUND, 1.0) * widths
    trust = known.balls.trust.copy()
    # A ball far larger than its limb would make any scatter small.
    limb = np.minimum(ball, _WIDE * first)[which]
    scatter = _shared(which, scatters, grid, around, places) / limb
    trust[which] = np.clip((rule.unsure - scatter) / (rule.unsure - rule.sure), 0.0, 1.0)
    beyond = np.where(grown, _AROUND * np.maximum(first, widths), 0.0)
    trust[which] = _shared(which, medians_alike, grid, normals, beyond, trust, ANY)
    # A ball that nothing stops says nothing of a middle.
    trust[shapeless | (ball >= most * (1.0 - 1e-9))] = 0.0
    return Medial(*(scattered(grid, held) for held in (places, ball, trust, normals)))


def _fitted(
    grid: Grid,
    mass: FloatArray,
    first: FloatArray,
    links: tuple[IntArray, IntArray],
    rule: MedialRule,
    known: Remembered,
) -> _Fitted:
    """Return the surface from patches around all points that are asked for."""
    asked, before = known
    which, reach = np.flatnonzero(asked), rule.patch * first
    among = grid if len(which) == len(asked) else grid_of(grid.points[which], grid.size)
    fitted = level = _levelled(grid, asked, before)
    patches = raw, heights, spreads, widths, bend = _unfitted(reach)
    raw[~asked] = before.normals[~asked]
    changed, settled = asked, grid.points
    rough, typical = np.zeros(len(asked)), np.zeros(len(asked))
    for turn in range(rule.passes):
        _fit(fitted, mass, reach, first, which, changed, settled, patches)
        said = _outwards(raw, np.where(asked, bend, before.trust), links, which)
        side = np.where(asked & (said < 0.0), -1.0, 1.0)
        normals = raw * side[:, None]
        if not turn:
            lines = spreads[:, 1] < _LINE * widths
        # A disc of radius ρ on a tube has its mean ρ²/8r under its top, and spreads as much.
        sagging = widths**2 / (8.0 * first)
        moved = np.where(asked, sagging - heights * side, 0.0)
        level = fitted._replace(points=fitted.points + moved[:, None] * normals)
        was, rough = rough, np.sqrt(np.maximum(spreads[:, 0] ** 2 - sagging**2, 0.0)) / first
        _medians_among(among, which, reach, rough, (rough != was) | (turn == 0), typical)
        again = asked & (typical > rule.rough)
        if not again.any():
            break
        # What is smooth would only lose its shape.
        settled = fitted.points
        fitted = grid._replace(points=np.where(again[:, None], level.points, settled))
        changed = (fitted.points != settled).any(axis=1)
    return _Fitted(level, normals, widths, asked & (lines | (np.abs(said) < _TOLD)))


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
    before: FloatArray,
    patches: tuple[FloatArray, ...],
) -> None:
    """Fit the patches again of those that are asked for that any changed point is or was in."""
    normals, heights, spreads, widths, bend = patches
    which = asked[near_any(grid, np.maximum(widths, RING * radius), changed, asked, before)]
    made = shared_out(lambda some: patch_planes(grid, mass, reach, _LEAST, some), which)
    normals[which], heights[which], spreads[which], widths[which] = made
    (bend[which],) = shared_out(lambda some: (bends(grid, normals, radius, some),), which)


def _medians_among(
    among: Grid,
    which: IntArray,
    reach: FloatArray,
    values: FloatArray,
    changed: BoolArray,
    medians: FloatArray,
) -> None:
    """Write medians over the patches of the points that are asked for, among these alone.

    Only where a value in the patch has changed. `among` is their grid: that of all points where
    all are asked for.
    """
    rows = which if len(which) == len(values) else which[among.order]
    wide, each = reach[rows], np.arange(len(rows))
    some = each[near_any(among, wide, changed[rows], each, among.points)]
    facing = np.zeros((len(rows), 3))
    medians[rows[some]] = _shared(some, medians_alike, among, facing, wide, values[rows], ANY)


def _touching(
    points: FloatArray, normals: FloatArray, first: FloatArray, rule: MedialRule, which: IntArray
) -> FloatArray:
    """Return the radius of the largest ball inside at each of the points that are asked for."""
    # Smoothed points have left their cells; and balls are wider than patches.
    grid = grid_of(points, float(np.median(first)))
    order, asked, result = grid.order, np.zeros(len(points), dtype=bool), np.empty(len(points))
    asked[which] = True
    rows = np.flatnonzero(asked[order])
    given = normals[order], rule.widest * first[order], rule.apart, rule.pierced
    result[order[rows]] = _shared(rows, tangent_radii, grid, *given)
    return result[which]


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
