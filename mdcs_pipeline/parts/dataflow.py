"""A cut graph as a dora dataflow: one dora node a host."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from mdcs_pipeline.checks import SOURCES
from mdcs_pipeline.errors import ConfigError, InputError, suggestion
from mdcs_pipeline.parts.layout import Channel, Layout
from mdcs_pipeline.pipeline import RESULT

FRAMES = "frames"
RESULTS = "results"
TURN = "turn"
NEXT = "next"
WRITTEN = "written"
# A frame's letters must not push each other out; how many wait is bounded by its rounds.
QUEUE = 10_000


@dataclass(frozen=True)
class Dataflow:
    """What a dora dataflow needs beside the graph.

    Parameters
    ----------
    config : str
        Configuration as every machine finds it.
    program : str
        ``mdcs-dora`` as every machine finds it.
    sets : sequence of str
        ``stage.setting=value``.
    machines : mapping of str
        Machine by host; those that are not named go where dora puts them.
    clouds : mapping of str
        ``NODE/OUTPUT`` of the user's own dataflow, by source.
    frames : str, optional
        File or folder that a node of its own reads and sends.
    results : str, optional
        Folder that a node of its own writes skeletons to.
    in_flight : int
        Frames that are on their way at a time.
    waiting : int
        Clouds that wait at the entry.
    """

    config: str
    program: str
    sets: Sequence[str] = ()
    machines: Mapping[str, str] = field(default_factory=dict)
    clouds: Mapping[str, str] = field(default_factory=dict)
    frames: str | None = None
    results: str | None = None
    in_flight: int = 1
    waiting: int = 16


def channel_id(channel: Channel) -> str:
    """Return the name of a channel among inputs and outputs of dora nodes."""
    origin, port = channel
    return origin if origin.startswith(SOURCES + ".") else f"{origin}.{port}"


def dataflow_text(layout: Layout, wanted: Dataflow) -> str:
    """Return the dora dataflow of a graph as YAML.

    Raises
    ------
    ConfigError
        If a host has the name of a node that is added, or a machine is given to no host.
    InputError
        If a source has no clouds, or several ways to them.
    """
    _check(layout, wanted)
    clouds = _clouds(layout, wanted)
    nodes = [_part(layout, host, wanted, clouds) for host in layout.hosts]
    if wanted.frames is not None:
        nodes.insert(0, _frames(layout, wanted))
    if wanted.results is not None:
        nodes.append(_results(layout, wanted))
    text = yaml.safe_dump({"nodes": nodes}, sort_keys=False, allow_unicode=True, width=100)
    name = layout.graph.spec.name
    return f"# Pipeline {name} as a dora dataflow, made by mdcs export dora.\n{text}"


def _check(layout: Layout, wanted: Dataflow) -> None:
    for name in (FRAMES, RESULTS):
        if name in layout.hosts:
            raise ConfigError(
                f"a host cannot be called '{name}' in a dora dataflow",
                where=layout.graph.spec.file,
                remedy="the name is kept for the node that reads or writes files",
            )
    for host in wanted.machines:
        if host not in (*layout.hosts, FRAMES, RESULTS):
            raise ConfigError(
                f"no stage is on the host '{host}'",
                remedy=suggestion(host, [*layout.hosts, FRAMES, RESULTS]),
            )


def _clouds(layout: Layout, wanted: Dataflow) -> dict[str, str]:
    sources = list(layout.graph.spec.sources)
    clouds = dict(wanted.clouds)
    for source in clouds:
        if source not in sources:
            raise InputError(
                f"the pipeline has no source '{source}'", remedy=suggestion(source, sources)
            )
    if wanted.frames is not None:
        if len(sources) != 1 or clouds:
            raise InputError(
                "files go with a pipeline of one source that has no other clouds",
                received=", ".join(sources) or "no sources",
                remedy="name the outputs that clouds come from: --cloud SOURCE=NODE/OUTPUT",
            )
        clouds[sources[0]] = f"{FRAMES}/cloud"
    missing = [source for source in sources if source not in clouds]
    if missing or not sources:
        raise InputError(
            f"nothing gives clouds to the source '{missing[0]}'"
            if missing
            else "a pipeline without sources has nothing to stream",
            remedy="add --frames PATH, or --cloud NODE/OUTPUT of your own dataflow",
        )
    return clouds


def _node(name: str, wanted: Dataflow, *arguments: str) -> dict[str, Any]:
    node: dict[str, Any] = {"id": name}
    if name in wanted.machines:
        node["deploy"] = {"machine": wanted.machines[name]}
    node["path"] = wanted.program
    node["args"] = shlex.join(arguments)
    return node


def _input(source: str, queue: int = QUEUE) -> dict[str, Any]:
    return {"source": source, "queue_size": queue}


def _kept(source: str) -> dict[str, Any]:
    # dora's direct path may lose a message; this policy takes the way over the daemon. Values
    # go the direct way, where they are read out of shared memory, and are asked for again.
    return {**_input(source), "queue_policy": "backpressure"}


def _part(layout: Layout, host: str, wanted: Dataflow, clouds: dict[str, str]) -> dict[str, Any]:
    sets = [part for text in wanted.sets for part in ("--set", text)]
    arguments = ["part", wanted.config, "--host", host, *sets]
    entry = host == layout.entry
    if entry:
        arguments += ["--in-flight", str(wanted.in_flight), "--waiting", str(wanted.waiting)]
    leaves = host == layout.exit
    writes = leaves and wanted.results is not None
    arguments += ["--acknowledged"] if writes else []
    node = _node(host, wanted, *arguments)
    # A host that dies comes back, and the frames that were under way begin again.
    node["restart_policy"] = "on-failure"
    inputs: dict[str, Any] = {}
    if entry:
        for name, origin in clouds.items():
            own = wanted.frames is not None
            held = _kept(origin) if own else _input(origin, wanted.waiting)
            inputs[f"{SOURCES}.{name}"] = held
    others = [other for other in layout.hosts if other != host]
    inputs.update((f"{TURN}_{other}", _kept(f"{other}/{TURN}")) for other in others)
    for channel in layout.heard(host):
        name = channel_id(channel)
        inputs[name] = _input(f"{layout.host(channel[0])}/{name}")
    if writes:
        inputs[WRITTEN] = _kept(f"{RESULTS}/{WRITTEN}")
    outputs = [TURN] if others else []
    outputs += [channel_id(channel) for channel in layout.spoken(host)]
    outputs += [NEXT] if entry else []
    outputs += [RESULT] if leaves else []
    return {**node, "inputs": inputs, "outputs": outputs}


def _frames(layout: Layout, wanted: Dataflow) -> dict[str, Any]:
    node = _node(FRAMES, wanted, "read", str(wanted.frames))
    return {**node, "inputs": {NEXT: _kept(f"{layout.entry}/{NEXT}")}, "outputs": ["cloud"]}


def _results(layout: Layout, wanted: Dataflow) -> dict[str, Any]:
    node = _node(RESULTS, wanted, "write", str(wanted.results))
    inputs = {RESULT: _kept(f"{layout.exit}/{RESULT}")}
    return {**node, "inputs": inputs, "outputs": [WRITTEN]}
