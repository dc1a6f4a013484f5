"""``mdcs view``: clouds and skeletons on a page in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mdcs_pipeline.cli.common import SetOption
from mdcs_pipeline.cli.console import note
from mdcs_pipeline.cli.demo import write_cloud
from mdcs_pipeline.cli.run import run
from mdcs_pipeline.cli.screen import HostOption, PortOption, open_page, stay


def view(
    paths: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="FILE_OR_FOLDER",
            show_default=False,
            help="A cloud, whose skeleton is made; a skeleton (.json, .npz); a folder of "
            "either; or a cloud and its skeleton. Without any, a cloud of the package's own.",
        ),
    ] = None,
    config: Annotated[
        str,
        typer.Option(
            "--config", "-c", metavar="CONFIG", help="Configuration that makes the skeletons."
        ),
    ] = "default",
    sets: SetOption = None,
    host: HostOption = None,
    port: PortOption = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Say nothing but errors, not even the address.")
    ] = False,
) -> None:
    """Show clouds and skeletons in the browser, until Ctrl-C."""
    import tempfile

    from mdcs_pipeline.cli.gallery import sort_paths

    clouds, skeletons = sort_paths([Path(path).expanduser() for path in paths or []])
    if skeletons:
        _show(clouds, skeletons, host, port, quiet)
        return
    with tempfile.TemporaryDirectory() as folder:
        if not clouds:
            clouds = [Path(folder) / "demo.npy"]
            write_cloud(clouds[0])
            if not quiet:
                note("nothing given: here is a cloud of the package's own")
        given = [str(clouds[0])]
        run(config, inputs=given, sets=sets, quiet=quiet, view=True, host=host, port=port)


def _show(
    clouds: list[Path], skeletons: list[Path], host: str | None, port: int | None, quiet: bool
) -> None:
    from mdcs_pipeline.cli.gallery import skeleton_frames

    frames = skeleton_frames(clouds, skeletons)
    with open_page(skeletons[0].name, host, port, quiet) as page:
        for frame in frames:
            page.show(frame)
        page.finish()
        stay(page, quiet)
