"""Which process runs which stages of a graph, and what they have to tell each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mdcs_pipeline.checks import SOURCES, find_output
from mdcs_pipeline.errors import ConfigError, InputError, suggestion
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.messages import PointCloud

Channel = tuple[str, str]


@dataclass(frozen=True, eq=False)
class Layout:
    """The hosts of a graph.

    Parameters
    ----------
    graph : Graph
    hosts : tuple of str
        In the order in which the graph's order meets them.
    entry : str
        Where frames begin: the host of the first stage that takes a source.
    exit : str
        Where results come together: the host of the stage that gives the first of them.
    """

    graph: Graph
    hosts: tuple[str, ...]
    entry: str
    exit: str

    def host(self, stage: str) -> str:
        """Return the host of a stage; that of a source is the entry."""
        if stage.startswith(SOURCES + "."):
            return self.entry
        return self.graph.spec.stages[stage].host

    def stages(self, host: str) -> tuple[str, ...]:
        """Return the stages of a host, in the graph's order."""
        return tuple(name for name in self.graph.order if self.host(name) == host)

    def readers(self) -> dict[Channel, set[str]]:
        """Return, for each output that another host needs, who that is."""
        found: dict[Channel, set[str]] = {}
        for edge in self.graph.edges:
            found.setdefault((edge.origin, edge.output.name), set()).add(self.host(edge.target))
        for ref in self.graph.spec.results.values():
            origin = str(ref) if ref.stage == SOURCES else ref.stage
            found.setdefault((origin, ref.port), set()).add(self.exit)
        others = {channel: held - {self.host(channel[0])} for channel, held in found.items()}
        return {channel: held for channel, held in others.items() if held}

    def spoken(self, host: str) -> list[Channel]:
        """Return the outputs of a host that others need."""
        return [channel for channel in self.readers() if self.host(channel[0]) == host]

    def heard(self, host: str) -> list[Channel]:
        """Return the outputs of others that a host needs."""
        return [channel for channel, hosts in self.readers().items() if host in hosts]

    def message_type(self, channel: Channel) -> type[Any]:
        """Return the type of the messages of a channel.

        Raises
        ------
        InputError
            If the graph has no such output.
        """
        origin, port = channel
        source = origin.removeprefix(SOURCES + ".")
        if origin != source and source == port and port in self.graph.spec.sources:
            return PointCloud
        if origin not in self.graph.ports or port not in self.graph.ports[origin].outputs:
            raise InputError("the graph has no such output", received=f"{origin}.{port}")
        kind: type[Any] = self.graph.ports[origin].outputs[port].type
        return kind


def layout_of(graph: Graph) -> Layout:
    """Return the hosts of a graph.

    Raises
    ------
    ConfigError
        If the graph has no result, so that nothing would come out anywhere.
    """
    spec = graph.spec
    if not spec.results:
        raise ConfigError(
            "a graph that is cut needs a result",
            where=spec.file,
            remedy="name an output under 'results'",
        )
    remembers = [name for name, stage in graph.stages.items() if stage.State is not None]
    if remembers:
        raise ConfigError(
            "a graph that remembers frames runs in one process",
            where=spec.file,
            received="stages with a state: " + ", ".join(remembers),
            remedy="run it without --host",
        )
    hosts = tuple(dict.fromkeys(spec.stages[name].host for name in graph.order))
    taking = [
        name
        for name in graph.order
        if any(edge.target == name and edge.origin.startswith(SOURCES) for edge in graph.edges)
    ]
    entry = spec.stages[(taking or list(graph.order))[0]].host
    ref = next(iter(spec.results.values()))
    origin, _ = find_output(ref, spec, graph.ports, str(ref.place))
    leaves = spec.stages[origin].host if origin in spec.stages else entry
    return Layout(graph, hosts, entry, leaves)


def check_host(layout: Layout, host: str) -> None:
    """Raise a `ConfigError` unless some stage names this host."""
    if host not in layout.hosts:
        raise ConfigError(
            f"no stage of '{layout.graph.spec.name}' is on the host '{host}'",
            where=layout.graph.spec.file,
            remedy=suggestion(host, layout.hosts),
        )
