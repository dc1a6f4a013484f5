"""The state of one run of a graph: what lies where, and which stage is next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mdcs_pipeline.checks import SOURCES, Edge, Ports
from mdcs_pipeline.errors import StageError
from mdcs_pipeline.graph import Graph

Leads = Mapping[tuple[str, str], list[Edge]]


class _Away:
    """Stands for a value that is held by another process."""

    def __repr__(self) -> str:
        return "AWAY"


AWAY = _Away()


@dataclass(frozen=True, eq=False)
class Token:
    """A value on its way, and which one it is.

    Parameters
    ----------
    origin : str
        Stage, or ``sources.name``.
    port : str
    version : int
        Running number of the values that left this port in this run, from 1.
    value : object
        `AWAY` where another process holds it.
    """

    origin: str
    port: str
    version: int
    value: Any = AWAY

    @property
    def key(self) -> tuple[str, str, int]:
        """What names the value within its run."""
        return self.origin, self.port, self.version


@dataclass
class Desk:
    """What lies at one stage's inputs: the latest token from each edge's port."""

    ports: Ports
    slots: dict[str, list[Token | None]]
    fresh: bool

    def ready(self) -> bool:
        """Return whether each required port holds a value and any is new."""
        waiting = (s for n, s in self.slots.items() if not self.ports.inputs[n].optional)
        return self.fresh and all(token is not None for slot in waiting for token in slot)

    def tokens(self) -> list[Token]:
        """Return all that lies here."""
        return [token for slot in self.slots.values() for token in slot if token is not None]

    def take(self) -> dict[str, Any]:
        """Return the arguments of the stage's call; what lies here is no longer new."""
        self.fresh = False
        many = {name for name, port in self.ports.inputs.items() if port.many}
        # Empty optional ports are passed as None: they need not have a default.
        values = {n: [t and t.value for t in slot] for n, slot in self.slots.items()}
        return {n: tuple(held) if n in many else held[0] for n, held in values.items()}


@dataclass
class RunState:
    """All that one run changes.

    Parameters
    ----------
    graph : Graph
    leads : mapping
        From `leads_of`.
    notes : dict
        What whoever began the run wants to find at its end.
    """

    graph: Graph
    leads: Leads
    desks: dict[str, Desk] = field(init=False)
    rounds: dict[str, int] = field(init=False)
    firings: dict[str, int] = field(init=False)
    seconds: dict[str, float] = field(init=False)
    latest: dict[tuple[str, str], Token] = field(default_factory=dict)
    exhausted: list[str] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        graph = self.graph
        self.desks = {}
        for name, stage in graph.spec.stages.items():
            ports = graph.ports[name]
            slots: dict[str, list[Token | None]] = {
                n: [None] * max(len(stage.inputs.get(n, ())), 1) for n in ports.inputs
            }
            self.desks[name] = Desk(ports, slots, fresh=not ports.inputs)
        self.rounds = {edge.name: 0 for edge in graph.edges if edge.feedback}
        self.firings = dict.fromkeys(graph.order, 0)
        self.seconds = dict.fromkeys(graph.order, 0.0)

    def next(self) -> str | None:
        """Return the stage to fire: the first ready one in the graph's order."""
        return next((name for name in self.graph.order if self.desks[name].ready()), None)

    def take(self, name: str) -> dict[str, Any]:
        """Return the arguments of a stage, and count its firing."""
        self.firings[name] += 1
        return self.desks[name].take()

    def put(self, origin: str, port: str, value: Any) -> Token | None:
        """Lay a value at each input that its port leads to; None is no value."""
        if value is None:
            return None
        before = self.latest.get((origin, port))
        token = Token(origin, port, before.version + 1 if before else 1, value)
        self.latest[origin, port] = token
        for edge in self.leads.get((origin, port), ()):
            if edge.feedback and not self._within_bound(edge):
                continue
            desk = self.desks[edge.target]
            desk.slots[edge.input.name][edge.slot] = token
            desk.fresh = True
        return token

    def result(self, name: str) -> Token:
        """Return what came out under a name of the YAML's results.

        Raises
        ------
        StageError
            If nothing did.
        """
        ref = self.graph.spec.results[name]
        key = (str(ref) if ref.stage == SOURCES else ref.stage, ref.port)
        if key in self.latest:
            return self.latest[key]
        idle = [stage for stage, count in self.firings.items() if not count]
        raise StageError(
            f"the result '{name}' did not come about: nothing left {ref}",
            where=str(ref.place),
            received="never fired: " + (", ".join(idle) or "none; an output stayed empty"),
            remedy="see which stage before it gave no output",
        )

    def _within_bound(self, edge: Edge) -> bool:
        if self.rounds[edge.name] == edge.max_rounds:
            if edge.name not in self.exhausted:
                self.exhausted.append(edge.name)
            return False
        self.rounds[edge.name] += 1
        return True


def leads_of(graph: Graph) -> Leads:
    """Return the edges of a graph by the output that they leave."""
    leads: dict[tuple[str, str], list[Edge]] = {}
    for edge in graph.edges:
        leads.setdefault((edge.origin, edge.output.name), []).append(edge)
    return leads
