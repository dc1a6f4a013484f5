"""Arguments that several commands share, and what becomes of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mdcs_pipeline.errors import ConfigError, OutputError, nearest_name

if TYPE_CHECKING:
    from mdcs_pipeline.graph import Graph

ConfigArgument = Annotated[
    str,
    typer.Argument(
        metavar="CONFIG",
        show_default=False,
        help="Name of a shipped configuration, or a YAML file.",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="STAGE.SETTING=VALUE",
        show_default=False,
        help="Put a setting over that of the file; repeatable.",
    ),
]


ThreadsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="NUMBER",
        show_default=False,
        help="Most threads a stage may use (default 1); never more than the processors, "
        "OMP_NUM_THREADS or NUMBA_NUM_THREADS allow. No result depends on it.",
    ),
]


def load_graph(config: str, sets: list[str] | None, threads: int | None = None) -> Graph:
    """Return the checked graph of a configuration with settings put over it."""
    from mdcs_pipeline.config import load_spec, parse_override
    from mdcs_pipeline.graph import build_graph

    _refuse_cloud(config)
    overrides: dict[str, Any] = dict(parse_override(text) for text in sets or ())
    if threads is not None:
        overrides["threads"] = threads
    return build_graph(load_spec(config, overrides))


def _refuse_cloud(config: str) -> None:
    """Tell who gave a cloud for the configuration where the cloud goes."""
    from mdcs_pipeline.io.clouds import CLOUD_SUFFIXES

    if Path(config).suffix.lower() in CLOUD_SUFFIXES:
        raise ConfigError(
            "a cloud stands where a configuration was wanted",
            where=config,
            remedy=f"mdcs run default -i {config}",
        )


def check_output(path: Path, suffixes: Iterable[str]) -> None:
    """Refuse a file that could not be written, before any work is done for it.

    Raises
    ------
    OutputError
        If the suffix is none of `suffixes`, a folder is in the file's place, or the folder
        that it goes into is missing or closed.
    """
    check_suffix(path, suffixes)
    if path.is_dir():
        raise OutputError(
            "a folder is in the file's place",
            where=str(path),
            remedy="give the name of a file in the folder",
        )
    check_folder(path.parent, path)


def check_suffix(path: Path, suffixes: Iterable[str]) -> None:
    """Refuse a file whose suffix is none of `suffixes`, and name the nearest."""
    known = list(suffixes)
    suffix = path.suffix.lower()
    if suffix not in known:
        near = nearest_name(suffix, known) if suffix else None
        names = "known suffixes: " + ", ".join(known)
        raise OutputError(
            f"no format has the suffix '{path.suffix}'" if suffix else "the file has no suffix",
            where=str(path),
            remedy=f"did you mean '{near}'? {names}" if near else names,
        )


def check_folder(folder: Path, path: Path) -> None:
    """Refuse a folder that is missing or into which `path` cannot be written."""
    import tempfile

    if not folder.is_dir():
        raise OutputError(
            f"there is no folder {folder}", where=str(path), remedy="make the folder first"
        )
    try:
        # Tried, not asked for: permissions alone say yes to root, on read-only disks too.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"files cannot be written into {folder}",
            where=str(path),
            received=error.strerror,
            remedy="choose another folder, or chmod u+w",
        ) from error


def write_text(text: str, path: Path) -> None:
    """Write UTF-8 text into a file, whole or not at all."""
    write_bytes(text.encode("utf-8", "backslashreplace"), path)


def write_bytes(data: bytes, path: Path) -> None:
    """Write a file, whole or not at all."""
    from mdcs_pipeline.io.atomic import write_or_refuse

    write_or_refuse(path, data)
