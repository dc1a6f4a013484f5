"""A streaming pipeline: frames in, changes of the scene's skeleton out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mdcs_pipeline.arrays import finite_points, points_array
from mdcs_pipeline.checks import find_output
from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import ConfigError, InputError
from mdcs_pipeline.graph import Graph, build_graph
from mdcs_pipeline.header import Header
from mdcs_pipeline.hooks import Hook
from mdcs_pipeline.io.checkpoint import read_checkpoint, write_checkpoint
from mdcs_pipeline.io.open3d_bridge import points_of
from mdcs_pipeline.messages import PointCloud, Skeleton
from mdcs_pipeline.poses import posed, rigid_pose
from mdcs_pipeline.runner import Runner, RunRecord
from mdcs_pipeline.scene.archive import scene_arrays, scene_from_arrays
from mdcs_pipeline.scene.change import SceneChange
from mdcs_pipeline.scene.state import Scene

# Updates that a flush may take: each works on as much as one frame may.
_FLUSHES = 1000


class Stream:
    """Keeps one scene's skeleton up with its frames.

    Parameters
    ----------
    graph : Graph
        With one source and one result of type `SceneChange`, such as ``streaming``.
    hooks : sequence of Hook, optional
    unusable : {"refuse", "drop"}
        What to do with a frame that cannot be used: empty, all NaN, of a wrong shape, with a
        pose that is none, beyond the map. Refused or dropped, the scene stays as it was.

    Attributes
    ----------
    counts : dict of int
        Frames ``received``, ``used`` and ``dropped``; the first is the sum of the others.
    dropped : dict of int
        The dropped, by reason.
    last : RunRecord or None
        Of the latest frame that was run.
    """

    def __init__(
        self,
        graph: Graph,
        hooks: Sequence[Hook] = (),
        unusable: Literal["refuse", "drop"] = "refuse",
    ) -> None:
        self.graph = graph
        self._result = _change_result(graph)
        (self._source,) = graph.spec.sources
        self._runner = Runner(graph, hooks)
        self._unusable = unusable
        self.counts = {"received": 0, "used": 0, "dropped": 0}
        self.dropped: dict[str, int] = {}
        self.last: RunRecord | None = None

    @classmethod
    def from_config(
        cls, config: str | Path = "streaming", hooks: Sequence[Hook] = (), **settings: Any
    ) -> Stream:
        """Return the stream that a configuration describes; see `Pipeline.from_config`."""
        return cls(build_graph(load_spec(config, settings)), hooks)

    @property
    def scene(self) -> Scene:
        """The scene as it stands; owned by the runner."""
        held: Scene = self._runner.states[Scene]
        return held

    def push(
        self,
        points: Any,
        *,
        stamp_ns: int | None = None,
        frame_id: str = "",
        pose: Any = None,
    ) -> SceneChange:
        """Add a frame and return what it changed.

        Parameters
        ----------
        points : (N, 3) array-like, Open3D cloud or PointCloud
            In the scene's frame, or in the sensor's if a pose says where that is.
        stamp_ns : int, optional
            Must rise from frame to frame; one above the last when absent.
        frame_id : str
            Of the scene; another one than before begins a new scene.
        pose : (4, 4) array-like, optional
            Rigid motion that takes the points into the scene's frame.

        Returns
        -------
        SceneChange
            Its figures name as ``dropped`` why a frame was not used.

        Raises
        ------
        InputError
            If the frame cannot be used and is to be refused.
        StageError
            If a stage fails; what the frame brought waits for the next one.
        """
        self.counts["received"] += 1
        if stamp_ns is None:
            stamp_ns = max(self.scene.stamp_ns + 1, 1)
        header = Header(frame_id, stamp_ns, self.counts["received"] - 1)
        try:
            change = self._run(self._cloud(points, header, pose))
        except InputError as error:
            if self._unusable == "refuse":
                self._drop("refused")
                raise
            self._drop("unusable")
            figures = {"dropped": error.what}
            return SceneChange(header, scene=self.scene.number, figures=figures)
        why = change.figures.get("dropped")
        if why is None:
            self.counts["used"] += 1
        else:
            self._drop(str(why))
        return change

    def flush(self) -> list[SceneChange]:
        """Work on all that still waits for more frames, and return the changes."""
        changes: list[SceneChange] = []
        scene = self.scene
        header = Header(scene.frame_id or "", max(scene.stamp_ns, 0), self.counts["received"])
        scene.drain = True
        try:
            for _ in range(_FLUSHES):
                before = self._waiting()
                change = self._run(PointCloud(np.empty((0, 3)), header=header))
                if len(change) or len(change.joined) or len(change.parted):
                    changes.append(change)
                if self._waiting() >= before:
                    break
        finally:
            scene.drain = False
        return changes

    def change(self, graph: Graph) -> None:
        """Go on with other settings of the same graph; the scene stays as it is."""
        states = self._runner.states
        self.graph = graph
        self._runner = Runner(graph, self._runner.hooks)
        self._runner.states = states

    def reset(self) -> None:
        """End the scene and begin a new one."""
        self.scene.begin_anew()

    def skeleton(self) -> Skeleton:
        """Return the whole skeleton as it stands; unlike `push` this reads all of the scene."""
        return self.scene.skeleton()

    def save(self, path: str | Path, extra: Mapping[str, Any] | None = None) -> None:
        """Write a checkpoint, whole or not at all.

        Parameters
        ----------
        path : str or Path
        extra : mapping, optional
            What the caller wants to find again, fit for JSON.

        Raises
        ------
        OutputError
            If it cannot be written; then an older one is kept.
        """
        values, arrays = scene_arrays(self.scene)
        held = {
            "pipeline": self._fingerprint(),
            "counts": self.counts,
            "dropped": self.dropped,
            "scene": values,
            "extra": dict(extra or {}),
        }
        write_checkpoint(Path(path), held, arrays)

    def restore(self, path: str | Path) -> dict[str, Any]:
        """Go on from a checkpoint; what follows is as if there had been no break.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        dict
            The `extra` that it was saved with.

        Raises
        ------
        InputError
            If it is damaged, none of ours, or of another pipeline or other settings.
        """
        path = Path(path)
        values, arrays = read_checkpoint(path)
        try:
            made_by = values["pipeline"]
            if made_by == self._fingerprint():
                scene = scene_from_arrays(values["scene"], arrays)
                counts = {name: int(values["counts"][name]) for name in self.counts}
                dropped = {str(k): int(n) for k, n in values["dropped"].items()}
                extra: dict[str, Any] = dict(values["extra"])
        except (KeyError, ValueError, IndexError, TypeError, AttributeError) as error:
            raise InputError(
                "the checkpoint is damaged", where=str(path), received=repr(error)
            ) from error
        if made_by != self._fingerprint():
            raise InputError(
                "the checkpoint is of another pipeline or other settings",
                where=str(path),
                remedy="use the configuration and settings that it was made with, or another file",
            )
        self._runner.states[Scene] = scene
        self.counts, self.dropped = counts, dropped
        return extra

    def _fingerprint(self) -> str:
        spec = self.graph.spec
        wiring = {
            name: [stage.stage, *sorted(f"{k}={v}" for k, v in _wires(stage))]
            for name, stage in spec.stages.items()
        }
        settings = {n: s.settings.model_dump(mode="json") for n, s in self.graph.stages.items()}
        text = json.dumps([spec.name, wiring, settings], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def _cloud(self, points: Any, header: Header, pose: Any) -> PointCloud:
        given = points.positions if isinstance(points, PointCloud) else points
        held = points_of(given)
        rows = points_array(given if held is None else held)
        finite, dropped = finite_points(rows, self.graph.spec.sources[self._source].nonfinite)
        if not len(finite):
            raise InputError(
                "the frame is empty",
                received=f"{dropped} points, all NaN or infinite" if dropped else "0 points",
                remedy="check the source, or drop such frames",
            )
        if pose is not None:
            finite = posed(finite, rigid_pose(pose))
        return PointCloud(finite, header=header, dropped=dropped)

    def _run(self, cloud: PointCloud) -> SceneChange:
        self.last = self._runner.run({self._source: cloud})
        change: SceneChange = self.last.results[self._result]
        return change

    def _waiting(self) -> int:
        scene = self.scene
        if scene.world is None:
            return 0
        pending = scene.world.voxels.pending
        held = [scene.changed, *scene.waiting.values()]
        return sum(int(np.count_nonzero(pending[slots])) for slots in held)

    def _drop(self, why: str) -> None:
        self.counts["dropped"] += 1
        self.dropped[why] = self.dropped.get(why, 0) + 1


def _wires(stage: Any) -> list[tuple[str, str]]:
    wires = [(port, str(ref)) for port, refs in stage.inputs.items() for ref in refs]
    for port, backs in stage.feedback.items():
        wires += [(f"{port}<", f"{back.origin} {back.max_rounds}") for back in backs]
    return wires


def _change_result(graph: Graph) -> str:
    kinds = [stage.State for stage in graph.stages.values()]
    for name, ref in graph.spec.results.items():
        _, port = find_output(ref, graph.spec, graph.ports, name)
        if port.type is SceneChange and Scene in kinds and len(graph.spec.sources) == 1:
            return name
    raise ConfigError(
        f"the pipeline '{graph.spec.name}' keeps no scene from frame to frame",
        where=graph.spec.file,
        received=", ".join(graph.spec.results) or "no results",
        remedy="use the configuration 'streaming', or one with a stage 'scene', one 'splice' "
        "whose changes are a result, and one source",
    )
