"""``mdcs export``: a pipeline as something that another runtime runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from mdcs_pipeline.cli.common import (
    ConfigArgument,
    SetOption,
    check_output,
    load_graph,
    write_text,
)
from mdcs_pipeline.cli.console import say
from mdcs_pipeline.errors import ConfigError, InputError

export = typer.Typer(
    help="Write a pipeline as something that another runtime runs.", no_args_is_help=True
)


@export.callback()
def _group() -> None:
    """Write a pipeline as something that another runtime runs."""


Frames = Annotated[
    Path | None,
    typer.Option(show_default=False, help="Cloud, or folder of clouds, to read and send."),
]
Results = Annotated[
    Path | None,
    typer.Option(show_default=False, help="Folder to write the skeletons to."),
]
Clouds = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[SOURCE=]NODE/OUTPUT",
        show_default=False,
        help="Output of your own dataflow that gives clouds; repeatable.",
    ),
]
Machines = Annotated[
    list[str] | None,
    typer.Option(
        metavar="HOST=MACHINE",
        show_default=False,
        help="Machine of a host, by the --machine-id of its daemon; repeatable.",
    ),
]
Program = Annotated[
    str | None,
    typer.Option(
        show_default=False, help="mdcs-dora as each machine finds it; this one's by default."
    ),
]
InFlight = Annotated[int, typer.Option(min=1, max=64, help="Frames that are under way at a time.")]
Waiting = Annotated[int, typer.Option(min=1, help="Clouds that wait; more push out the oldest.")]


@export.command()
def dora(
    config: ConfigArgument,
    frames: Frames = None,
    results: Results = None,
    cloud: Clouds = None,
    machine: Machines = None,
    program: Program = None,
    in_flight: InFlight = 1,
    waiting: Waiting = 16,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", show_default=False, help="File to write: .yml or .yaml."),
    ] = None,
    sets: SetOption = None,
) -> None:
    """Write a dora dataflow with a node for each host of the graph."""
    if output is not None:
        check_output(output, (".yml", ".yaml"))
    graph = load_graph(config, sets)
    from mdcs_pipeline.parts.dataflow import Dataflow, dataflow_text
    from mdcs_pipeline.parts.layout import layout_of

    wanted = Dataflow(
        config=_everywhere(config),
        program=program or str(Path(sys.executable).with_name("mdcs-dora")),
        sets=sets or (),
        machines=dict(_pair(text, "HOST=MACHINE") for text in machine or ()),
        clouds=dict(_cloud(text, list(graph.spec.sources)) for text in cloud or ()),
        frames=None if frames is None else str(_existing(frames)),
        results=None if results is None else str(results.expanduser().absolute()),
        in_flight=in_flight,
        waiting=waiting,
    )
    text = dataflow_text(layout_of(graph), wanted)
    if output is None:
        say(text)
    else:
        write_text(text, output)


def _everywhere(config: str) -> str:
    """Return a configuration as a node finds it that starts in another folder."""
    from mdcs_pipeline.config import config_names

    return config if config in config_names() else str(Path(config).absolute())


def _existing(path: Path) -> Path:
    path = path.expanduser().absolute()
    if not path.exists():
        raise InputError("there is no such file or folder", where=str(path))
    return path


def _pair(text: str, form: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (equals and name and value):
        raise ConfigError(f"this must be written {form}", received=text)
    return name, value


def _cloud(text: str, sources: list[str]) -> tuple[str, str]:
    name, equals, origin = text.partition("=")
    if not equals:
        origin, name = name, sources[0] if len(sources) == 1 else ""
    node, slash, output = origin.partition("/")
    if not (name and node and slash and output):
        raise ConfigError(
            "a cloud's origin must be written NODE/OUTPUT, with several sources SOURCE=NODE/OUTPUT",
            received=text,
            remedy=f"the sources are: {', '.join(sources) or 'none'}",
        )
    return name, origin
