"""What ``mdcs stream`` does: read, update, report, save."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from mdcs_pipeline.cli.common import check_folder, check_output
from mdcs_pipeline.cli.console import note, say
from mdcs_pipeline.cli.outputs import check_extra
from mdcs_pipeline.cli.ticker import Ticker
from mdcs_pipeline.errors import ConfigError, InputError, OutputError
from mdcs_pipeline.frames import Frame
from mdcs_pipeline.io.change_lines import ChangeLines
from mdcs_pipeline.io.frame_folder import FolderFrames, piped_frames
from mdcs_pipeline.io.write import SKELETON_SUFFIXES, write_skeleton
from mdcs_pipeline.overload import Gate, Policy
from mdcs_pipeline.stream import Stream

LINES = ".jsonl"


class Source(Protocol):
    """Frames that can be read from any one on."""

    def since(self, first: int) -> Iterator[Frame]:
        """Iterate from the frame of number `first`, counted from 0."""


class Pipe:
    """Frames from standard input; those before a break are gone and will not be sent again."""

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id

    def since(self, first: int) -> Iterator[Frame]:
        """Iterate over what comes, whatever was there before."""
        del first
        return piped_frames(sys.stdin.buffer, self._frame_id)


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
    from importlib.util import find_spec

    if find_spec("mdcs_pipeline.io.bags") is None:
        return None
    from mdcs_pipeline.io.bags import BagFrames, is_bag

    return BagFrames(path, topic, poses=poses) if is_bag(path) else None


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


@dataclass
class Job:
    """One run of ``mdcs stream``."""

    stream: Stream
    frames: Source
    outputs: Outputs
    saving: Saving
    policy: Policy
    rate: float | None
    quiet: bool
    seconds: list[float] = field(default_factory=list)
    lags: list[float] = field(default_factory=list)
    overload: int = 0

    def run(self) -> None:
        """Run all frames through the stream and write what comes of them."""
        extra = self._resume()
        done = int(extra.get("read", 0))
        # Frames that an earlier run lost to overload are not to be counted out of this one's.
        self.overload = int(extra.get("overload", 0))
        gate: Gate[tuple[float, int, Frame]] = Gate(self.policy)
        lines = [ChangeLines(p, extra.get("lines", {}).get(str(p))) for p in self.outputs.lines]
        reader = threading.Thread(target=self._read, args=(gate, done), daemon=True)
        reader.start()
        try:
            with Ticker(self.quiet) as ticker:
                for came, number, frame in gate:
                    self._one(frame, came, lines, ticker)
                    if self.saving.due(number):
                        self._save(number, gate, lines)
            self.overload += gate.dropped
            self._finish(lines)
        finally:
            gate.close()
            for held in lines:
                held.close()

    def _resume(self) -> dict[str, Any]:
        path = self.saving.path
        if path is None or not path.exists():
            return {}
        extra = self.stream.restore(path)
        if not self.quiet:
            note(f"going on from {path}: {extra.get('read', 0)} frames were done")
        return extra

    def _save(
        self, number: int, gate: Gate[tuple[float, int, Frame]], lines: list[ChangeLines]
    ) -> None:
        assert self.saving.path is not None
        places = {str(held.path): held.sync() for held in lines}
        held = {"read": number, "overload": self.overload + gate.dropped, "lines": places}
        self.stream.save(self.saving.path, held)

    def _read(self, gate: Gate[tuple[float, int, Frame]], first: int) -> None:
        try:
            began = time.monotonic()
            for number, frame in enumerate(self.frames.since(first)):
                if self.rate is not None:
                    time.sleep(max(0.0, began + number / self.rate - time.monotonic()))
                if not gate.put((time.monotonic(), first + number + 1, frame)):
                    return
            gate.close()
        except BaseException as error:  # raised again where the frames are taken
            gate.close(error)

    def _one(
        self, frame: Frame, came: float, lines: list[ChangeLines], ticker: Ticker
    ) -> None:
        if self.stream.scene.frame_id not in (None, frame.frame_id):
            self._end_scene(lines)
        began = time.monotonic()
        change = self.stream.push(
            frame.points, stamp_ns=frame.stamp_ns, frame_id=frame.frame_id, pose=frame.pose
        )
        for held in lines:
            held.write(change)
        now = time.monotonic()
        self.seconds.append(now - began)
        self.lags.append(now - came)
        ticker.frame(change, self.stream.last, self.seconds[-1], self.lags[-1])

    def _end_scene(self, lines: list[ChangeLines]) -> None:
        """Finish the scene that a change of frame ends, so that nothing of it is lost."""
        self._flush(lines)
        if not len(self.stream.skeleton()):
            return
        number = self.stream.scene.number
        for path in self.outputs.skeletons:
            self._write(path.with_name(f"{path.stem}.{number}{path.suffix}"))

    def _flush(self, lines: list[ChangeLines]) -> None:
        for change in self.stream.flush():
            for held in lines:
                held.write(change)

    def _finish(self, lines: list[ChangeLines]) -> None:
        self._flush(lines)
        for path in self.outputs.skeletons:
            self._write(path)

    def _write(self, path: Path) -> None:
        settings = {
            name: stage.settings.model_dump(mode="json")
            for name, stage in self.stream.graph.stages.items()
        }
        scene = self.stream.scene
        cloud = scene.world.surface() if scene.world is not None else None
        skeleton = self.stream.skeleton()
        if not len(skeleton):
            raise InputError(
                "no skeleton came of the frames",
                received=json.dumps(self.summary()["frames"]),
                remedy="were the frames empty, or are the voxels too large for the shape?",
            )
        write_skeleton(skeleton, path, cloud=cloud, settings=settings)

    def summary(self) -> dict[str, Any]:
        """Return what the run did, fit for JSON."""
        counts = dict(self.stream.counts)
        dropped = dict(self.stream.dropped)
        if self.overload:
            dropped["overload"] = self.overload
        frames = {
            "received": counts["received"] + self.overload,
            "used": counts["used"],
            "dropped": counts["dropped"] + self.overload,
            "why": dropped,
        }
        seconds = sorted(self.seconds)
        return {
            "ok": True,
            "pipeline": self.stream.graph.spec.name,
            "frames": frames,
            "scenes": self.stream.scene.number + 1,
            "skeleton": self.stream.skeleton().summary(),
            "seconds": {
                "mean": sum(seconds) / len(seconds) if seconds else 0.0,
                "p99": seconds[min(len(seconds) - 1, int(0.99 * len(seconds)))] if seconds else 0.0,
                "largest_lag": max(self.lags, default=0.0),
            },
            "outputs": [str(p) for p in (*self.outputs.lines, *self.outputs.skeletons)],
        }

    def tell(self, as_json: bool, quiet: bool) -> None:
        """Say what came of it."""
        held = self.summary()
        if as_json:
            say(json.dumps(held))
        elif not quiet:
            frames, shape = held["frames"], held["skeleton"]
            why = ", ".join(f"{n} {name}" for name, n in frames["why"].items())
            say(
                f"{frames['received']} frames: {frames['used']} used, {frames['dropped']} dropped"
                + (f" ({why})" if why else "")
            )
            say(
                f"{shape['nodes']} nodes, {shape['components']} pieces, {shape['cycles']} loops, "
                f"{shape['leaves']} ends; {1e3 * held['seconds']['mean']:.0f} ms a frame"
            )

