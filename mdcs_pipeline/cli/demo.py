"""``mdcs demo``: the main job on a cloud that the package makes itself."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from mdcs_pipeline.cli.common import check_folder
from mdcs_pipeline.cli.console import note
from mdcs_pipeline.cli.run import run
from mdcs_pipeline.errors import MissingExtraError, OutputError


def demo(
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FOLDER", help="Folder to write into; made if missing."
        ),
    ] = Path("mdcs-demo"),
) -> None:
    """Make a cloud of a small animal, its skeleton and a picture."""
    from mdcs_pipeline.cli.outputs import check_extra

    folder = output.expanduser()
    _make_folder(folder)
    outputs = [folder / "skeleton.json", folder / "skeleton.png"]
    try:
        check_extra(outputs[1])
    except MissingExtraError as error:
        note(f"no picture: {error.what}; {error.remedy}")
        del outputs[1]
    cloud = folder / "cloud.npy"
    write_cloud(cloud)
    run("default", inputs=[str(cloud)], outputs=outputs)
    if find_spec("viser") is not None:
        note(f"to turn it about: mdcs view {cloud} {outputs[0]}")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            "the folder cannot be made",
            where=str(folder),
            received=str(error),
            remedy="choose another with -o",
        ) from error
    check_folder(folder, folder)


def write_cloud(path: Path) -> None:
    """Write the demo's cloud as an array file, whole or not at all."""
    import io

    import numpy as np

    from mdcs_pipeline.cli.common import write_bytes
    from mdcs_pipeline.demo import demo_cloud

    buffer = io.BytesIO()
    np.save(buffer, demo_cloud(), allow_pickle=False)
    write_bytes(buffer.getvalue(), path)
