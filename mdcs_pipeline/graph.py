"""The graph: stages and their connections, checked when it is built."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from mdcs_pipeline.checks import (
    SOURCES,
    Edge,
    Ports,
    check_cycles,
    check_ends,
    check_inputs,
    check_loops,
    check_types,
    connect,
    find_output,
    is_source,
    type_name,
    where,
)
from mdcs_pipeline.errors import ConfigError, MdcsError
from mdcs_pipeline.spec import PipelineSpec, StageSpec
from mdcs_pipeline.stage import (
    Stage,
    input_ports,
    output_ports,
    stage_class,
    stage_entries,
    validate_settings,
)

if TYPE_CHECKING:
    import networkx as nx

Registry = Callable[[str], type[Stage[Any]]]


@dataclass(frozen=True, eq=False)
class Graph:
    """A pipeline that fits together.

    Parameters
    ----------
    spec : PipelineSpec
        What it was built from.
    stages : dict of Stage
        By name, in the order of the YAML.
    ports : dict of Ports
        Input and output ports of each stage.
    edges : tuple of Edge
    network : networkx.MultiDiGraph
        Nodes are stages and, as ``sources.name``, sources, with their ``kind``; edges have
        ``output``, ``input``, ``type``, ``feedback`` and ``max_rounds``.
    order : tuple of str
        The stages in a topological order of the forward edges, each loop in one piece.
    """

    spec: PipelineSpec
    stages: dict[str, Stage[Any]]
    ports: dict[str, Ports]
    edges: tuple[Edge, ...]
    network: nx.MultiDiGraph[str]
    order: tuple[str, ...]

    def settings(self) -> dict[str, dict[str, Any]]:
        """Return every setting of every stage as plain values, for the record of a result."""
        return {n: stage.settings.model_dump(mode="json") for n, stage in self.stages.items()}


def build_graph(spec: PipelineSpec, registry: Registry | None = None) -> Graph:
    """Return the graph of a pipeline, or say what does not fit.

    Parameters
    ----------
    spec : PipelineSpec
    registry : callable, optional
        From the registered name of a stage to its class; what is installed when absent.

    Returns
    -------
    Graph

    Raises
    ------
    ConfigError
        With file, line, stage and port, and the nearest right name where one is unknown.
    """
    if not spec.stages:
        raise ConfigError("the pipeline has no stages", where=spec.file)
    known = partial(stage_class, entries=stage_entries()) if registry is None else registry
    stages = {name: _make(stage, known) for name, stage in spec.stages.items()}
    ports = {name: _ports(spec.stages[name], stage) for name, stage in stages.items()}
    edges = connect(spec, ports)
    check_inputs(spec, ports)
    check_types(edges)
    for name, ref in spec.results.items():
        find_output(ref, spec, ports, f"{ref.place}, result '{name}'")
    network = _network(spec, edges)
    forward = _forward(network)
    check_cycles(forward, edges)
    check_loops(forward, edges)
    check_ends(spec, ports, network)
    return Graph(spec, stages, ports, edges, network, firing_order(list(stages), forward, edges))


def _make(spec: StageSpec, registry: Registry) -> Stage[Any]:
    try:
        found = registry(spec.stage)
    except MdcsError as error:
        raise error.located(where(spec.place, spec.name)) from error
    try:
        return found(validate_settings(found, dict(spec.settings)))
    except ConfigError as error:
        place = spec.place
        if isinstance(error.__cause__, ValidationError):
            loc = error.__cause__.errors()[0]["loc"]
            place = spec.setting_places.get(str(loc[0]), place) if loc else place
        raise error.located(where(place, spec.name)) from error


def _ports(spec: StageSpec, stage: Stage[Any]) -> Ports:
    try:
        return Ports(input_ports(type(stage)), output_ports(type(stage)))
    except (MdcsError, NameError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(
            f"the ports of stage '{spec.stage}' cannot be read",
            where=where(spec.place, spec.name),
            received=type(stage).__qualname__,
            remedy=str(error),
        ) from error


def _network(spec: PipelineSpec, edges: Iterable[Edge]) -> nx.MultiDiGraph[str]:
    import networkx as nx

    network: nx.MultiDiGraph[str] = nx.MultiDiGraph()
    network.add_nodes_from((f"{SOURCES}.{name}" for name in spec.sources), kind="source")
    network.add_nodes_from(spec.stages, kind="stage")
    for edge in edges:
        network.add_edge(
            edge.origin,
            edge.target,
            output=edge.output.name,
            input=edge.input.name,
            type=edge.output.type,
            feedback=edge.feedback,
            max_rounds=edge.max_rounds,
        )
    return network


def _forward(network: nx.MultiDiGraph[str]) -> nx.DiGraph[str]:
    import networkx as nx

    forward: nx.DiGraph[str] = nx.DiGraph()
    forward.add_nodes_from(network)
    forward.add_edges_from(
        (origin, target)
        for origin, target, held in network.edges(data=True)
        if not held["feedback"]
    )
    return forward


def firing_order(
    names: Sequence[str], forward: nx.DiGraph[str], edges: Iterable[Edge]
) -> tuple[str, ...]:
    """Return a topological order in which the stages of a loop stand together.

    What follows from a loop without being part of it comes after all of the loop, so
    that it does not fire in each round. Ties go by the order of `names`.
    """
    import networkx as nx

    loops = []
    for edge in edges:
        if edge.feedback:
            needed = nx.ancestors(forward, edge.origin) | {edge.origin}
            body = needed & (nx.descendants(forward, edge.target) | {edge.target})
            loops.append((body, needed))
    loops.sort(key=lambda loop: len(loop[0]))
    order: list[str] = []
    done = {name for name in forward if is_source(name)}
    while len(order) < len(names):
        ready = [n for n in names if n not in done and done.issuperset(forward.pred[n])]
        entered = [needed for body, needed in loops if body & done and body - done]
        inner = ([n for n in ready if n in needed] for needed in entered)
        first = next((held[0] for held in inner if held), ready[0])
        order.append(first)
        done.add(first)
    return tuple(order)


def mermaid(graph: Graph) -> str:
    """Return the graph as a Mermaid flowchart; feedback edges are dashed."""
    ids = {name: f"n{number}" for number, name in enumerate(graph.network)}
    lines = ["flowchart TD"]
    for name in graph.network:
        lines.append(f"  {ids[name]}{_mermaid_box(name, graph)}")
    lines += [f'  r{k}(["{name}"])' for k, name in enumerate(graph.spec.results)]
    for edge in graph.edges:
        start, end = ids[edge.origin], ids[edge.target]
        if edge.feedback:
            lines.append(f'  {start} -. "{edge_label(edge)}" .-> {end}')
        else:
            lines.append(f'  {start} -- "{edge_label(edge)}" --> {end}')
    for k, ref in enumerate(graph.spec.results.values()):
        name, port = find_output(ref, graph.spec, graph.ports, str(ref.place))
        lines.append(f'  {ids[name]} -- "{port.name}: {type_name(port)}" --> r{k}')
    return "\n".join(lines) + "\n"


def _mermaid_box(name: str, graph: Graph) -> str:
    if is_source(name):
        return f'(["{name.partition(".")[2]}"])'
    stage = graph.spec.stages[name].stage
    return f'["{name}"]' if stage == name else f'["{name}<br/><i>{stage}</i>"]'


def edge_label(edge: Edge) -> str:
    """Return ``port: Type`` of an edge, with both ports where their names differ."""
    names = [edge.output.name, edge.input.name]
    ports = names[0] if is_source(edge.origin) or len(set(names)) == 1 else " → ".join(names)
    label = f"{ports}: {edge.input.type.__name__}"
    return f"{label}, at most {edge.max_rounds}" if edge.feedback else label


def draw_graph(graph: Graph, path: str | Path) -> None:
    """Draw the graph, stages from top to bottom and feedback edges dashed.

    Parameters
    ----------
    graph : Graph
    path : str or Path
        ``.svg`` or ``.png``.

    Raises
    ------
    OutputError
        If the suffix is another or the file cannot be written; then no file is left.
    MissingExtraError
        If the extra ``draw`` is not installed.
    """
    from mdcs_pipeline.io.diagram import Arrow, Box, draw_diagram

    ranks = _ranks(graph)
    boxes = [
        Box(name.partition(".")[2], "", ranks[name], "source")
        if is_source(name)
        else Box(name, _note(name, graph), ranks[name], "stage")
        for name in graph.network
    ]
    number = {name: k for k, name in enumerate(graph.network)}
    arrows = [
        Arrow(
            number[e.origin],
            number[e.target],
            # Broken, so that it is no longer than the line that it stands at.
            edge_label(e).replace(" → ", " →\n").replace(", at", "\nat"),
            e.feedback,
        )
        for e in graph.edges
    ]
    for name, ref in graph.spec.results.items():
        node, port = find_output(ref, graph.spec, graph.ports, str(ref.place))
        arrows.append(Arrow(number[node], len(boxes), f"{port.name}: {type_name(port)}", False))
        boxes.append(Box(name, "", ranks[node] + 1, "result"))
    draw_diagram(boxes, arrows, Path(path))


def _note(name: str, graph: Graph) -> str:
    stage = graph.spec.stages[name].stage
    return "" if stage == name else stage


def _ranks(graph: Graph) -> Mapping[str, int]:
    import networkx as nx

    layers = nx.topological_generations(_forward(graph.network))
    return {name: rank for rank, layer in enumerate(layers) for name in layer}
