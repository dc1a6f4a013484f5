"""Anderson acceleration of a fixed-point iteration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.kernels.compiled.mixing import mixed_step

FloatArray = NDArray[np.float64]


class AndersonMixer:
    """Extrapolates z ← G(z) from the last few steps (type II, weighted least squares).

    Parameters
    ----------
    weights : (m,) float64
        Weights of the residual's components in the least squares.
    depth : int
        Steps that are remembered.
    clip : float
        Largest change of a component in one step.
    """

    def __init__(self, weights: FloatArray, depth: int, clip: float) -> None:
        self._root = np.sqrt(weights)
        self._clip = clip
        self._history = np.empty((2, depth + 1, len(weights)))
        self._normal = np.zeros((depth, depth))
        self._held = 0

    def clear(self) -> None:
        """Forget all steps, so that the next one is plain."""
        self._held = 0

    def step(self, point: FloatArray, residual: FloatArray) -> FloatArray:
        """Return the next point after `point`, where G(z) − z is `residual`."""
        moved = point.copy()
        memory = (*self._history, self._normal, self._held)
        self._held = mixed_step(moved, residual, self._root, self._clip, *memory)
        return moved
