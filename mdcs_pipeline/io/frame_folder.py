"""Frames out of a folder of clouds with their poses, and out of a pipe."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.frames import Frame
from mdcs_pipeline.io.clouds import frame_files, read_points

POSE_FILES = ("poses.txt", "poses.npy")
_SECOND = 1_000_000_000


class FolderFrames:
    """The clouds of a folder, in the order of the numbers in their names.

    Parameters
    ----------
    folder : Path
    poses : Path, optional
        One pose a cloud, in the same order; the folder's ``poses.txt`` or ``poses.npy`` when
        absent and there. See `read_poses`.
    frame_id : str
        Of all frames.
    rate : float, optional
        Frames a second where the poses bring no stamps; without it stamps count frames.

    Raises
    ------
    InputError
        If there is no cloud in the folder, or the poses cannot be read or are too few.
    """

    #: Clouds that were left out: none, as there is a pose for each or there are none.
    skipped = 0

    def __init__(
        self, folder: Path, poses: Path | None = None, frame_id: str = "", rate: float | None = None
    ) -> None:
        self.files = frame_files(folder)
        self.frame_id = frame_id
        given = poses or next((p for n in POSE_FILES if (p := folder / n).is_file()), None)
        if poses is None and given is not None:
            self.files = [path for path in self.files if path.name not in POSE_FILES]
        self._stamps: list[int] | None = None
        self._poses: NDArray[np.float64] | None = None
        if given is not None:
            self._stamps, self._poses = read_poses(given)
        if self._poses is not None and len(self._poses) < len(self.files):
            raise InputError(
                f"there are {len(self.files)} clouds and {len(self._poses)} poses",
                where=str(given),
                remedy="give one pose a cloud, in the order of the files",
            )
        self._step = 1 if rate is None else max(1, round(_SECOND / rate))

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[Frame]:
        return self.since(0)

    def since(self, first: int) -> Iterator[Frame]:
        """Iterate from the frame of number `first`, counted from 0."""
        for number in range(first, len(self.files)):
            stamp = (number + 1) * self._step
            if self._stamps is not None:
                stamp = self._stamps[number]
            pose = None if self._poses is None else self._poses[number]
            yield Frame(stamp, self.frame_id, read_points(self.files[number]), pose)


def read_poses(path: Path) -> tuple[list[int] | None, NDArray[np.float64]]:
    """Return the stamps, if there are any, and the (P, 4, 4) poses of a file.

    Parameters
    ----------
    path : Path
        ``.npy`` of shape (P, 4, 4) or (P, 3, 4); or text, one pose a line: 12 or 16 numbers
        are the rows of (R t), 8 are ``seconds tx ty tz qx qy qz qw``. Lines from # on are
        comments.

    Raises
    ------
    InputError
        If it cannot be read or has another form.
    """
    try:
        if path.suffix.lower() == ".npy":
            held = np.load(path, allow_pickle=False)
            rows = held.reshape(len(held), -1).astype(np.float64)
            texts: list[str] | None = None
        else:
            lines = path.read_text(encoding="utf-8").splitlines()
            words = [line.split("#")[0].split() for line in lines]
            words = [line for line in words if line]
            rows = np.array([[float(word) for word in line] for line in words], dtype=np.float64)
            texts = [line[0] for line in words]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            "the poses cannot be read", where=str(path), received=str(error)
        ) from error
    width = rows.shape[1] if rows.ndim == 2 else 0
    if width in (12, 16):
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        poses[:, : width // 4] = rows.reshape(len(rows), -1, 4)
        return None, poses
    if width == 8 and texts is not None:
        return [_nanoseconds(text) for text in texts], _from_quaternions(rows[:, 1:4], rows[:, 4:])
    raise InputError(
        "poses must be 12 or 16 numbers a line, or 8 with stamp and quaternion",
        where=str(path),
        received=f"{len(rows)} lines of {width or 'different'} numbers",
    )


def _nanoseconds(text: str) -> int:
    """Return seconds written out as nanoseconds, without the round-off of a float."""
    whole, _, part = text.partition(".")
    if whole.isdecimal() and (part.isdecimal() or not part):
        return int(whole) * _SECOND + int((part + "000000000")[:9])
    return round(float(text) * _SECOND)


def _from_quaternions(
    places: NDArray[np.float64], turns: NDArray[np.float64]
) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    poses = np.tile(np.eye(4), (len(places), 1, 1))
    try:
        poses[:, :3, :3] = Rotation.from_quat(turns).as_matrix()
    except ValueError as error:
        raise InputError("a quaternion of the poses is no rotation", received=str(error)) from error
    poses[:, :3, 3] = places
    return poses


def piped_frames(stream: BinaryIO, frame_id: str = "") -> Iterator[Frame]:
    """Yield frames as they come through a pipe, each as one line of JSON or one NPY array.

    A line of JSON holds ``points`` and may hold ``stamp_ns``, ``frame_id`` and ``pose``
    (4 rows of 4). An array is what ``numpy.save`` writes to a pipe, one after another.
    Stamps that are missing count frames.

    Parameters
    ----------
    stream : binary stream
    frame_id : str
        Where a frame names none.

    Raises
    ------
    InputError
        If something else comes through.
    """
    number = 0
    while first := stream.read(1):
        if first in b"\r\n":
            continue
        number += 1
        try:
            yield (_from_npy if first == b"\x93" else _from_line)(first, stream, number, frame_id)
        except (ValueError, TypeError, EOFError, RecursionError) as error:
            raise InputError(
                "what came through the pipe is no frame",
                where=f"frame {number}",
                received=str(error),
                remedy="send lines of JSON with 'points', or arrays as numpy.save writes them",
            ) from error


def _from_npy(first: bytes, stream: BinaryIO, number: int, frame_id: str) -> Frame:
    points = np.lib.format.read_array(_Prefixed(first, stream), allow_pickle=False)
    return Frame(number, frame_id, points)


def _from_line(first: bytes, stream: BinaryIO, number: int, frame_id: str) -> Frame:
    held: Any = json.loads(first + stream.readline())
    if not isinstance(held, dict) or "points" not in held:
        raise ValueError("a line without 'points'")
    pose = held.get("pose")
    points = np.array(held["points"], dtype=np.float64).reshape(-1, 3)
    return Frame(
        int(held.get("stamp_ns", number)),
        str(held.get("frame_id", frame_id)),
        points,
        None if pose is None else np.array(pose, dtype=np.float64),
    )


class _Prefixed:
    """A stream with a byte put back in front."""

    def __init__(self, first: bytes, stream: BinaryIO) -> None:
        self._first, self._stream = first, stream

    def read(self, count: int = -1) -> bytes:
        if not self._first or count == 0:
            return self._stream.read(count)
        first, self._first = self._first, b""
        return first + self._stream.read(count - 1 if count > 0 else count)
