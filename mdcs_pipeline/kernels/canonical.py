"""A frame that moves with the cloud, so that results do not depend on where it lies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.moments import covariance_about, mean_offset, third_moments

FloatArray = NDArray[np.float64]


class CanonicalFrame(NamedTuple):
    """Centre, right-handed axes as rows, and length, all in input units.

    Parameters
    ----------
    centre : (3,) float64
    axes : (3, 3) float64
    length : float
    """

    centre: FloatArray
    axes: FloatArray
    length: float


def canonical_frame(points: NDArray[np.floating], weights: FloatArray | None) -> CanonicalFrame:
    """Return the frame of a weighted cloud's centroid, principal axes and size.

    The length is √(12 tr C) of the covariance C: the diagonal of the evenly filled box with
    the same second moments. Unlike the bounding box's it does not change under rotation and
    hardly with one outlier. Axes point to where the cloud is more spread out (third moments).

    Parameters
    ----------
    points : (N, 3) float
    weights : (N,) float64 or None
        Equal when absent.

    Returns
    -------
    CanonicalFrame
        The length is 0 when all points coincide.
    """
    return framed(points, weights)[0]


def framed(
    points: NDArray[np.floating[Any]], weights: FloatArray | None
) -> tuple[CanonicalFrame, float]:
    """Return `canonical_frame` and the size of the largest coordinate.

    The cloud is read in passes and never copied.
    """
    share = np.empty(0) if weights is None else weights
    # Two steps: a single mean of coordinates around 1e6 would lose what the rotation needs.
    origin = points[0].astype(np.float64)
    offset, largest = mean_offset(points, share)
    covariance = covariance_about(points, share, offset)
    if not np.isfinite(covariance).all():
        # Too large to square; the second value says how large.
        return CanonicalFrame(origin, np.eye(3), np.inf), largest
    values, vectors = np.linalg.eigh(covariance)
    axes = np.ascontiguousarray(vectors.T[::-1])
    spread = np.sqrt(max(float(values.max()), np.finfo(float).tiny))
    skew = third_moments(points, share, offset, axes, spread)
    axes = axes * np.where(skew < 0, -1.0, 1.0)[:, None]
    if np.linalg.det(axes) < 0:
        axes[np.argmin(np.abs(skew))] *= -1.0
    length = float(np.sqrt(12.0 * max(float(np.trace(covariance)), 0.0)))
    return CanonicalFrame(origin + offset, axes, length), largest
