"""What ``mdcs stream`` reads and writes, checked before any work is done."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from mdcs_pipeline.cli.common import check_folder, check_output
from mdcs_pipeline.cli.outputs import check_extra
from mdcs_pipeline.errors import ConfigError, OutputError
from mdcs_pipeline.frames import Frame
from mdcs_pipeline.io.frame_folder import FolderFrames, piped_frames
from mdcs_pipeline.io.write import SKELETON_SUFFIXES

if TYPE_CHECKING:
    from mdcs_pipeline.io.bags import BagFrames

LINES = ".jsonl"


class Source(Protocol):
    """Frames that can be read from any one on."""

    @property
    def skipped(self) -> int:
        """How many clouds were left out so far, as they have no pose."""

    def since(self, first: int) -> Iterator[Frame]:
        """Iterate from the frame of number `first`, counted from 0."""


class Pipe:
    """Frames from standard input; those before a break are gone and will not be sent again."""

    skipped = 0

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id

    def since(self, first: int) -> Iterator[Frame]:
        """Iterate over what comes, whatever was there before."""
        del first
        return piped_frames(sys.stdin.buffer, self._frame_id)


class PosedBag:
    """The clouds of a bag that have a pose, in the frame of the poses.

    They are counted without the others: who goes on behind the tenth has taken ten.
    """

    def __init__(self, frames: BagFrames) -> None:
        self._frames = frames

    @property
    def skipped(self) -> int:
        """How many clouds were left out so far, as they have no pose."""
        return self._frames.skipped

    def since(self, first: int) -> Iterator[Frame]:
        """Iterate from the frame of number `first`, counted from 0."""
        for frame in islice(self._frames.since(0), first, None):
            yield frame._replace(frame_id=self._frames.pose_frame)


def open_source(
    source: str,
    poses: Path | None,
    topic: str | None,
    pose_topic: str | None,
    frame_id: str,
    rate: float | None,
) -> Source:
    """Return what ``-i`` names."""
    if source == "-":
        return Pipe(frame_id)
    path = Path(source).expanduser()
    bag = _bag(path, topic, pose_topic)
    if bag is not None:
        return bag
    return FolderFrames(path, poses, frame_id, rate)


def _bag(path: Path, topic: str | None, poses: str | None) -> Source | None:
    from mdcs_pipeline.io.bags import BagFrames, is_bag

    if not is_bag(path):
        return None
    frames = BagFrames(path, topic, poses=poses)
    return frames if poses is None else PosedBag(frames)


@dataclass(frozen=True)
class Outputs:
    """Files to write: changes as lines, and the skeleton at the end."""

    lines: tuple[Path, ...]
    skeletons: tuple[Path, ...]


def plan_streamed(outputs: list[Path], source: str) -> Outputs:
    """Return the outputs by their kind, all of them possible to write.

    Raises
    ------
    OutputError
        If one cannot be written, or is named twice.
    """
    given = [path.expanduser() for path in outputs]
    real = [os.path.realpath(path) for path in given]
    for path, where in zip(given, real, strict=True):
        check_output(path, (LINES, *SKELETON_SUFFIXES))
        check_extra(path)
        if real.count(where) > 1 or where == os.path.realpath(source):
            raise OutputError(
                "the same file twice", where=str(path), remedy="name each output once"
            )
    lines = tuple(path for path in given if path.suffix.lower() == LINES)
    return Outputs(lines, tuple(path for path in given if path not in lines))


@dataclass
class Saving:
    """When a checkpoint is due."""

    path: Path | None
    frames: int | None = None
    seconds: float | None = None
    last: float = field(default_factory=time.monotonic)

    @classmethod
    def parse(cls, path: Path | None, every: str) -> Saving:
        """Return the plan that ``--every`` names: ``10`` frames, or ``2.5s``.

        Raises
        ------
        ConfigError
            If it names none.
        """
        if path is not None:
            check_folder(path.parent, path)
        try:
            if every.endswith("s") and float(every[:-1]) > 0:
                return cls(path, seconds=float(every[:-1]))
            if int(every) > 0:
                return cls(path, frames=int(every))
        except ValueError:
            pass
        raise ConfigError(
            "--every takes a number of frames, or of seconds with an s",
            received=every,
            remedy="such as 10 or 2.5s",
        )

    def due(self, received: int) -> bool:
        """Return whether to save after the frame that is the `received`-th."""
        if self.path is None:
            return False
        if self.frames is not None:
            return received % self.frames == 0
        now = time.monotonic()
        if self.seconds is not None and now - self.last >= self.seconds:
            self.last = now
            return True
        return False
