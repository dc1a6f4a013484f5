"""The voxel map: what has been seen of a scene, in cubes of one absolute size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray, IntArray
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.kernels.compiled.hashing import (
    EMPTY,
    FARTHEST,
    add_keys,
    add_points,
    nearest_owned,
    remove_keys,
    settle_places,
)

NOBODY = -1
_FIRST = 1024

#: What is kept of each voxel: name, type, shape without the first axis, value of a free one.
_COLUMNS: dict[str, tuple[type, tuple[int, ...], Any]] = {
    "key": (np.int64, (), EMPTY),
    "count": (np.int64, (), 0),
    "total": (np.float64, (3,), 0.0),
    "place": (np.float64, (3,), 0.0),
    "seen": (np.int64, (), -1),
    "since": (np.int64, (), -1),
    "live": (np.bool_, (), False),
    "pending": (np.bool_, (), False),
    "owner": (np.int64, (), NOBODY),
    "radius": (np.float64, (), 0.0),
    "middle": (np.float64, (3,), 0.0),
    "trust": (np.float32, (), 0.0),
    "normal": (np.float32, (3,), 0.0),
}


class VoxelMap:
    """Voxels in slots that stay theirs for as long as they are held.

    Parameters
    ----------
    size : float
        Edge of a voxel, in unit lengths.

    Attributes
    ----------
    key : (capacity,) int64
        Packed grid coordinates.
    count : (capacity,) int64
        Points that fell into the voxel.
    total : (capacity, 3) float64
        Their sum.
    place : (capacity, 3) float64
        Their centroid, as last told.
    seen : (capacity,) int64
        Number of the frame that last hit the voxel.
    since : (capacity,) int64
        Number of the frame from which on its points are counted.
    live : (capacity,) bool
        Hit often enough to be surface.
    pending : (capacity,) bool
        Changed since the nodes last took account of it.
    owner : (capacity,) int64
        Id of the node that it gives most of its mass to, −1 for none yet.
    radius : (capacity,) float64
        Local thickness that it was last transported with, 0 where there is none yet.
    middle : (capacity, 3) float64
        Where its mass was carried from then: the middle of its limb.
    trust : (capacity,) float32
        How far that is believed, in [0, 1].
    normal : (capacity, 3) float32
        Where the outside is, of length 1; 0 where it was not measured yet.
    """

    key: IntArray
    count: IntArray
    total: NDArray[np.float64]
    place: NDArray[np.float64]
    seen: IntArray
    since: IntArray
    live: NDArray[np.bool_]
    pending: NDArray[np.bool_]
    owner: IntArray
    radius: NDArray[np.float64]
    middle: NDArray[np.float64]
    trust: NDArray[np.float32]
    normal: NDArray[np.float32]

    def __init__(self, size: float) -> None:
        self.size = size
        self.used = 0
        self.held = 0
        self._free = np.empty(_FIRST, np.int64)
        self._free_count = 0
        self._keys = np.full(4 * _FIRST, EMPTY, np.int64)
        self._slots = np.zeros(4 * _FIRST, np.int64)
        for name, (kind, shape, empty) in _COLUMNS.items():
            setattr(self, name, np.full((_FIRST, *shape), empty, kind))

    def __len__(self) -> int:
        return self.held

    def add(
        self, points: FloatArray, frame: int, least: int, patience: int, shift: float
    ) -> tuple[IntArray, IntArray, IntArray]:
        """Add the points of a frame.

        Parameters
        ----------
        points : (N, 3) float64
            In unit lengths.
        frame : int
            Number of the frame.
        least : int
            Points from which a voxel counts as surface.
        patience : int
            Frames within which they must come.
        shift : float
            Distance, in voxels, from which a moved centroid counts as a change.

        Returns
        -------
        touched, fresh, moved : (k,) int64
            Slots that were hit, that became surface, and whose centroid has moved; of the
            last two those that were not pending already.

        Raises
        ------
        InputError
            If a point lies farther from the scene's origin than the map reaches.
        """
        self.check_reach(points)
        self._reserve(len(points))
        rows = np.ascontiguousarray(points, dtype=np.float64)
        touched, new, self._free_count, self.used = add_points(
            rows, self.size, frame, patience, self._keys, self._slots, self._free, self._free_count,
            self.used, self.key, self.count, self.total, self.seen,
            self.since, self.live,
        )  # fmt: skip
        self.held += new
        fresh, moved = settle_places(
            touched, least, shift * self.size, self.count, self.total, self.place, self.live
        )
        fresh, moved = fresh[~self.pending[fresh]], moved[~self.pending[moved]]
        self.pending[fresh] = True
        self.pending[moved] = True
        return touched, fresh, moved

    def check_reach(self, points: FloatArray) -> None:
        """Raise an `InputError` if a point lies farther away than the map reaches."""
        far = float(np.abs(points).max(initial=0.0))
        if far >= FARTHEST * self.size:
            raise InputError(
                "points lie beyond the reach of the scene's map",
                received=f"{far / self.size:.3g} voxels from its origin",
                remedy=f"at most {FARTHEST}: begin a new scene there, or take larger voxels",
            )

    def empty(self) -> None:
        """Take all points out, but keep the voxels and what is known of them."""
        self.count[: self.used] = 0
        self.total[: self.used] = 0.0

    def drop(self, slots: IntArray) -> None:
        """Forget voxels; their slots are used again."""
        if not len(slots):
            return
        remove_keys(self._keys, self._slots, self.key[slots])
        for name, (_, _, empty) in _COLUMNS.items():
            getattr(self, name)[slots] = empty
        need = self._free_count + len(slots)
        if need > len(self._free):
            self._free = _grown(self._free, 2 * need, 0)
        self._free[self._free_count : need] = slots
        self._free_count = need
        self.held -= len(slots)

    def nearest_owner(self, slots: IntArray, reach: int) -> IntArray:
        """Return the owner of the nearest owned voxel within `reach` cells, −1 for none."""
        return nearest_owned(
            slots, reach, self.size, self._keys, self._slots, self.place, self.owner
        )

    def _reserve(self, more: int) -> None:
        need = self.used + more
        if need > len(self.key):
            capacity = max(need, 2 * len(self.key))
            for name, (_, _, empty) in _COLUMNS.items():
                setattr(self, name, _grown(getattr(self, name), capacity, empty))
        if 2 * (self.held + more) > len(self._keys):
            self._rehash(4 * (self.held + more))

    def _rehash(self, least: int) -> None:
        size = 1 << int(np.ceil(np.log2(least)))
        self._keys = np.full(size, EMPTY, np.int64)
        self._slots = np.zeros(size, np.int64)
        filled = np.flatnonzero(self.key[: self.used] != EMPTY)
        add_keys(self._keys, self._slots, self.key[filled], filled)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all that the map holds, as plain arrays."""
        held = {name: getattr(self, name)[: self.used] for name in _COLUMNS}
        return {**held, "free": self._free[: self._free_count]}

    @classmethod
    def from_arrays(cls, size: float, arrays: dict[str, NDArray[Any]]) -> VoxelMap:
        """Return the map that `arrays` came from; further frames change both alike."""
        made = cls(size)
        used = len(arrays["key"])
        made._reserve(used)
        for name in _COLUMNS:
            getattr(made, name)[:used] = arrays[name]
        made.used = used
        made._free = arrays["free"].astype(np.int64)
        made._free_count = len(made._free)
        made.held = used - made._free_count
        made._rehash(max(4 * made.held, 4 * _FIRST))
        return made


def _grown(array: NDArray[Any], capacity: int, empty: Any) -> NDArray[Any]:
    larger = np.full((capacity, *array.shape[1:]), empty, array.dtype)
    larger[: len(array)] = array
    return larger
