"""What a picture and a page of a skeleton share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray, points_array

# More points than this do not show more, and make pages of many megabytes.
MOST_POINTS = 50_000

CLOUD_COLOUR = "#c4c8cc"
LINE_COLOUR = "#c8102e"
NODE_COLOUR = "#1f3a93"


class Scene(NamedTuple):
    """Cloud and nodes about a common centre.

    Parameters
    ----------
    cloud : (M, 3) float64
        M <= `MOST_POINTS`.
    nodes : (K, 3) float64
    centre : (3,) float64
        Taken off both, in input units: colour cards count in float32.
    size : float
        Diagonal of the box about both, positive.
    """

    cloud: NDArray[np.float64]
    nodes: NDArray[np.float64]
    centre: NDArray[np.float64]
    size: float


def drawn_points(cloud: FloatArray | None) -> NDArray[np.float64]:
    """Return at most `MOST_POINTS` finite points of a cloud, always the same ones."""
    if cloud is None:
        return np.empty((0, 3))
    points = points_array(cloud, "cloud")
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) > MOST_POINTS:
        # By chance and not every n-th: scans are ordered, and every n-th shows as stripes.
        chosen = np.random.default_rng(0).choice(len(points), MOST_POINTS, replace=False)
        points = points[np.sort(chosen)]
    return points.astype(np.float64)


def make_scene(nodes: NDArray[np.float64], cloud: FloatArray | None) -> Scene:
    """Return what is to be drawn of (K, 3) nodes and an (N, 3) cloud, if there is one."""
    points = drawn_points(cloud)
    both = np.concatenate([points, nodes])
    if not len(both):
        return Scene(points, nodes, np.zeros(3), 1.0)
    low, high = both.min(axis=0), both.max(axis=0)
    centre = (low + high) / 2
    size = float(np.linalg.norm(high - low)) or 1.0
    return Scene(points - centre, nodes - centre, centre, size)


def view_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the picture's axes as rows: right, away from the viewer, up.

    By principal components, so that the first view shows the two longest extents and
    looks along the shortest. A shape that stands, along z, stays standing.

    Parameters
    ----------
    points : (N, 3) float64

    Returns
    -------
    (3, 3) float64
        Orthonormal, right-handed: pictures are never mirrored.
    """
    if len(points) < 2:
        return np.eye(3)
    _, axes = np.linalg.eigh(np.cov(points.T))
    longest, middle = axes[:, 2], axes[:, 1]
    upright = abs(longest[2]) > abs(middle[2])
    up, right = (longest, middle) if upright else (middle, longest)
    up = up if up[np.argmax(np.abs(up))] >= 0 else -up
    right = right if right[np.argmax(np.abs(right))] >= 0 else -right
    return np.array([right, np.cross(up, right), up])


def relative_mass(mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return masses between 0 and 1, the largest 1."""
    return mass / mass.max() if len(mass) and mass.max() > 0 else mass
