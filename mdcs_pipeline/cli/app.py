"""The commands, put together."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from mdcs_pipeline.cli.configs import configs
from mdcs_pipeline.cli.console import prepare_streams, say
from mdcs_pipeline.cli.demo import demo
from mdcs_pipeline.cli.export import export
from mdcs_pipeline.cli.graph import graph
from mdcs_pipeline.cli.guard import Mode, guarded
from mdcs_pipeline.cli.info import info
from mdcs_pipeline.cli.options import options
from mdcs_pipeline.cli.run import run
from mdcs_pipeline.cli.schema import schema
from mdcs_pipeline.cli.stages import stages
from mdcs_pipeline.cli.stream import stream
from mdcs_pipeline.cli.validate import validate
from mdcs_pipeline.cli.view import view
from mdcs_pipeline.cli.warmup import warmup


class Shell(TyperGroup):
    """The group of commands, with one place that turns faults into exit codes."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command line; leaves the process unless `standalone_mode` is off."""
        prepare_streams()
        given = list(sys.argv[1:] if args is None else args)
        # Also behind the command, where one adds it after a failure.
        rest = [arg for arg in given if arg != "--debug"]
        mode = Mode(
            "--json" in rest, len(rest) < len(given), {"--quiet", "-q"} & set(rest) != set()
        )
        inner = super().main

        def body() -> Any:
            name = prog_name or "mdcs"
            return inner(rest, name, complete_var, False, windows_expand_args, obj=mode, **extra)

        code = guarded(body, mode)
        if standalone_mode:
            sys.exit(code)
        return code

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was asked for and return its exit code."""
        # Here too, since typer has its own answer to Ctrl-C and closed pipes.
        inner = super().invoke
        return guarded(lambda: inner(ctx), ctx.obj)


app = typer.Typer(
    cls=Shell,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="First steps: 'mdcs demo', then 'mdcs run -i scan.ply -o skeleton.json', and 'mdcs view "
    "scan.ply' to look at it. 'mdcs COMMAND --help' explains a command.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        say(f"mdcs-pipeline {version('mdcs-pipeline')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def root(
    ctx: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of a fault; works anywhere.")
    ] = False,
) -> None:
    """Curve skeletons of point clouds, by stages that a YAML file wires together."""
    del version, debug
    if ctx.invoked_subcommand is None:
        say(ctx.get_help())
        raise typer.Exit(2)


_COMMANDS = (
    run, stream, demo, view, info, stages, options, configs, validate, graph, schema, warmup,
)  # fmt: skip
for command in _COMMANDS:
    app.command()(command)
app.add_typer(export, name="export")
