"""Poses as they arrive: where a sensor stood when it measured."""

from __future__ import annotations

import bisect
import threading
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.pose_track import PoseTrack, check_poses

# Some minutes of odometry at 100 Hz.
MOST_POSES = 20_000
_stamp = attrgetter("stamp_ns")


@dataclass(frozen=True)
class Pose:
    """A rotation and a shift into the frame `frame_id`, at a time.

    Parameters
    ----------
    stamp_ns : int
    frame_id : str
    position : (3,) float64
    quaternion : (4,) float64
        x, y, z, w; its length may be off by a hundredth.
    """

    stamp_ns: int
    frame_id: str
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]


def make_pose(stamp_ns: int, frame_id: str, position: object, quaternion: object) -> Pose:
    """Return a pose, or raise an `InputError` if it is none."""
    place = np.asarray(position, np.float64)
    turn = np.asarray(quaternion, np.float64)
    check_poses(place[None], turn[None])
    return Pose(stamp_ns, frame_id, place, turn)


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
            bisect.insort(self._poses, pose, key=_stamp)
            del self._poses[:-MOST_POSES]
            self._arrived.notify_all()

    def wait(self, stamp_ns: int, seconds: float) -> tuple[NDArray[np.float64], str]:
        """Return the pose at a time, after waiting for one that is still on its way.

        The odometry of a moment often arrives after the cloud of that moment.

        Returns
        -------
        (4, 4) float64
            As `PoseTrack.at` gives it.
        str
            The frame that it leads into.

        Raises
        ------
        InputError
            If none came in time.
        """
        with self._arrived:
            # Only a pose from behind the moment says that no nearer one will come.
            self._arrived.wait_for(lambda: self._is_past(stamp_ns), timeout=seconds)
            after = bisect.bisect_left(self._poses, stamp_ns, key=_stamp)
            near, held = self._poses[max(after - 1, 0) : after + 1], len(self._poses)
        stamps = [pose.stamp_ns for pose in near]
        track = PoseTrack(stamps, [p.position for p in near], [p.quaternion for p in near])
        matrix = track.at(stamp_ns, self.tolerance_ns)
        if matrix is None:
            raise InputError(
                "no pose is near the cloud in time",
                received=f"cloud at {stamp_ns} ns, {held} poses",
                remedy="publish poses with the clouds' clock, or raise pose_tolerance",
            )
        return matrix, near[0].frame_id

    def _is_past(self, stamp_ns: int) -> bool:
        return bool(self._poses) and self._poses[-1].stamp_ns >= stamp_ns
