"""A frame again, with another ε: of one cloud, or of all that a stream had taken by then."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from mdcs_pipeline import frames
from mdcs_pipeline.graph import Graph, build_graph
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.overrides import override_spec
from mdcs_pipeline.pipeline import Pipeline
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.stream import Stream
from mdcs_pipeline.viewer.film import Dial, Frame

SETTING = "epsilon"
NAME = "ε"
# The dial's ends, as multiples of where it stands.
_REACH = 4.0


def epsilons(graph: Graph) -> dict[str, float]:
    """Return every setting ``stage.epsilon`` of a graph with its value, in the graph's order."""
    return {
        f"{name}.{SETTING}": float(getattr(graph.stages[name].settings, SETTING))
        for name in graph.order
        if SETTING in type(graph.stages[name]).Settings.model_fields
    }


def epsilon_dial(graph: Graph) -> Dial | None:
    """Return the dial for the first ε of a graph; None if it has none."""
    values = epsilons(graph)
    if not values:
        return None
    value = next(iter(values.values()))
    return Dial(NAME, value, value / _REACH, value * _REACH)


def with_epsilon(graph: Graph, value: float) -> Graph:
    """Return the graph with `value` as its first ε, and all others in proportion.

    Raises
    ------
    ConfigError
        If a stage refuses it.
    """
    values = epsilons(graph)
    ratio = value / next(iter(values.values()))
    scaled = {key: held * ratio for key, held in values.items()}
    # The first as it was asked for, not a rounding of it.
    scaled[next(iter(values))] = value
    return build_graph(override_spec(graph.spec, scaled))


def remaker(
    graph: Graph,
    result: str,
    frame: Frame,
    read: Callable[[Graph], Mapping[str, PointCloud]],
) -> Callable[[float], Frame]:
    """Return what makes `frame` again from a value of the dial.

    Parameters
    ----------
    graph : Graph
    result : str
        Name of the skeleton among its results.
    frame : Frame
        Whose label and cloud are kept; the page needs no cloud here, it has its own.
    read : callable
        Brings the clouds of the graph's sources; called anew each time, so that the
        clouds of a long sequence need not stay in memory.
    """

    def again(value: float) -> Frame:
        turned = with_epsilon(graph, value)
        with Pipeline(turned) as pipe:
            record = pipe.run(**read(turned))
        return replace(frame, skeleton=record.results[result], settings=turned.settings())

    return again


def replayer(
    graph: Graph,
    frame: Frame,
    taken: Callable[[], Iterable[frames.Frame]],
    flushed: bool = False,
) -> Callable[[float], Frame]:
    """Return what makes a frame of a stream again from a value of the dial.

    The stream runs anew, from its first frame to this one: what a node is depends on all
    that came before.

    Parameters
    ----------
    graph : Graph
        Of a streaming pipeline.
    frame : Frame
        Whose label and cloud are kept; the page needs no cloud here, it has its own.
    taken : callable
        Brings the frames that the stream had taken by then; called anew each time.
    flushed : bool
        The frame shows what a flush left.
    """

    def again(value: float) -> Frame:
        turned = with_epsilon(graph, value)
        stream = Stream(turned, unusable="drop")
        for held in taken():
            stream.push(held.points, stamp_ns=held.stamp_ns, frame_id=held.frame_id, pose=held.pose)
        if flushed:
            stream.flush()
        seconds = {} if stream.last is None else stream.last.seconds
        skeleton = timed(stream.skeleton(), seconds)
        return replace(frame, skeleton=skeleton, settings=turned.settings())

    return again


def timed(skeleton: Skeleton, seconds: Mapping[str, float]) -> Skeleton:
    """Return a scene's skeleton with the time that each stage took for its latest frame."""
    return replace(skeleton, diagnostics={**skeleton.diagnostics, "seconds": dict(seconds)})
