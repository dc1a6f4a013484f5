"""Poses by time: where a sensor stood when it measured."""

from __future__ import annotations

import bisect
import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.pose_track import interpolated

# Some minutes of odometry at 100 Hz.
MOST_POSES = 20_000


@dataclass(frozen=True)
class Pose:
    """A rotation and a shift into the frame `frame_id`.

    Parameters
    ----------
    stamp_ns : int
    frame_id : str
    position : (3,) float64
    quaternion : (4,) float64
        x, y, z, w of unit length.
    """

    stamp_ns: int
    frame_id: str
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]

    def apply(self, points: FloatArray) -> NDArray[np.float64]:
        """Return (N, 3) points of the sensor in the frame of the pose."""
        return np.asarray(points, np.float64) @ rotation(self.quaternion).T + self.position


def rotation(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) matrix of a unit quaternion x, y, z, w."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quaternion).as_matrix(), dtype=np.float64)


def make_pose(stamp_ns: int, frame_id: str, position: object, quaternion: object) -> Pose:
    """Return a pose, or raise an `InputError` if it is none."""
    place = np.asarray(position, np.float64)
    turn = np.asarray(quaternion, np.float64)
    length = float(np.linalg.norm(turn))
    if not (np.isfinite(place).all() and np.isfinite(length) and abs(length - 1) < 0.01):
        raise InputError(
            "the pose is no rigid motion",
            received=f"position {place.tolist()}, quaternion {turn.tolist()}",
            remedy="publish finite coordinates and a quaternion of length 1",
        )
    return Pose(stamp_ns, frame_id, place, turn / length)


class PoseBuffer:
    """The latest poses, in the order of their stamps.

    Parameters
    ----------
    tolerance_ns : int
        How far from a pose in time a cloud may lie.
    """

    def __init__(self, tolerance_ns: int) -> None:
        self.tolerance_ns = tolerance_ns
        self._poses: list[Pose] = []
        self._arrived = threading.Condition()

    def clear(self) -> None:
        """Forget all poses."""
        with self._arrived:
            self._poses.clear()

    def add(self, pose: Pose) -> None:
        """Keep a pose; a change of frame forgets those before."""
        with self._arrived:
            if self._poses and self._poses[-1].frame_id != pose.frame_id:
                self._poses.clear()
            bisect.insort(self._poses, pose, key=lambda held: held.stamp_ns)
            del self._poses[:-MOST_POSES]
            self._arrived.notify_all()

    def wait(self, stamp_ns: int, seconds: float) -> Pose:
        """Return the pose at a time, after waiting for one that is still on its way.

        Between two poses, both within the tolerance, it is interpolated; the odometry of a
        moment often arrives after the cloud of that moment.

        Raises
        ------
        InputError
            If none came in time.
        """
        with self._arrived:
            # Only a pose from behind the moment says that no nearer one will come.
            self._arrived.wait_for(lambda: self._is_past(stamp_ns), timeout=seconds)
            found = self._at(stamp_ns)
        if found is None:
            raise InputError(
                "no pose is near the cloud in time",
                received=f"cloud at {stamp_ns} ns, {len(self._poses)} poses",
                remedy="publish poses with the clouds' clock, or raise pose_tolerance",
            )
        return found

    def _is_past(self, stamp_ns: int) -> bool:
        return bool(self._poses) and self._poses[-1].stamp_ns >= stamp_ns

    def _at(self, stamp_ns: int) -> Pose | None:
        after = bisect.bisect_left(self._poses, stamp_ns, key=lambda held: held.stamp_ns)
        near = [
            pose
            for pose in self._poses[max(after - 1, 0) : after + 1]
            if abs(pose.stamp_ns - stamp_ns) <= self.tolerance_ns
        ]
        if len(near) == 2:
            return between(near[0], near[1], stamp_ns)
        return near[0] if near else None


def between(first: Pose, second: Pose, stamp_ns: int) -> Pose:
    """Return the pose at a time between two others; rotations go the shortest way."""
    span = second.stamp_ns - first.stamp_ns
    share = (stamp_ns - first.stamp_ns) / span if span else 1.0
    places = np.stack([first.position, second.position])
    turns = np.stack([first.quaternion, second.quaternion])
    place, turn = interpolated(share, places, turns)
    return Pose(stamp_ns, first.frame_id, place, turn)
