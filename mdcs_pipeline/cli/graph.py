"""``mdcs graph CONFIG``: a configuration as a picture."""

from __future__ import annotations

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


def graph(
    config: ConfigArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            show_default=False,
            help="File to write: .svg, .png or .mmd.",
        ),
    ] = None,
    sets: SetOption = None,
) -> None:
    """Draw a configuration, or print it as Mermaid text."""
    if output is not None:
        check_output(output, (".svg", ".png", ".mmd"))
    from mdcs_pipeline.graph import draw_graph, mermaid

    held = load_graph(config, sets)
    if output is None:
        say(mermaid(held))
    elif output.suffix.lower() == ".mmd":
        write_text(mermaid(held), output)
    else:
        draw_graph(held, output)
