"""``mdcs configs``: what is shipped."""

from __future__ import annotations

from mdcs_pipeline.cli.console import literal, show


def configs() -> None:
    """List the configurations that come with the package."""
    from rich.table import Table

    from mdcs_pipeline.config import config_names, load_spec

    table = Table("configuration", "what it does", box=None, pad_edge=False)
    for name in config_names():
        table.add_row(literal(name, "bold"), literal(load_spec(name).description))
    show(table)
