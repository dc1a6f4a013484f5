"""The state of a scene between frames."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.clouds import UnitFrame
from mdcs_pipeline.scene.graph import SceneGraph
from mdcs_pipeline.scene.voxels import VoxelMap
from mdcs_pipeline.skeleton import Skeleton

# Cells of the node grid, in voxels.
_CELL = 64.0


@dataclass
class World:
    """What exists once the first points have fixed the scale.

    Parameters
    ----------
    unit : UnitFrame
        Of the scene: absolute, and the same for all its frames.
    voxels : VoxelMap
    graph : SceneGraph
    """

    unit: UnitFrame
    voxels: VoxelMap
    graph: SceneGraph

    @classmethod
    def begin(cls, centre: NDArray[np.float64], length: float, size: float) -> World:
        """Return an empty world.

        Parameters
        ----------
        centre : (3,) float64
            Origin, in input units.
        length : float
            Input units per unit length.
        size : float
            Edge of a voxel in unit lengths.
        """
        unit = UnitFrame(centre, np.eye(3), length)
        return cls(unit, VoxelMap(size), SceneGraph(_CELL * size))

    def surface(self) -> NDArray[np.float64]:
        """Return the centroids of all voxels that are surface, (n, 3), in input units."""
        held = self.voxels.live[: self.voxels.used]
        return self.unit.from_unit(self.voxels.place[: self.voxels.used][held])


@dataclass
class Scene:
    """All that a streaming pipeline remembers from frame to frame.

    Parameters
    ----------
    world : World or None
        None before the first points.
    number : int
        Scenes that came before this one.
    frames : int
        Frames that were added to it.
    frame_id : str or None
        Of its frames; None before the first.
    stamp_ns : int
        Of the latest frame.
    changed : (k,) int64
        Slots of voxels that have changed and belong to no node's `waiting` yet; some of them
        may have vanished since.
    waiting : dict of (k,) int64
        Slots that await an update by the node that they lie at, −1 for those at none. Found by
        node, so that a frame looks only at what it has added to.
    overdue : set of int
        Nodes that were to be updated and were too much for one frame.
    vacated : set of int
        Nodes that have lost voxels since the last update.
    hits : deque of (frame, stamp_ns, slots)
        What each frame of a sliding window hit.
    drain : bool
        Whether the next update takes all that is pending, however little it is.
    """

    world: World | None = None
    number: int = 0
    frames: int = 0
    frame_id: str | None = None
    stamp_ns: int = -1
    changed: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    waiting: dict[int, IntArray] = field(default_factory=dict)
    overdue: set[int] = field(default_factory=set)
    vacated: set[int] = field(default_factory=set)
    hits: deque[tuple[int, int, IntArray]] = field(default_factory=deque)
    drain: bool = False

    def skeleton(self) -> Skeleton:
        """Return the whole skeleton as it stands, in input units; this reads all of the scene."""
        from mdcs_pipeline.scene.assemble import assemble

        return assemble(self)

    def begin_anew(self) -> None:
        """Forget all but the number of scenes."""
        fresh = Scene(number=self.number + 1)
        self.__dict__.update(fresh.__dict__)
