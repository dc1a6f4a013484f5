"""Fewer points where the surface is flat against them.

The patch of radius ρ around a point of a sheet has the standard deviations ρ/2 along it and, when
the sheet bends in a radius r like the side of a tube, ρ²/8r across. So s1²/2 s0 of the two
thinnest directions is r, known without a mesh or a graph. Noise, a second sheet near by and the
edge of a hole all make the patch thicker, and r smaller: what is in doubt keeps its points. The
median over neighbouring patches leaves out the bumps of what is thick, and the few patches of a
thin limb that hang together by chance with something flat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.grid import Grid, grid_of, scattered
from mdcs_pipeline.kernels.compiled.tangent import ANY, medians_alike, patch_planes
from mdcs_pipeline.kernels.voxels import Voxels
from mdcs_pipeline.kernels.workers import shared_out

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Radius of a patch in cells, and of the surroundings that agree on how it bends.
_PATCH = 2.0
# A patch with fewer points says nothing of its shape.
_LEAST = 8


def flat_groups(points: FloatArray, size: float, flat: float, enough: int) -> IntArray:
    """Return which points to make one: those of a cell where the surface hardly bends.

    The flattest cells come first.

    Parameters
    ----------
    points : (n, 3) float64
    size : float
        Edge of a cell.
    flat : float
        Radius of bend, in `size`, from which the points of a cell are made one.
    enough : int
        Groups that are left at least, where there are as many points.

    Returns
    -------
    (n,) int64
        Groups, numbered from 0 in the order of their first points.
    """
    if not len(points):
        return np.empty(0, np.int64)
    grid = grid_of(points, size)
    first = np.flatnonzero(np.diff(grid.keys, prepend=-1))
    held = np.diff(first, append=len(points))
    # One patch a cell is enough: neighbouring ones are nearly the same.
    bend = bend_radii(grid, _middle_ones(grid, first, held), _PATCH * size)
    flattest = np.argsort(-bend, kind="stable")
    left = len(points) - np.cumsum(held[flattest] - 1)
    joined = np.zeros(len(first), dtype=bool)
    joined[flattest] = (bend[flattest] >= flat * size) & (left >= enough)
    lead = np.minimum.reduceat(grid.order, first)
    stands = np.where(np.repeat(joined, held), np.repeat(lead, held), grid.order)
    return np.unique(scattered(grid, stands), return_inverse=True)[1].astype(np.int64)


def merged(points: FloatArray, weights: FloatArray, group: IntArray) -> Voxels:
    """Return the weighted mean of each group, and its weight.

    Parameters
    ----------
    points : (n, 3) float64
    weights : (n,) float64
    group : (n,) int64
        Numbered from 0.

    Returns
    -------
    Voxels
        In that order; what is alone keeps its place to the last bit.
    """
    first = points[np.unique(group, return_index=True)[1]]
    sums = np.bincount(group, weights).astype(np.float64)
    away = weights[:, None] * (points - first[group])
    means = [np.bincount(group, step) / sums for step in away.T]
    return Voxels(first + np.stack(means, axis=1), sums)


def _middle_ones(grid: Grid, first: IntArray, held: IntArray) -> IntArray:
    """Return the point of each cell that is nearest to the cell's centre, whatever their order."""
    inside = (grid.points - grid.low) / grid.size
    away = np.square(inside - np.floor(inside) - 0.5).sum(axis=1)
    nearest = np.flatnonzero(away == np.repeat(np.minimum.reduceat(away, first), held))
    # Of two that are as near, the first.
    return nearest[np.searchsorted(nearest, first)]


def bend_radii(grid: Grid, which: IntArray, reach: float) -> FloatArray:
    """Return the radius in which the surface bends around some points, in the median there.

    Parameters
    ----------
    grid : Grid
    which : (k,) int64
        In the grid's order.
    reach : float
        Radius of a patch, and of the surroundings whose median is taken.

    Returns
    -------
    (k,) float64
        Infinite where patches are flat to the last digit.
    """
    alike, wide = np.ones(len(grid.points)), np.full(len(grid.points), reach)
    spreads = shared_out(lambda some: patch_planes(grid, alike, wide, _LEAST, some), which)[2]
    across = 2.0 * spreads[:, 0]
    bend = np.full(len(which), np.inf)
    np.divide(spreads[:, 1] ** 2, across, out=bend, where=across > 0.0)
    return _median_around(grid.points[which], bend, reach)


def _median_around(places: FloatArray, values: FloatArray, reach: float) -> FloatArray:
    grid = grid_of(places, reach)
    facing, wide = np.zeros_like(places), np.full(len(places), reach)
    return scattered(grid, medians_alike(grid, facing, wide, values[grid.order], ANY))
