"""What ``mdcs stream`` does: read, update, report, save."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mdcs_pipeline.cli.console import note, say
from mdcs_pipeline.cli.stream_plan import Outputs, Saving, Source
from mdcs_pipeline.cli.stream_screen import StreamScreen
from mdcs_pipeline.cli.ticker import Ticker
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.frames import Frame
from mdcs_pipeline.io.change_lines import ChangeLines
from mdcs_pipeline.io.write import write_skeleton
from mdcs_pipeline.overload import Gate, Policy
from mdcs_pipeline.scene.change import SceneChange
from mdcs_pipeline.stream import Stream


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
    screen: StreamScreen = field(default_factory=StreamScreen)
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
                    self.screen.hold()
                    change = self._one(frame, came, lines, ticker)
                    self.screen.frame(number, change, self.stream, self.lags[-1])
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
        self.screen.goes_on()
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
            began = self.screen.now()
            for number, frame in enumerate(self.frames.since(first)):
                self.screen.hold()
                if self.rate is not None:
                    time.sleep(max(0.0, began + number / self.rate - self.screen.now()))
                if not gate.put((self.screen.now(), first + number + 1, frame)):
                    return
            gate.close()
        except BaseException as error:  # raised again where the frames are taken
            gate.close(error)

    def _one(
        self, frame: Frame, came: float, lines: list[ChangeLines], ticker: Ticker
    ) -> SceneChange:
        if self.stream.scene.frame_id not in (None, frame.frame_id):
            self._end_scene(lines)
        began = time.monotonic()
        change = self.stream.push(
            frame.points, stamp_ns=frame.stamp_ns, frame_id=frame.frame_id, pose=frame.pose
        )
        for held in lines:
            held.write(change)
        self.seconds.append(time.monotonic() - began)
        self.lags.append(self.screen.now() - came)
        ticker.frame(change, self.stream.last, self.seconds[-1], self.lags[-1])
        return change

    def _end_scene(self, lines: list[ChangeLines]) -> None:
        """Finish the scene that a change of frame ends, so that nothing of it is lost."""
        self._flush(lines)
        if not len(self.stream.skeleton()):
            return
        number = self.stream.scene.number
        for path in self.outputs.skeletons:
            self._write(path.with_name(f"{path.stem}.{number}{path.suffix}"))

    def _flush(self, lines: list[ChangeLines]) -> None:
        changes = self.stream.flush()
        for change in changes:
            for held in lines:
                held.write(change)
        if changes:
            self.screen.ended(self.stream)

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
        elsewhere = {"overload": self.overload, "no pose": self.frames.skipped}
        dropped |= {why: count for why, count in elsewhere.items() if count}
        frames = {
            "received": counts["received"] + sum(elsewhere.values()),
            "used": counts["used"],
            "dropped": counts["dropped"] + sum(elsewhere.values()),
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
