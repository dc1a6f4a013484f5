"""Which nodes are skeletal: their points' mass goes to a line-like structure (IV.B)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class LineRule(NamedTuple):
    """Thresholds of the line-like test (section IV.B).

    Parameters
    ----------
    two_share : float
        A point is line-like when its two largest shares together exceed this.
    cosine : float
        Or when the angle at the first node has at most this cosine.
    majority : float
        A node is skeletal when this share of its major points is line-like.
    """

    two_share: float = 0.99
    cosine: float = -0.9
    majority: float = 0.9


def line_like(nodes: FloatArray, top: IntArray, shares: FloatArray, rule: LineRule) -> BoolArray:
    """Return, for every point, whether its mass goes to a line-like structure.

    Parameters
    ----------
    nodes : (m, 3) float64
    top : (n, 3) int64
        The nodes with the largest shares, −1 where there are fewer.
    shares : (n, 3) float64
    rule : LineRule

    Returns
    -------
    (n,) bool
    """
    two = (shares[:, 0] + shares[:, 1] > rule.two_share) | (top[:, 2] < 0)
    first = nodes[top[:, 0]]
    a, b = nodes[top[:, 1]] - first, nodes[top[:, 2]] - first
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    straight = np.einsum("nd,nd->n", a, b) <= rule.cosine * lengths
    return np.asarray(two | (straight & (lengths > 0)), dtype=np.bool_)


def skeletal_nodes(count: int, major: IntArray, lines: BoolArray, majority: float) -> BoolArray:
    """Return the nodes of which at least `majority` of the major points are line-like.

    A node that is no point's first choice carries nothing to judge by: it is not skeletal.

    Parameters
    ----------
    count : int
        m.
    major : (n,) int64
        Node with each point's largest share.
    lines : (n,) bool
    majority : float

    Returns
    -------
    (m,) bool
    """
    named = np.bincount(major, minlength=count)
    good = np.bincount(major[lines], minlength=count)
    return np.asarray((named > 0) & (good >= majority * named), dtype=np.bool_)
