"""Frames of a stream: points with their time, their frame, and where the sensor stood."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray


class Frame(NamedTuple):
    """One cloud of a stream.

    Attributes
    ----------
    stamp_ns : int
        Time of measurement in nanoseconds.
    frame_id : str
        Coordinate frame of the points.
    points : (N, 3) float32 or float64
        As measured: N may be 0, and NaN among them.
    pose : (4, 4) float64 or None
        Takes the points, as columns (x, y, z, 1), into the frame of the scene. None where
        they lie in it already.
    """

    stamp_ns: int
    frame_id: str
    points: FloatArray
    pose: NDArray[np.float64] | None = None
