"""What a frame changed: the result of a streaming pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import IntArray, finite_array, set_fields
from mdcs_pipeline.header import Header


def _no_ids() -> IntArray:
    return np.empty(0, np.int64)


def _no_places() -> NDArray[np.float64]:
    return np.empty((0, 3))


def _no_pairs() -> IntArray:
    return np.empty((0, 2), np.int64)


@dataclass(frozen=True, eq=False)
class SceneChange:
    """The difference that one frame made to a scene's skeleton.

    A node that is named by none of these is what it was before, bit for bit. Applied in turn
    to an empty skeleton, the changes of all frames give the whole one.

    Parameters
    ----------
    header : Header
        Of the frame.
    added, moved, removed : (k,) int64
        Ids of nodes.
    positions : (added + moved, 3) float64
        Places of the added and then of the moved nodes, in input units.
    joined, parted : (k, 2) int64
        Edges that came and went, by the ids of their nodes. Those of removed nodes are named.
    scene : int
        Number of the scene, from 0; a new one begins empty.
    figures : dict
        Counts of voxels and nodes, and how much of them the frame made active.
    """

    header: Header
    added: IntArray = field(default_factory=_no_ids)
    moved: IntArray = field(default_factory=_no_ids)
    removed: IntArray = field(default_factory=_no_ids)
    positions: NDArray[np.float64] = field(default_factory=_no_places)
    joined: IntArray = field(default_factory=_no_pairs)
    parted: IntArray = field(default_factory=_no_pairs)
    scene: int = 0
    figures: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values: dict[str, object] = {
            name: finite_array(getattr(self, name), (None,), name, np.int64)
            for name in ("added", "moved", "removed")
        }
        rows = len(self.added) + len(self.moved)
        values["positions"] = finite_array(self.positions, (rows, 3), "positions")
        for name in ("joined", "parted"):
            values[name] = finite_array(getattr(self, name), (None, 2), name, np.int64)
        set_fields(self, **values)

    def __len__(self) -> int:
        return len(self.added) + len(self.moved) + len(self.removed)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        counts = {name: len(getattr(self, name)) for name in ("added", "moved", "removed")}
        return {**self.figures, **counts}
