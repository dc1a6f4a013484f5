"""What must hold of a pipeline before it runs, one function a rule."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, get_origin

from mdcs_pipeline.document import Place
from mdcs_pipeline.errors import ConfigError, suggestion
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.spec import PipelineSpec, Ref, StageSpec
from mdcs_pipeline.stage import Port

if TYPE_CHECKING:
    import networkx as nx

SOURCES = "sources"


class Ports(NamedTuple):
    """Input and output ports of one stage, by name."""

    inputs: dict[str, Port]
    outputs: dict[str, Port]


@dataclass(frozen=True)
class Edge:
    """A connection from an output to an input.

    Parameters
    ----------
    origin : str
        Stage, or ``sources.name`` for a source.
    output : Port
    target : str
        Stage.
    input : Port
    place : Place
    max_rounds : int, optional
        Of a feedback edge; None marks a forward one.
    slot : int
        Position among the outputs that the input collects.
    """

    origin: str
    output: Port
    target: str
    input: Port
    place: Place
    max_rounds: int | None = None
    slot: int = 0

    @property
    def feedback(self) -> bool:
        """Whether the edge leads back."""
        return self.max_rounds is not None

    @property
    def name(self) -> str:
        """``stage.port -> stage.port``."""
        start = self.origin if is_source(self.origin) else f"{self.origin}.{self.output.name}"
        return f"{start} -> {self.target}.{self.input.name}"


def is_source(node: str) -> bool:
    """Return whether a node of the network is a source."""
    return node.startswith(SOURCES + ".")


def type_name(port: Port) -> str:
    """Return the name of a port's message type, as a reader would write it."""
    name = getattr(port.type, "__name__", str(port.type))
    name = f"tuple[{name}, ...]" if port.many else name
    return f"{name} | None" if port.optional else name


def where(place: Place, stage: str, port: str | None = None) -> str:
    """Return file, line, stage and port as errors name them."""
    return f"{place}, stage '{stage}'" + (f", port '{port}'" if port else "")


def connect(spec: PipelineSpec, ports: Mapping[str, Ports]) -> tuple[Edge, ...]:
    """Return all edges, forward and feedback; unknown stages and ports are errors."""
    edges = []
    for stage in spec.stages.values():
        for name, refs in stage.inputs.items():
            for slot, ref in enumerate(refs):
                target = _input(stage, name, ref.place, ports)
                origin, output = find_output(ref, spec, ports, where(ref.place, stage.name, name))
                edges.append(Edge(origin, output, stage.name, target, ref.place, slot=slot))
        for name, backs in stage.feedback.items():
            for back in backs:
                place = back.place
                target = _input(stage, name, place, ports)
                at = where(place, stage.name, name)
                origin, output = find_output(back.origin, spec, ports, at)
                rounds = _bound(back.max_rounds, back.origin, at)
                edges.append(Edge(origin, output, stage.name, target, place, rounds))
    return tuple(edges)


def _input(stage: StageSpec, name: str, place: Place, ports: Mapping[str, Ports]) -> Port:
    inputs = ports[stage.name].inputs
    if name not in inputs:
        raise ConfigError(
            f"stage '{stage.stage}' has no input port '{name}'",
            where=where(place, stage.name),
            remedy=suggestion(name, inputs),
        )
    return inputs[name]


def find_output(
    ref: Ref, spec: PipelineSpec, ports: Mapping[str, Ports], at: str
) -> tuple[str, Port]:
    """Return the node and the output port that `ref` names, or raise a `ConfigError`."""
    if ref.stage == SOURCES:
        if ref.port not in spec.sources:
            raise ConfigError(
                f"there is no source '{ref.port}'",
                where=at,
                received=str(ref),
                remedy=suggestion(ref.port, spec.sources),
            )
        return str(ref), Port(ref.port, PointCloud)
    if ref.stage not in ports:
        raise ConfigError(
            f"there is no stage '{ref.stage}'",
            where=at,
            received=str(ref),
            remedy=suggestion(ref.stage, [*ports, *([SOURCES] if spec.sources else [])]),
        )
    outputs = ports[ref.stage].outputs
    if ref.port not in outputs:
        raise ConfigError(
            f"stage '{ref.stage}' has no output port '{ref.port}'",
            where=at,
            received=str(ref),
            remedy=suggestion(ref.port, outputs),
        )
    return ref.stage, outputs[ref.port]


def _bound(rounds: int | None, origin: Ref, at: str) -> int:
    if rounds is None or rounds < 1:
        fault = "has no bound" if rounds is None else "must carry at least one value"
        raise ConfigError(
            f"the feedback from {origin} {fault}",
            where=at,
            received=rounds,
            remedy="add 'max_rounds', an integer of at least 1",
        )
    return rounds


def check_inputs(spec: PipelineSpec, ports: Mapping[str, Ports]) -> None:
    """Each required input is fed forward, and none that takes one value is fed twice."""
    for stage in spec.stages.values():
        inputs = ports[stage.name].inputs
        for name, port in inputs.items():
            _check_input(stage, port, len(stage.inputs.get(name, ())))
        if inputs and not any(stage.inputs.get(name) for name in inputs):
            raise ConfigError(
                "nothing reaches this stage",
                where=where(stage.place, stage.name),
                remedy=f"feed one of its inputs: {', '.join(inputs)}",
            )


def _check_input(stage: StageSpec, port: Port, count: int) -> None:
    back = stage.feedback.get(port.name, ())
    at = where(stage.place, stage.name, port.name)
    if not count and not port.optional:
        late = [f"; feedback from {item.origin} comes too late" for item in back[:1]]
        raise ConfigError(
            "".join([f"the required input '{port.name}: {type_name(port)}' is not fed", *late]),
            where=at,
            remedy=f"add '{port.name}: stage.port' under its inputs",
        )
    if port.many and back:
        raise ConfigError(
            f"the input '{port.name}' collects, so nothing can be fed back to it",
            where=where(back[0].place, stage.name, port.name),
            received=str(back[0].origin),
        )
    if count > 1 and not port.many:
        refs = ", ".join(str(ref) for ref in stage.inputs[port.name])
        raise ConfigError(
            f"the input '{port.name}: {type_name(port)}' is fed {count} times and takes one",
            where=where(stage.inputs[port.name][1].place, stage.name, port.name),
            received=refs,
            remedy="keep one of them, or join them in a stage before",
        )
    origins = [str(item.origin) for item in back]
    if len(set(origins)) < len(origins):
        raise ConfigError(
            "a feedback edge stands twice",
            where=where(back[-1].place, stage.name, port.name),
            received=", ".join(origins),
            remedy="keep one of them",
        )


def check_types(edges: Iterable[Edge]) -> None:
    """Each output gives what its input takes."""
    for edge in edges:
        # A parametrised type such as list[int] is compared by its origin.
        given: Any = get_origin(edge.output.type) or edge.output.type
        taken: Any = get_origin(edge.input.type) or edge.input.type
        if edge.output.many or not issubclass(given, taken):
            raise ConfigError(
                f"{edge.name}: types do not fit",
                where=where(edge.place, edge.target, edge.input.name),
                received=f"{edge.origin} gives '{edge.output.name}: {type_name(edge.output)}', "
                f"{edge.target} takes '{edge.input.name}: {type_name(edge.input)}'",
                remedy=f"connect an output of type {edge.input.type.__name__}",
            )


def check_cycles(forward: nx.DiGraph[str], edges: Iterable[Edge]) -> None:
    """Forward edges form no cycle."""
    import networkx as nx

    try:
        found = nx.find_cycle(forward)
    except nx.NetworkXNoCycle:
        return
    last = found[-1]
    edge = next(e for e in edges if (e.origin, e.target) == last[:2])
    names = [step[0] for step in found] + [found[0][0]]
    raise ConfigError(
        f"the stages {' -> '.join(names)} form a cycle without a bound",
        where=where(edge.place, edge.target, edge.input.name),
        received=edge.name,
        remedy="move one of these edges from 'inputs' to 'feedback' and give it 'max_rounds'",
    )


def check_loops(forward: nx.DiGraph[str], edges: Iterable[Edge]) -> None:
    """Each feedback edge closes a loop."""
    import networkx as nx

    for edge in edges:
        if edge.feedback and not nx.has_path(forward, edge.target, edge.origin):
            raise ConfigError(
                f"the feedback {edge.name} closes no loop: {edge.origin} does not follow "
                f"from {edge.target}",
                where=where(edge.place, edge.target, edge.input.name),
                remedy="write it under 'inputs', or feed back from a later stage",
            )


def check_ends(
    spec: PipelineSpec, ports: Mapping[str, Ports], network: nx.MultiDiGraph[str]
) -> None:
    """Something leaves the graph, and each stage and source has a part in it."""
    import networkx as nx

    ends = {str(r) if r.stage == SOURCES else r.stage for r in spec.results.values()}
    ends |= {name for name, held in ports.items() if not held.outputs}
    if not ends:
        raise ConfigError(
            "nothing leaves the pipeline",
            where=spec.file,
            remedy="name an output under 'results', or add a stage such as write",
        )
    useful = ends.union(*(nx.ancestors(network, end) for end in ends))
    for stage in spec.stages.values():
        if stage.name not in useful:
            raise ConfigError(
                "this stage leads to no result",
                where=where(stage.place, stage.name),
                received="outputs " + ", ".join(ports[stage.name].outputs),
                remedy="connect one of its outputs, name it under 'results', or remove the stage",
            )
    for source in spec.sources.values():
        if f"{SOURCES}.{source.name}" not in useful:
            raise ConfigError(
                f"the source '{source.name}' leads nowhere",
                where=str(source.place),
                remedy=f"feed {SOURCES}.{source.name} to a stage, or remove it",
            )
