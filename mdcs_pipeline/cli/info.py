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

from mdcs_pipeline.cli.console import literal, say, show

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
    from rich import table as rich_table

    head = rich_table.Table(show_header=False, box=None, pad_edge=False)
    for name, value in measures.summary.items():
        head.add_row(literal(name.replace("_", " "), "bold"), literal(_short(value)))
    show(head)
    for kind in (Table.branches, Table.junctions, Table.loops):
        names, rows = _cells(measures, kind)
        if not rows:
            continue
        drawn = rich_table.Table(box=None, pad_edge=False)
        for name in names:
            drawn.add_column(literal(name.replace("_", " ")), justify="right")
        for row in rows:
            drawn.add_row(*(literal(_short(value)) for value in row))
        show("", drawn)


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
