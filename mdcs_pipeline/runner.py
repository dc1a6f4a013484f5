"""The runner: which stage fires when, for any graph of any stages."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, get_origin

from mdcs_pipeline.checks import SOURCES, Edge, Ports, type_name
from mdcs_pipeline.errors import InputError, MdcsError, StageError, suggestion
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.hooks import Hook, StageEvent, figures_of, notify
from mdcs_pipeline.stage import Port, Stage


@dataclass(frozen=True, eq=False)
class RunRecord:
    """What one run gave and what it took.

    Parameters
    ----------
    results : dict
        By the names under ``results`` of the YAML.
    rounds : dict of int
        Values that each feedback edge carried, by ``stage.port -> stage.port``.
    exhausted : tuple of str
        Feedback edges whose bound was used up while they had more to carry.
    firings : dict of int
        How often each stage fired, in the graph's order.
    seconds : dict of float
        Time that each stage took, in the graph's order.
    """

    results: dict[str, Any]
    rounds: dict[str, int]
    exhausted: tuple[str, ...]
    firings: dict[str, int]
    seconds: dict[str, float]


@dataclass
class _Desk:
    """What lies at one stage's inputs: the latest value from each edge's port."""

    ports: Ports
    slots: dict[str, list[Any]]
    fresh: bool

    def ready(self) -> bool:
        waiting = (s for n, s in self.slots.items() if not self.ports.inputs[n].optional)
        return self.fresh and all(value is not None for slot in waiting for value in slot)

    def take(self) -> dict[str, Any]:
        self.fresh = False
        many = {name for name, port in self.ports.inputs.items() if port.many}
        # Empty optional ports are passed as None: they need not have a default.
        return {n: tuple(slot) if n in many else slot[0] for n, slot in self.slots.items()}


@dataclass
class _Frame:
    """All that one run changes."""

    desks: dict[str, _Desk]
    rounds: dict[str, int]
    firings: dict[str, int]
    seconds: dict[str, float]
    latest: dict[tuple[str, str], Any] = field(default_factory=dict)
    exhausted: list[str] = field(default_factory=list)


class Runner:
    """Runs a graph, one frame after another.

    Each input port holds its latest value. A stage is ready when all its required ports
    hold one and any is new since it last fired; one without inputs is ready once. The
    first ready stage in the graph's order fires, so a value that was fed back starts its
    loop again before anything below the loop goes on.

    Parameters
    ----------
    graph : Graph
    hooks : sequence of Hook, optional
    """

    def __init__(self, graph: Graph, hooks: Sequence[Hook] = ()) -> None:
        self.graph = graph
        self.hooks = tuple(hooks)
        self.states: dict[type[Any], Any] = {}
        self.reset()
        self._leads = {
            (origin, port): [e for e in graph.edges if (e.origin, e.output.name) == (origin, port)]
            for origin, port in {(e.origin, e.output.name) for e in graph.edges}
        }

    def reset(self) -> None:
        """Begin anew: the stages forget all frames so far."""
        kinds = [stage.State for stage in self.graph.stages.values() if stage.State is not None]
        self.states = {kind: kind() for kind in kinds}

    def run(self, inputs: Mapping[str, Any] | None = None) -> RunRecord:
        """Run one frame.

        Parameters
        ----------
        inputs : mapping
            A `PointCloud` for each source of the graph.

        Returns
        -------
        RunRecord

        Raises
        ------
        InputError
            If a source is missing or unknown.
        StageError
            If a stage fails, or a result does not come about.
        MdcsError
            As stages raise it, with the stage's name and place put in front.
        """
        given = dict(inputs or {})
        check_sources(given, self.graph)
        notify(self.hooks, "run_started", self.graph)
        frame = self._frame()
        for source, value in given.items():
            self._put(f"{SOURCES}.{source}", source, value, frame)
        while (name := self._next(frame)) is not None:
            self._fire(name, frame)
        record = RunRecord(
            results={key: self._result(key, frame) for key in self.graph.spec.results},
            rounds=frame.rounds,
            exhausted=tuple(frame.exhausted),
            firings=frame.firings,
            seconds=frame.seconds,
        )
        notify(self.hooks, "run_finished", record)
        return record

    def _frame(self) -> _Frame:
        graph = self.graph
        desks = {}
        for name, stage in graph.spec.stages.items():
            ports = graph.ports[name]
            slots = {n: [None] * max(len(stage.inputs.get(n, ())), 1) for n in ports.inputs}
            desks[name] = _Desk(ports, slots, fresh=not ports.inputs)
        return _Frame(
            desks=desks,
            rounds={edge.name: 0 for edge in graph.edges if edge.feedback},
            firings=dict.fromkeys(graph.order, 0),
            seconds=dict.fromkeys(graph.order, 0.0),
        )

    def _next(self, frame: _Frame) -> str | None:
        return next((name for name in self.graph.order if frame.desks[name].ready()), None)

    def _fire(self, name: str, frame: _Frame) -> None:
        inputs = frame.desks[name].take()
        frame.firings[name] += 1
        notify(self.hooks, "stage_started", name, frame.firings[name])
        began = time.perf_counter()
        outputs = self._call(name, inputs)
        seconds = time.perf_counter() - began
        frame.seconds[name] += seconds
        for port, value in outputs.items():
            self._put(name, port, value, frame)
        if self.hooks:
            event = StageEvent(name, frame.firings[name], seconds, figures_of(outputs))
            notify(self.hooks, "stage_finished", event)

    def _call(self, name: str, inputs: dict[str, Any]) -> dict[str, Any]:
        where = f"stage '{name}' ({self.graph.spec.stages[name].place})"
        try:
            returned = self._invoke(self.graph.stages[name], inputs)
        except MdcsError as error:
            raise error.located(where) from error
        except Exception as error:
            raise StageError(
                f"the stage failed with {type(error).__name__}",
                where=where,
                received=str(error) or None,
                remedy="this is a fault of the stage; report it with the input that shows it",
            ) from error
        return dict(_checked(returned, self.graph.ports[name].outputs, where))

    def _invoke(self, stage: Stage[Any], inputs: dict[str, Any]) -> Any:
        return (
            stage(**inputs)
            if stage.State is None
            else stage(**inputs, state=self.states[stage.State])
        )

    def _put(self, origin: str, port: str, value: Any, frame: _Frame) -> None:
        if value is None:
            return
        frame.latest[origin, port] = value
        for edge in self._leads.get((origin, port), ()):
            if edge.feedback and not _within_bound(edge, frame):
                continue
            desk = frame.desks[edge.target]
            desk.slots[edge.input.name][edge.slot] = value
            desk.fresh = True

    def _result(self, name: str, frame: _Frame) -> Any:
        ref = self.graph.spec.results[name]
        key = (str(ref) if ref.stage == SOURCES else ref.stage, ref.port)
        if key in frame.latest:
            return frame.latest[key]
        idle = [stage for stage, count in frame.firings.items() if not count]
        raise StageError(
            f"the result '{name}' did not come about: nothing left {ref}",
            where=str(ref.place),
            received="never fired: " + (", ".join(idle) or "none; an output stayed empty"),
            remedy="see which stage before it gave no output",
        )


def check_sources(given: Mapping[str, Any], graph: Graph) -> None:
    """Raise an `InputError` unless each source of the graph is given, and nothing else."""
    sources = graph.spec.sources
    for name in given:
        if name not in sources:
            raise InputError(
                f"the pipeline '{graph.spec.name}' has no source '{name}'",
                remedy=suggestion(name, sources),
            )
    for name, source in sources.items():
        if given.get(name) is None:
            raise InputError(
                f"nothing was given for the source '{name}'",
                where=str(source.place),
                received=", ".join(given) or None,
                remedy="give points for each source of the pipeline",
            )


def _within_bound(edge: Edge, frame: _Frame) -> bool:
    if frame.rounds[edge.name] == edge.max_rounds:
        if edge.name not in frame.exhausted:
            frame.exhausted.append(edge.name)
        return False
    frame.rounds[edge.name] += 1
    return True


def _checked(returned: Any, ports: Mapping[str, Port], where: str) -> Iterator[tuple[str, Any]]:
    """Yield what a stage gave on each output port, if it is what the port declares."""
    if ports and getattr(returned, "_fields", None) != tuple(ports):
        raise StageError(
            "the stage did not return its result",
            where=where,
            received=type(returned).__name__,
            remedy=f"return a NamedTuple with the fields {', '.join(ports)}",
        )
    for name, port in ports.items():
        value = getattr(returned, name)
        if value is not None and not isinstance(value, get_origin(port.type) or port.type):
            raise StageError(
                f"the output '{name}: {type_name(port)}' has another type",
                where=where,
                received=type(value).__name__,
            )
        yield name, value
