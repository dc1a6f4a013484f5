"""Poses over time, as a bag's odometry gives them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mdcs_pipeline.errors import InputError

FloatArray = NDArray[np.float64]


class PoseTrack:
    """Poses by their stamps.

    Parameters
    ----------
    stamps_ns : sequence of int
        In any order; of equal ones the last counts.
    positions : (P, 3) array-like
    quaternions : (P, 4) array-like
        x, y, z, w.

    Raises
    ------
    InputError
        If a number is not finite, or a quaternion is no rotation.
    """

    def __init__(
        self, stamps_ns: Sequence[int], positions: ArrayLike, quaternions: ArrayLike
    ) -> None:
        places = np.asarray(positions, np.float64).reshape(-1, 3)
        turns = np.asarray(quaternions, np.float64).reshape(-1, 4)
        check_poses(places, turns)
        # From the back, so that unique's first is the last given.
        stamps = np.asarray(stamps_ns, np.int64)[::-1]
        self._stamps, chosen = np.unique(stamps, return_index=True)
        self._places, self._turns = places[::-1][chosen], turns[::-1][chosen]

    def __len__(self) -> int:
        return len(self._stamps)

    def matrices(self, chosen: Sequence[int] | None = None) -> list[FloatArray]:
        """Return all (4, 4) poses in the order of their stamps, or those of the given numbers."""
        from scipy.spatial.transform import Rotation

        held = list(range(len(self)) if chosen is None else chosen)
        if not held:
            return []
        return _matrices(self._places[held], Rotation.from_quat(self._turns[held]).as_matrix())

    def at(self, stamp_ns: int, tolerance_ns: int) -> FloatArray | None:
        """Return the pose at a time, or None if none is near it.

        Parameters
        ----------
        stamp_ns : int
        tolerance_ns : int
            A pose farther off than this does not count.

        Returns
        -------
        (4, 4) float64 or None
            Between two poses that count, positions are interpolated along the straight and
            rotations along the shortest way. With one of them, that one.
        """
        from scipy.spatial.transform import Rotation, Slerp

        after = int(np.searchsorted(self._stamps, stamp_ns))
        near = [
            k
            for k in (after - 1, after)
            if 0 <= k < len(self) and abs(int(self._stamps[k]) - stamp_ns) <= tolerance_ns
        ]
        if not near:
            return None
        if len(near) == 1 or self._stamps[after] == stamp_ns:
            return self.matrices(near[-1:])[0]
        # Exact differences first: float64 cannot tell nanoseconds since 1970 apart.
        span = int(self._stamps[near[1]]) - int(self._stamps[near[0]])
        share = (stamp_ns - int(self._stamps[near[0]])) / span
        place = (1 - share) * self._places[near[0]] + share * self._places[near[1]]
        turn = Slerp([0.0, 1.0], Rotation.from_quat(self._turns[near]))([share])
        return _matrices(place[None], turn.as_matrix())[0]


def _matrices(places: FloatArray, turns: FloatArray) -> list[FloatArray]:
    made = np.tile(np.eye(4), (len(places), 1, 1))
    made[:, :3, :3], made[:, :3, 3] = turns, places
    return list(made)


def check_poses(places: FloatArray, turns: FloatArray) -> None:
    """Raise an `InputError` unless (P, 3) positions and (P, 4) quaternions are rigid motions."""
    length = np.linalg.norm(turns, axis=1)
    good = np.isfinite(places).all(axis=1) & (np.abs(length - 1) < 0.01)
    if not good.all():
        first = int(np.argmin(good))
        raise InputError(
            f"{np.count_nonzero(~good)} of {len(good)} poses are no rigid motions"
            if len(good) > 1
            else "the pose is no rigid motion",
            received=f"position {places[first].tolist()}, quaternion {turns[first].tolist()}",
            remedy="a pose needs finite numbers and a quaternion of length 1",
        )
