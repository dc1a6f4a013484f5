"""A pipeline that a host keeps: settings change between frames, never within one."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mdcs_pipeline.config import load_spec, override_spec
from mdcs_pipeline.errors import ConfigError, InputError, suggestion
from mdcs_pipeline.graph import Graph, build_graph
from mdcs_pipeline.pipeline import Pipeline
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.spec import NONFINITE, PipelineSpec
from mdcs_pipeline.stream import Stream


class Host:
    """A configuration, the settings put over it, and the pipeline made of both.

    Parameters
    ----------
    config : str or Path
        Name of a shipped configuration, or path of a YAML file.

    Raises
    ------
    ConfigError
        If there is no such configuration, or it does not fit together.
    """

    def __init__(self, config: str | Path) -> None:
        self._file = load_spec(config)
        self._lock = threading.Lock()
        self._overrides: dict[str, Any] = {}
        self._begun = False
        self._runs = _runs(build_graph(self._file))

    @property
    def graph(self) -> Graph:
        """The graph as it is set now."""
        return self._runs.graph

    def settings(self) -> dict[str, Any]:
        """Return every setting by its full name, such as ``transport.epsilon``."""
        return settings_of(self.graph)

    def check(self, changes: Mapping[str, Any]) -> Graph:
        """Return the graph that the changes would give, and change nothing.

        Raises
        ------
        ConfigError
            If a setting is unknown, out of range, or fixed while the host runs.
        """
        known = self.settings()
        for name in changes:
            if name not in known:
                raise ConfigError(
                    f"{self._file.name} has no setting '{name}'", remedy=suggestion(name, known)
                )
            stage = self.graph.stages.get(name.partition(".")[0])
            if self._begun and stage is not None and stage.State is not None:
                raise ConfigError(
                    f"'{name}' belongs to what the scene is built on",
                    remedy="set it before the first frame, or after a reset",
                )
            if is_place(name, self.graph):
                raise ConfigError(
                    f"'{name}' names a place on this machine and is fixed",
                    remedy="set it in the configuration, or where the node is started",
                )
        return build_graph(override_spec(self._file, {**self._overrides, **changes}))

    def change(self, changes: Mapping[str, Any], graph: Graph | None = None) -> None:
        """Put settings over those of the file; frames that begin later run with them.

        Parameters
        ----------
        changes : mapping
        graph : Graph, optional
            What `check` returned for them.
        """
        graph = self.check(changes) if graph is None else graph
        with self._lock:
            self._overrides.update(changes)
            if isinstance(self._runs, Stream) and self._begun:
                self._runs.change(graph)
            else:
                self._runs = _runs(graph)

    def start_with(self, values: Mapping[str, Any]) -> None:
        """Put settings over those of the file before the first frame, places included."""
        self._overrides.update(values)
        self._runs = _runs(build_graph(override_spec(self._file, self._overrides)))

    def reset(self) -> None:
        """Forget all that frames have left behind, but no setting."""
        with self._lock:
            self._begun = False
            self._runs = _runs(self._runs.graph)

    def push(self, points: Mapping[str, Any], stamp_ns: int, frame_id: str) -> Skeleton:
        """Run one frame and return its skeleton, or that of the scene so far.

        Raises
        ------
        InputError
            If the frame cannot be used.
        StageError
            If a stage fails.
        """
        with self._lock:
            self._begun = True
            if isinstance(self._runs, Stream):
                return _streamed(self._runs, points, stamp_ns, frame_id)
            pipeline = self._runs
        return pipeline.push(points, stamp_ns=stamp_ns, frame_id=frame_id)

    @property
    def spec(self) -> PipelineSpec:
        """The pipeline as it is set now."""
        return self.graph.spec


def _runs(graph: Graph) -> Pipeline | Stream:
    """Return what runs a graph: a stream where it remembers frames, a pipeline otherwise."""
    remembers = any(stage.State is not None for stage in graph.stages.values())
    return Stream(graph) if remembers else Pipeline(graph)


def _streamed(stream: Stream, points: Mapping[str, Any], stamp_ns: int, frame_id: str) -> Skeleton:
    (cloud,) = points.values()
    change = stream.push(cloud, stamp_ns=stamp_ns, frame_id=frame_id)
    unused = change.figures.get("dropped")
    if unused is not None:
        raise InputError(
            "the frame was not used",
            received=str(unused),
            remedy="the scene is as it was; reset begins a new one",
        )
    whole = stream.skeleton()
    return replace(whole, header=change.header)


def settings_of(graph: Graph) -> dict[str, Any]:
    """Return every setting of a graph by its full name, places as text."""
    held: dict[str, Any] = {
        f"{name}.{key}": str(value) if isinstance(value, Path) else value
        for name, stage in graph.stages.items()
        for key, value in stage.settings
    }
    held.update(
        (f"sources.{name}.nonfinite", source.nonfinite)
        for name, source in graph.spec.sources.items()
    )
    return held


def describe(name: str, graph: Graph) -> str:
    """Return what a setting means, for those who list them."""
    stage, _, key = name.partition(".")
    if stage == "sources":
        return f"What is done with NaN and infinity: {' or '.join(NONFINITE)}."
    return graph.stages[stage].Settings.model_fields[key].description or ""


def is_place(name: str, graph: Graph) -> bool:
    """Return whether a setting is a path: those are not for remote hands."""
    stage, _, key = name.partition(".")
    return stage in graph.stages and isinstance(getattr(graph.stages[stage].settings, key), Path)
