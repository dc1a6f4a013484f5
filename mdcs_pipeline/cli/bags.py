"""Bags on the command line: clouds out of one, results into one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from mdcs_pipeline.cli.inputs import Frame, Frames
from mdcs_pipeline.errors import InputError, OutputError

if TYPE_CHECKING:
    from mdcs_pipeline.frames import Frame as BagFrame
    from mdcs_pipeline.io.bag_writer import BagWriter
    from mdcs_pipeline.io.bags import BagFrames
    from mdcs_pipeline.messages import PointCloud
    from mdcs_pipeline.skeleton import Skeleton

# How far apart the frames of a result stand that have no time of their own.
_STEP_NS = 100_000_000


class BagCursor:
    """Gives the clouds of a bag by number, those in a row in one pass."""

    def __init__(self, frames: BagFrames) -> None:
        self._frames = frames
        self._next = 0
        self._running: Iterator[BagFrame] | None = None

    def take(self, number: int) -> BagFrame:
        """Return the cloud of that number."""
        if self._running is None or number != self._next:
            self._running = self._frames.since(number)
        self._next = number + 1
        found = next(self._running, None)
        if found is None:
            raise InputError(
                "the bag ends before it should",
                where=str(self._frames.path),
                received=f"message {number} of {len(self._frames)}",
                remedy="it was cut off: ros2 bag reindex may help",
            )
        return found


def bag_frames(path: Path, source: str, topic: str | None, number: int | None) -> Frames:
    """Return the frames of a bag's topic, or the one of that number as a single cloud.

    Raises
    ------
    InputError
        If there is no such topic, or it has no such cloud.
    """
    from mdcs_pipeline.io.bags import BagFrames

    held = BagFrames(path, topic)
    count = len(held)
    where = f"{path}, {held.topic.name}"
    if not count:
        raise InputError("the topic has no cloud", where=where)
    if number is not None and not 0 <= number < count:
        raise InputError(
            f"there is no cloud of number {number}",
            where=where,
            received=f"{count} clouds",
            remedy=f"--frame counts from 0 to {count - 1}",
        )
    cursor = BagCursor(held)
    if number is not None:
        return Frames((Frame("", {source: path}, number),), None, cursor)
    frames = tuple(Frame(f"{k:06d}", {source: path}, k) for k in range(count))
    return Frames(frames, path, cursor)


def split_bags(outputs: list[Path], frames: Frames) -> tuple[list[Path], list[Path]]:
    """Return the outputs that are bags, and the others.

    Raises
    ------
    OutputError
        If a bag would be written over an input.
    """
    bags = [path for path in outputs if path.suffix.lower() == ".mcap"]
    inputs = {os.path.realpath(p) for frame in frames.frames for p in frame.files.values()}
    for path in bags:
        if os.path.realpath(path) in inputs:
            raise OutputError(
                "the output would overwrite the input",
                where=str(path),
                remedy="choose another name",
            )
    return bags, [path for path in outputs if path not in bags]


def add_result(bag: BagWriter, clouds: list[PointCloud], skeleton: Skeleton, number: int) -> None:
    """Write what went in and what came out, at the time of its measurement."""
    stamp = skeleton.header.stamp_ns
    when = stamp or number * _STEP_NS
    for k, cloud in enumerate(clouds):
        bag.add_cloud(
            cloud.positions,
            cloud.header.stamp_ns,
            cloud.header.frame_id,
            topic="/points" if len(clouds) == 1 else f"/points_{k}",
            recorded_ns=when,
        )
    bag.add_skeleton(skeleton, recorded_ns=when)
