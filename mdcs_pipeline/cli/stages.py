"""``mdcs stages``: what a pipeline can be made of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdcs_pipeline.cli.console import literal, show

if TYPE_CHECKING:
    from mdcs_pipeline.stage import Port, Stage


def stages() -> None:
    """List the stages: what each does, takes and gives."""
    from rich.table import Table

    from mdcs_pipeline.stage import installed

    table = Table("stage", "what it does", "takes → gives", box=None, pad_edge=False)
    table.columns[2].header = literal("takes → gives")
    for name, found in installed().items():
        table.add_row(literal(name, "bold"), literal(first_line(found)), literal(ports_of(found)))
    show(table)


def first_line(stage: type[Stage[Any]]) -> str:
    """Return the first line of a stage's documentation."""
    return (stage.__doc__ or "").strip().partition("\n")[0]


def ports_of(stage: type[Stage[Any]]) -> str:
    """Return ``inputs → outputs``; a port with ? may stay empty, one with * collects."""
    from mdcs_pipeline.stage import input_ports, output_ports

    taken, given = input_ports(stage).values(), output_ports(stage).values()
    return f"{_named(taken) or 'nothing'} → {_named(given) or 'nothing'}"


def _named(ports: Any) -> str:
    return ", ".join(_port(port) for port in ports)


def _port(port: Port) -> str:
    return f"{port.name}{'*' if port.many else '?' if port.optional else ''}"
