"""``mdcs info SKELETON``: lengths, radii, junctions, loops."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mdcs_pipeline.cli.console import say

if TYPE_CHECKING:
    from mdcs_pipeline.measures import Measures
    from mdcs_pipeline.skeleton import Skeleton


class Style(str, Enum):
    """How the measures are written."""

    text = "text"
    csv = "csv"
    json = "json"


class Table(str, Enum):
    """What a CSV is of."""

    branches = "branches"
    junctions = "junctions"
    loops = "loops"
    summary = "summary"


def info(
    skeleton: Annotated[
        Path,
        typer.Argument(
            metavar="SKELETON",
            show_default=False,
            help="Skeleton file: .json, .npz, .graphml, .ply or .swc.",
        ),
    ],
    style: Annotated[
        Style, typer.Option("--format", help="Tables to read, one table as CSV, or all as JSON.")
    ] = Style.text,
    table: Annotated[Table, typer.Option(help="Which table the CSV is.")] = Table.branches,
) -> None:
    """Measure a skeleton: its branches, junctions and loops, in input units."""
    from mdcs_pipeline.measures import measure
    from mdcs_pipeline.skeleton import Skeleton

    held = Skeleton.load(skeleton)
    measures = measure(held)
    if style == Style.json:
        say(json.dumps(as_json(held, measures)))
    elif style == Style.csv:
        say(as_csv(measures, table))
    else:
        show_measures(measures)


def as_json(skeleton: Skeleton, measures: Measures) -> dict[str, Any]:
    """Return the measures as plain values, with the skeleton's header."""
    return {"header": asdict(skeleton.header), **asdict(measures)}


def as_csv(measures: Measures, table: Table) -> str:
    """Return one table with a line of names; numbers keep every bit."""
    names, rows = _cells(measures, table)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_joined(value) for value in row] for row in rows)
    return stream.getvalue()


def show_measures(measures: Measures) -> None:
    """Write the summary and every table that has a row."""
    wide = max(map(len, measures.summary))
    for name, value in measures.summary.items():
        say(f"{name.replace('_', ' '):<{wide}}  {_short(value)}")
    for kind in (Table.branches, Table.junctions, Table.loops):
        names, rows = _cells(measures, kind)
        if rows:
            say("")
            heads = [name.replace("_", " ") for name in names]
            say(_aligned([heads, *([_short(value) for value in row] for row in rows)]))


def _aligned(rows: list[list[str]]) -> str:
    """Return lines of columns, flush right.

    As wide as they need to be: a row that is folded to fit a narrow terminal is not read.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in rows
    )


def _cells(measures: Measures, table: Table) -> tuple[list[str], list[list[Any]]]:
    from dataclasses import fields

    from mdcs_pipeline.measures import Branch, Junction, Loop

    if table == Table.summary:
        return list(measures.summary), [list(measures.summary.values())]
    kinds: dict[Table, type[Any]] = {
        Table.branches: Branch,
        Table.junctions: Junction,
        Table.loops: Loop,
    }
    names = [field.name for field in fields(kinds[table])]
    return names, [[getattr(row, n) for n in names] for row in getattr(measures, table.value)]


def _joined(value: Any) -> Any:
    return " ".join(map(str, value)) if isinstance(value, tuple) else value


def _short(value: Any) -> str:
    if value is None:
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else str(_joined(value))
