"""The front door: points in, skeleton out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import InputError, StageError
from mdcs_pipeline.graph import Graph, build_graph
from mdcs_pipeline.header import Header
from mdcs_pipeline.hooks import Hook
from mdcs_pipeline.ingest import as_point_cloud
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.runner import Runner, RunRecord, check_sources
from mdcs_pipeline.skeleton import Skeleton

RESULT = "skeleton"


class Pipeline:
    """A graph that takes one frame of points after another.

    Parameters
    ----------
    graph : Graph
    hooks : sequence of Hook, optional
        What watches its runs.

    Attributes
    ----------
    graph : Graph
    last : RunRecord or None
        Record of the latest run.
    """

    def __init__(self, graph: Graph, hooks: Sequence[Hook] = ()) -> None:
        self.graph = graph
        self.last: RunRecord | None = None
        self._runner = Runner(graph, hooks)
        self._pushes = 0
        self._closed = False

    @classmethod
    def from_config(
        cls, config: str | Path = "default", hooks: Sequence[Hook] = (), **settings: Any
    ) -> Pipeline:
        """Return the pipeline that a configuration describes.

        Parameters
        ----------
        config : str or Path
            Name of a shipped configuration, or path of a YAML file.
        hooks : sequence of Hook, optional
        **settings
            Over those of the file: ``transport={"epsilon": 0.002}`` or
            ``**{"transport.epsilon": 0.002}``.

        Raises
        ------
        ConfigError
            If there is no such configuration, stage or setting, or it does not fit.
        """
        return cls(build_graph(load_spec(config, settings)), hooks)

    def __enter__(self) -> Pipeline:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the pipeline; further frames are refused."""
        self._closed = True

    def push(
        self, points: Any = None, *, stamp_ns: int = 0, frame_id: str = "", **more_sources: Any
    ) -> Skeleton:
        """Run one frame and return its skeleton.

        Parameters
        ----------
        points : (N, 3) array-like, Open3D cloud or PointCloud
            For the only source. With several sources, a dict by their names, or give
            them as keywords.
        stamp_ns : int
            Time of measurement in nanoseconds.
        frame_id : str
            Name of the coordinate frame.
        **more_sources
            Points by the name of the source.

        Returns
        -------
        Skeleton
            The result called ``skeleton``, or the only one. Its diagnostics gain
            ``rounds`` and ``exhausted`` (see `RunRecord`), ``dropped`` (points left out on
            the way in) and, apart from these because they differ from run to run,
            ``seconds`` of each stage.

        Raises
        ------
        InputError
            If the points cannot be used, or the pipeline is closed.
        StageError
            If a stage fails, or the graph has no such result.
        """
        result = result_name(self.graph)
        given = {**self._by_source(points), **more_sources}
        record = self._run(given, Header(frame_id, stamp_ns, self._pushes))
        skeleton: Skeleton = record.results[result]
        return skeleton

    def run(self, **sources: Any) -> RunRecord:
        """Run one frame and return all that came of it.

        Parameters
        ----------
        **sources
            Points by the name of the source, as in `push`.

        Returns
        -------
        RunRecord

        Raises
        ------
        InputError, StageError
            As in `push`.
        """
        return self._run(sources, Header(seq=self._pushes))

    def _by_source(self, points: Any) -> dict[str, Any]:
        sources = list(self.graph.spec.sources)
        if points is None:
            return {}
        if isinstance(points, Mapping):
            return dict(points)
        if len(sources) == 1:
            return {sources[0]: points}
        raise InputError(
            f"the pipeline '{self.graph.spec.name}' has {len(sources)} sources",
            received=type(points).__name__,
            remedy=f"give each by its name: {', '.join(sources)}"
            if sources
            else "it takes its points from elsewhere; give none",
        )

    def _run(self, given: Mapping[str, Any], header: Header) -> RunRecord:
        if self._closed:
            raise InputError("the pipeline is closed", remedy="make a new one")
        check_sources(given, self.graph)
        clouds = {name: self._cloud(name, points, header) for name, points in given.items()}
        record = self._runner.run(clouds)
        dropped = sum(cloud.dropped for cloud in clouds.values())
        results = {k: recorded(v, record, dropped) for k, v in record.results.items()}
        self.last = replace(record, results=results)
        self._pushes += 1
        return self.last

    def _cloud(self, name: str, points: Any, header: Header) -> PointCloud:
        try:
            return as_point_cloud(points, header, self.graph.spec.sources[name].nonfinite)
        except InputError as error:
            raise error.located(f"source '{name}'") from error


def result_name(graph: Graph) -> str:
    """Return the name of the result that is the pipeline's skeleton.

    Raises
    ------
    StageError
        If none is called so and there are several.
    """
    results = graph.spec.results
    if RESULT in results or len(results) == 1:
        return RESULT if RESULT in results else next(iter(results))
    raise StageError(
        f"the pipeline '{graph.spec.name}' has no result called '{RESULT}'",
        received=", ".join(results) or "no results",
        remedy="take the results of run(), or call one of them skeleton",
    )


def recorded(result: Any, record: RunRecord, dropped: int) -> Any:
    """Return a result with what its run says of it in the diagnostics, if it is a skeleton."""
    if not isinstance(result, Skeleton):
        return result
    run = {
        "rounds": dict(record.rounds),
        "exhausted": list(record.exhausted),
        "dropped": dropped,
        "seconds": dict(record.seconds),
    }
    return replace(result, diagnostics={**result.diagnostics, **run})


def skeletonize(points: Any, config: str | Path = "default", **settings: Any) -> Skeleton:
    """Return the curve skeleton of a point cloud.

    Parameters
    ----------
    points : (N, 3) array-like, Open3D legacy or tensor cloud, or PointCloud
        Coordinates in any one unit of length, of any real type; never written to.
    config : str or Path
        Name of a shipped configuration, or path of a YAML file.
    **settings
        Settings of stages: ``transport={"epsilon": 0.002}``, or
        ``**{"transport.epsilon": 0.002}``.

    Returns
    -------
    Skeleton
        In the units and frame of `points`.

    Raises
    ------
    InputError
        If the points cannot be used.
    ConfigError
        If the configuration or a setting is unknown or does not fit.
    StageError
        If a stage fails.

    Examples
    --------
    >>> import mdcs_pipeline as mdcs
    >>> skeleton = mdcs.skeletonize(points)  # doctest: +SKIP
    >>> skeleton.save("skeleton.json")  # doctest: +SKIP
    """
    with Pipeline.from_config(config, **settings) as pipe:
        return pipe.push(points)
