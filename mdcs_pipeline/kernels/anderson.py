"""Anderson acceleration of a fixed-point iteration, with a safeguard."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

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
        self._points: deque[FloatArray] = deque(maxlen=depth + 1)
        self._residuals: deque[FloatArray] = deque(maxlen=depth + 1)

    def clear(self) -> None:
        """Forget all steps, so that the next one is plain."""
        self._points.clear()
        self._residuals.clear()

    def step(self, point: FloatArray, residual: FloatArray) -> FloatArray:
        """Return the next point after `point`, where G(z) − z is `residual`."""
        self._points.append(point)
        self._residuals.append(residual)
        plain = point + residual
        if len(self._points) < 2:
            return plain
        moves = np.diff(np.array(self._points), axis=0)
        turns = np.diff(np.array(self._residuals), axis=0)
        scaled = turns * self._root
        # Tikhonov term: the normal matrix turns singular as the iteration converges.
        normal = scaled @ scaled.T
        normal.flat[:: len(normal) + 1] += 1e-10 * np.trace(normal) + 1e-300
        gamma = np.linalg.solve(normal, scaled @ (residual * self._root))
        mixed = plain - gamma @ (moves + turns)
        return point + np.clip(mixed - point, -self._clip, self._clip)
