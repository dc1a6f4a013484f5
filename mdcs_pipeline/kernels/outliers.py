"""Points that belong to no surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.nearest import nearest

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def lonely_points(
    points: FloatArray, neighbours: int, against_near: float, against_all: float
) -> BoolArray:
    """Return the points that lie far from others, judged by those around them and by all.

    Parameters
    ----------
    points : (n, 3) float64
    neighbours : int
        The radius of a point is the distance to this neighbour.
    against_near : float
        Largest radius in medians of its neighbours' radii.
    against_all : float
        Largest radius in medians of all radii.

    Returns
    -------
    (n,) bool
    """
    found = nearest(points, neighbours)
    radius = found.distance[:, -1]
    near = np.median(radius[found.indices], axis=1)
    return np.asarray(
        (radius > against_near * near) | (radius > against_all * np.median(radius)), dtype=np.bool_
    )
