"""The balls inside that touch the surface: it is fitted, turned outwards, and filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.compiled.grid import grid_of, scattered
from mdcs_pipeline.kernels.compiled.linking import between_groups
from mdcs_pipeline.kernels.compiled.tangent import ANY, medians_alike, scatters
from mdcs_pipeline.kernels.compiled.touching import tangent_radii
from mdcs_pipeline.kernels.fitting import fitted_surface
from mdcs_pipeline.kernels.places import Medial, MedialRule, Remembered
from mdcs_pipeline.kernels.workers import per_point

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A patch that had to grow for its points is judged together with what is around it, this many
# times as wide: where limbs are that sparse, the places of one patch agree by chance.
_AROUND = 2.0
# Scatter is measured in the ball's radius, but in no more than so many first ones.
_WIDE = 3.0
# Neighbours whose normals are farther apart than this cosine are on another side of the limb.
_ALIKE = 0.2


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
    level, normals, widths, shapeless = fitted_surface(grid, mass[order], first, links, rule, known)
    which = np.flatnonzero(known.asked)
    most, ball = rule.widest * first, known.balls.radius.copy()
    ball[which] = _touching(level.points, normals, first, rule, which)
    ball[which] = per_point(which, medians_alike, grid, normals, reach, ball, _ALIKE)
    places = level.points - ball[:, None] * normals
    grown = widths > reach
    stopped = ball < most * (1.0 - 1e-9)
    # A few places agree by chance, on a ball in the air between twigs; so the larger a ball is
    # beside its limb as the surface shows it, the farther around must agree.
    seen = np.where(stopped, np.maximum(widths, rule.patch * (ball - first)), widths)
    around = np.where(grown, _AROUND, 1.0) * seen
    trust = known.balls.trust.copy()
    # A ball far larger than its limb would make any scatter small.
    limb = np.minimum(ball, _WIDE * first)[which]
    scatter = per_point(which, scatters, grid, around, places) / limb
    trust[which] = np.clip((rule.unsure - scatter) / (rule.unsure - rule.sure), 0.0, 1.0)
    beyond = np.where(grown, _AROUND * np.maximum(first, widths), 0.0)
    trust[which] = per_point(which, medians_alike, grid, normals, beyond, trust, ANY)
    # A ball that nothing stops says nothing of a middle.
    trust[shapeless | ~stopped] = 0.0
    return Medial(*(scattered(grid, held) for held in (places, ball, trust, normals)))


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
    result[order[rows]] = per_point(rows, tangent_radii, grid, *given)
    return result[which]
