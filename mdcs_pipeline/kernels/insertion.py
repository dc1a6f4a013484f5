"""Points inserted into the edges of a rough skeleton (section IV.D, Eq. 7)."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Refined(NamedTuple):
    """A graph with points inserted into its edges; the given nodes come first.

    Parameters
    ----------
    positions : (K, 3) float64
    values : (K, c) float64
        Interpolated values.
    edges : (E', 2) int64
    """

    positions: FloatArray
    values: FloatArray
    edges: IntArray


def inserted_counts(lengths: FloatArray, spacing: float | FloatArray) -> IntArray:
    """Return l with |e|/(l+1) ≤ spacing < |e|/l for every edge length (Eq. 7)."""
    return np.maximum(np.ceil(lengths / spacing * (1 - 1e-12)).astype(np.int64) - 1, 0)


def insert_points(
    positions: FloatArray, values: FloatArray, edges: IntArray, spacing: float | FloatArray
) -> Refined:
    """Cut every edge into equal parts no longer than `spacing`.

    Parameters
    ----------
    positions : (m, 3) float64
    values : (m, c) float64
        Interpolated linearly.
    edges : (E, 2) int64
    spacing : float or (E,) float64
        Of all edges, or of each; the length of the shortest edge in the text.

    Returns
    -------
    Refined
    """
    lengths = np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)
    counts = inserted_counts(lengths, spacing)
    places, levels = [positions], [values]
    pairs: list[tuple[int, int]] = []
    following = len(positions)
    for (i, j), count in zip(edges.tolist(), counts.tolist(), strict=True):
        share = np.arange(1, count + 1) / (count + 1)
        places.append(positions[i] + share[:, None] * (positions[j] - positions[i]))
        levels.append(values[i] + share[:, None] * (values[j] - values[i]))
        chain = [i, *range(following, following + count), j]
        pairs.extend(pairwise(chain))
        following += count
    cut = np.sort(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=1)
    return Refined(np.concatenate(places), np.concatenate(levels), cut)
