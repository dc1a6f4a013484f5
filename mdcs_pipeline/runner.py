"""The runner: which stage fires when, for any graph of any stages."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_origin

from mdcs_pipeline.checks import SOURCES, type_name
from mdcs_pipeline.errors import InputError, MdcsError, StageError, suggestion
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.hooks import Hook, StageEvent, figures_of, notify
from mdcs_pipeline.kernels.workers import threads
from mdcs_pipeline.run_state import RunState, Token, leads_of
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
        self._leads = leads_of(graph)

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
        frame = self.frame()
        for source, value in given.items():
            frame.put(f"{SOURCES}.{source}", source, value)
        while (name := frame.next()) is not None:
            self.fire(name, frame)
        record = record_of(frame, {key: frame.result(key).value for key in self.graph.spec.results})
        notify(self.hooks, "run_finished", record)
        return record

    def frame(self) -> RunState:
        """Return the state of a run that is to begin."""
        return RunState(self.graph, self._leads)

    def fire(self, name: str, frame: RunState) -> list[Token]:
        """Fire one stage, lay its outputs where they lead, and return them."""
        inputs = frame.take(name)
        notify(self.hooks, "stage_started", name, frame.firings[name])
        began = time.perf_counter()
        outputs = self._call(name, inputs)
        seconds = time.perf_counter() - began
        frame.seconds[name] += seconds
        put = [frame.put(name, port, value) for port, value in outputs.items()]
        if self.hooks:
            event = StageEvent(name, frame.firings[name], seconds, figures_of(outputs))
            notify(self.hooks, "stage_finished", event)
        return [token for token in put if token is not None]

    def _call(self, name: str, inputs: dict[str, Any]) -> dict[str, Any]:
        where = f"stage '{name}' ({self.graph.spec.stages[name].place})"
        try:
            returned = self._invoke(self.graph.stages[name], inputs)
        except MdcsError as error:
            raise error.located(where) from error
        except Exception as error:
            if _interrupted(error):
                raise KeyboardInterrupt from error
            raise StageError(
                f"the stage failed with {type(error).__name__}",
                where=where,
                received=str(error) or None,
                remedy="this is a fault of the stage; report it with the input that shows it",
            ) from error
        return dict(_checked(returned, self.graph.ports[name].outputs, where))

    def _invoke(self, stage: Stage[Any], inputs: dict[str, Any]) -> Any:
        state = {} if stage.State is None else {"state": self.states[stage.State]}
        with threads(self.graph.spec.threads):
            return stage(**inputs, **state)


def record_of(frame: RunState, results: dict[str, Any]) -> RunRecord:
    """Return the record of a run that has ended."""
    return RunRecord(
        results=results,
        rounds=frame.rounds,
        exhausted=tuple(frame.exhausted),
        firings=frame.firings,
        seconds=frame.seconds,
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


def _interrupted(error: BaseException | None) -> bool:
    """Return whether Ctrl-C is behind a SystemError: compiled code that it meets raises that."""
    told = isinstance(error, SystemError)
    while told and error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return told and error is not None
