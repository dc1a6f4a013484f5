"""``mdcs schema``: what editors complete configurations from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from mdcs_pipeline.cli.common import check_output, write_text
from mdcs_pipeline.cli.console import say


def schema(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", show_default=False, help="File to write: .json."
        ),
    ] = None,
) -> None:
    """Print the JSON Schema of configurations, for editors.

    Stages of other packages are in it.
    """
    if output is not None:
        check_output(output, (".json",))
    from mdcs_pipeline.schema import json_schema

    text = json.dumps(json_schema(), indent=2) + "\n"
    if output is None:
        say(text)
    else:
        write_text(text, output)
