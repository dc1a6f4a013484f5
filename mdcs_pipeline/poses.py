"""Where the sensor stood: rigid motions of clouds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray, finite_array
from mdcs_pipeline.errors import InputError


def rigid_pose(pose: Any) -> NDArray[np.float64]:
    """Return a (4, 4) pose as float64, if it is a rigid motion.

    Raises
    ------
    InputError
        If it has another shape, is not finite, or scales, shears or mirrors.
    """
    matrix: NDArray[np.float64] = finite_array(pose, (4, 4), "pose")
    turn = matrix[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
    if not (rigid and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])):
        raise InputError(
            "pose must be a rigid motion, (R t; 0 0 0 1) with a rotation R",
            received=np.round(matrix, 4).tolist(),
            remedy="it takes points of the sensor into the scene; scale them before",
        )
    return matrix


def posed(points: FloatArray, pose: NDArray[np.float64]) -> FloatArray:
    """Return (N, 3) points moved by a (4, 4) pose."""
    moved: FloatArray = points @ pose[:3, :3].T + pose[:3, 3]
    return moved
