"""Mass of a point from the local sampling density (section V, Eq. before V.A)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.nearest import nearest

FloatArray = NDArray[np.float64]


def neighbour_radius(points: FloatArray, neighbours: int) -> FloatArray:
    """Return the distance of each point to its k-th neighbour, k = `neighbours`.

    Parameters
    ----------
    points : (n, 3) float64
    neighbours : int
        k; at most n − 1 are used.

    Returns
    -------
    (n,) float64
    """
    return nearest(points, neighbours).distance[:, -1]


def area_mass(radius: FloatArray, cap: float) -> FloatArray:
    """Return ϱ_j ∝ min(r_j, cap · median r)², sum 1.

    r² grows with the area that a point stands for, which levels uneven sampling. Without the
    cap a far outlier would be given the largest mass of all.

    Parameters
    ----------
    radius : (n,) float64
        r_j, in any unit.
    cap : float
        In medians of r.

    Returns
    -------
    (n,) float64
        All equal where the median is 0 (most points coincide).
    """
    median = float(np.median(radius))
    if median == 0.0:
        return np.full(len(radius), 1.0 / len(radius))
    # A point on top of others still stands for some surface: no mass may be 0 in transport.
    area = np.clip(radius, 0.05 * median, cap * median) ** 2
    return np.asarray(area / area.sum(), dtype=np.float64)
