"""What is known of the middle of a limb: where it is, how it is found, what was measured before."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class MedialRule(NamedTuple):
    """How medial places are found.

    Parameters
    ----------
    coarse : float
        Points this near to another, in local radii, have its ball.
    patch : float
        Radius of the patch that a normal is fitted to, in local radii.
    apart : float
        Angle, in radians and seen from a ball's centre, from which points limit it.
    pierced : int
        Points that may lie inside a ball.
    widest : float
        Largest ball, in local radii.
    rough : float
        Spread of a patch along its normal beyond that of a tube, in local radii, from which it
        is fitted again.
    passes : int
        How often patches are fitted, each time to the points as the last fit smoothed them.
    sure, unsure : float
        Scatter of neighbours' places about a line, in their radius, up to which they count
        fully, and from which they do not count.
    """

    coarse: float = 0.15
    patch: float = 0.7
    apart: float = 1.4
    pierced: int = 3
    widest: float = 8.0
    rough: float = 0.08
    passes: int = 3
    sure: float = 0.15
    unsure: float = 0.35


class Medial(NamedTuple):
    """Where the middle is, and how far away.

    Parameters
    ----------
    places : (n, 3) float64
    radius : (n,) float64
    trust : (n,) float64
        1 where neighbours agree on their limb's axis, 0 where their places scatter.
    normals : (n, 3) float64
        Unit, outwards.
    """

    places: FloatArray
    radius: FloatArray
    trust: FloatArray
    normals: FloatArray

    def rows(self, some: IntArray) -> Medial:
        """Return what is held of some of the points."""
        return Medial(*(held[some] for held in self))


class Remembered(NamedTuple):
    """What was measured before of some of the points.

    Parameters
    ----------
    asked : (n,) bool
        Points to measure.
    balls : Medial
        Of the others.
    """

    asked: BoolArray
    balls: Medial
