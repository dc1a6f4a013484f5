"""``mdcs options STAGE``: every setting of a stage."""

from __future__ import annotations

import types
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

import typer

from mdcs_pipeline.cli.console import literal, show
from mdcs_pipeline.errors import ConfigError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo


def options(
    stage: Annotated[
        str, typer.Argument(metavar="STAGE", show_default=False, help="Name of a stage.")
    ] = "",
) -> None:
    """Explain every setting of a stage: type, default, range."""
    from rich.table import Table

    from mdcs_pipeline.cli.stages import first_line, ports_of
    from mdcs_pipeline.stage import stage_class, stage_names

    if not stage:
        raise ConfigError("name a stage", remedy="one of: " + ", ".join(stage_names()))
    found = stage_class(stage)
    show(literal(f"{stage}: {first_line(found)}"), literal(ports_of(found)), "")
    fields = found.Settings.model_fields
    if not fields:
        show("no settings")
        return
    names = ("setting", "type", "default", "range", "description")
    table = Table(*names, box=None, pad_edge=False)
    for name, info in fields.items():
        default = "required" if info.is_required() else _value(info.get_default())
        cells = (type_text(info.annotation), default, range_text(info), info.description or "")
        table.add_row(literal(name, "bold"), *(literal(cell) for cell in cells))
    show(table)


def _value(value: object) -> str:
    return value if isinstance(value, str) and value else repr(value)


def type_text(annotation: Any) -> str:
    """Return a type as it is written: ``float``, ``int or None``, ``one of a, b``."""
    origin = get_origin(annotation)
    if origin is Literal:
        return "one of " + ", ".join(str(arg) for arg in get_args(annotation))
    if origin in (Union, types.UnionType):
        return " or ".join(type_text(arg) for arg in get_args(annotation))
    if annotation is type(None):
        return "None"
    if origin is not None:
        inner = ", ".join("…" if a is Ellipsis else type_text(a) for a in get_args(annotation))
        return f"{origin.__name__}[{inner}]"
    return getattr(annotation, "__name__", str(annotation))


def range_text(info: FieldInfo) -> str:
    """Return the bounds of a setting, as in ``> 0, ≤ 1``; empty if it has none."""
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    found = (
        f"{sign} {getattr(rule, key)}"
        for rule in info.metadata
        for key, sign in signs.items()
        if getattr(rule, key, None) is not None
    )
    return ", ".join(found)
