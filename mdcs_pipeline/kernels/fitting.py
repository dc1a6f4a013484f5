"""The surface as patches show it: normals that point outwards, points freed of noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.grid import Grid, grid_of
from mdcs_pipeline.kernels.compiled.stirred import near_any
from mdcs_pipeline.kernels.compiled.tangent import (
    ANY,
    RING,
    agreed,
    bends,
    medians_alike,
    patch_planes,
)
from mdcs_pipeline.kernels.places import Medial, MedialRule, Remembered
from mdcs_pipeline.kernels.workers import per_point, shared_out

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
# Trust from which a remembered ball tells where the surface is without its noise.
_SURE = 0.9


class Fitted(NamedTuple):
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


def fitted_surface(
    grid: Grid,
    mass: FloatArray,
    first: FloatArray,
    links: tuple[IntArray, IntArray],
    rule: MedialRule,
    known: Remembered,
) -> Fitted:
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
    return Fitted(level, normals, widths, asked & (lines | (np.abs(said) < _TOLD)))


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
    bend[which] = per_point(which, bends, grid, normals, radius)


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
    medians[rows[some]] = per_point(some, medians_alike, among, facing, wide, values[rows], ANY)


def _outwards(
    normals: FloatArray, bend: FloatArray, links: tuple[IntArray, IntArray], which: IntArray
) -> FloatArray:
    """Return the evidence, in [−1, 1], that normals point outwards: negative where inwards.

    Each point's own evidence is the bend of the surface; neighbours whose normals are parallel
    lend each other theirs. Only those of `which` listen.
    """
    own = np.clip(3.0 * bend, -1.0, 1.0)
    return agreed(*links, normals, own, _OWN, _ROUNDS, which)
