"""The cloud around the ends of limbs: what a bridge may not lead through."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mdcs_pipeline.kernels.courses import smooth_way
from mdcs_pipeline.kernels.ends import End

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Shore(NamedTuple):
    """The cloud around the ends.

    Parameters
    ----------
    nodes : (m, 3) float64
    scale : (m,) float64
        Local radius.
    points : (n, 3) float64
    held : (m,) int64
        Points of each node.
    tree : cKDTree
        Of the points.
    """

    nodes: FloatArray
    scale: FloatArray
    points: FloatArray
    held: IntArray
    tree: cKDTree

    @classmethod
    def around(
        cls, nodes: FloatArray, scale: FloatArray, points: FloatArray, owner: IntArray
    ) -> Shore:
        """Return the cloud with the node of each point, (n,)."""
        held = np.bincount(owner, minlength=len(nodes))
        return cls(nodes, scale, points, held, cKDTree(points))

    def walled(self, a: End, b: End, crowd: float) -> bool:
        """Return whether the straight and the bent way between two ends both pierce the surface."""
        if not self.pierced_between(a, b, crowd):
            return False
        way = smooth_way(a.place, a.course.tangent, b.place, b.course.tangent)
        # What is farther than any end counts is not looked at: the scene may be large.
        around = self.within(way, 0.5 * max(a.radius, b.radius))
        distance, nearest = (np.asarray(found) for found in cKDTree(way).query(around))
        between = (nearest > 0) & (nearest < len(way) - 1)
        return any(self._crowded(distance[between], end, crowd) for end in (a, b))

    def pierced_between(self, a: End, b: End, crowd: float) -> bool:
        """Return whether the straight way leads through the surface, seen from either end."""
        return self.pierced(a, b.place, crowd) or self.pierced(b, a.place, crowd)

    def within(self, places: FloatArray, reach: float) -> FloatArray:
        """Return the points within reach of any of some places, (k, 3)."""
        near = self.tree.query_ball_point(places, reach)
        return self.points[np.unique(np.concatenate([*near, []]).astype(np.int64))]

    def _crowded(self, distance: FloatArray, end: End, crowd: float) -> bool:
        near = np.count_nonzero(distance < 0.5 * end.radius)
        return bool(near > crowd * self.held[end.node])

    def pierced(self, end: End, goal: FloatArray, crowd: float) -> bool:
        """Return whether the way from an end to `goal` leads through the surface.

        Both lie inside the shape. Only through holes does a straight way lead from one to the
        other without points around it.
        """
        way = goal - end.place
        length = float(np.linalg.norm(way))
        reach = max(0.5 * end.radius, 1e-3 * length)
        steps = np.linspace(0.0, 1.0, 2 + int(length / reach))
        # Between two steps a point within reach of the way is that far from one of them.
        around = self.within(end.place + np.outer(steps, way), 1.2 * reach)
        offset = around - end.place
        along = offset @ way / length
        between = (along > 0) & (along < length)
        across = np.linalg.norm(offset[between] - np.outer(along[between] / length, way), axis=1)
        return self._crowded(across, end, crowd)


def straightness(end: End, goal: FloatArray) -> float:
    """Return how straight ahead of an end `goal` lies; an end without direction looks anywhere."""
    gap = goal - end.place
    length = float(np.linalg.norm(gap))
    if length == 0.0 or not end.outward.any():
        return 0.7
    straight = float(end.outward @ gap) / length
    return max(straight, float(end.rimward @ gap) / length) if straight > -0.2 else straight
