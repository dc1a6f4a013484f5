"""Skeletons to files: the suffix names the format."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdcs_pipeline.arrays import FloatArray
from mdcs_pipeline.errors import OutputError
from mdcs_pipeline.io.atomic import write_atomically
from mdcs_pipeline.io.graphml import graphml_bytes
from mdcs_pipeline.io.page import html_bytes
from mdcs_pipeline.io.picture import png_bytes
from mdcs_pipeline.io.ply_lines import ply_bytes
from mdcs_pipeline.io.record import json_bytes, npz_bytes
from mdcs_pipeline.io.swc import swc_bytes

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

_Encoder = Callable[["Skeleton", FloatArray | None, Mapping[str, Any] | None], bytes]

# Every format makes its bytes in memory, so that one place alone touches the disk.
_ENCODERS: dict[str, _Encoder] = {
    ".json": lambda skeleton, _, settings: json_bytes(skeleton, settings),
    ".ply": lambda skeleton, _, __: ply_bytes(skeleton),
    ".graphml": lambda skeleton, _, __: graphml_bytes(skeleton),
    ".npz": lambda skeleton, _, settings: npz_bytes(skeleton, settings),
    ".swc": lambda skeleton, _, __: swc_bytes(skeleton),
    ".png": lambda skeleton, cloud, _: png_bytes(skeleton, cloud),
    ".html": lambda skeleton, cloud, _: html_bytes(skeleton, cloud),
}
SKELETON_SUFFIXES = tuple(_ENCODERS)


def write_skeleton(
    skeleton: Skeleton,
    path: str | Path,
    *,
    cloud: FloatArray | None = None,
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write a skeleton in the format that the suffix of `path` names.

    Parameters
    ----------
    skeleton : Skeleton
    path : str or Path
        One of `SKELETON_SUFFIXES`; its folder must exist. An older file is replaced, in
        one step and only when the new one is whole.
    cloud : (N, 3) float, optional
        Drawn behind the skeleton in ``.png`` and ``.html``, in the skeleton's frame.
    settings : mapping, optional
        Of the run that made the skeleton; kept in ``.json`` and ``.npz``.

    Raises
    ------
    OutputError
        If the suffix is unknown, the format cannot hold the skeleton, or the file cannot
        be written; then no file is left.
    MissingExtraError
        If the format needs the extra ``draw``.
    """
    path = Path(path).expanduser()
    try:
        if path.suffix.lower() in _ENCODERS:
            _check_place(path)
        write_atomically(
            path, skeleton_bytes(skeleton, path.suffix, cloud=cloud, settings=settings)
        )
    except OutputError as error:
        raise error.located(str(path)) from error
    except OSError as error:
        raise OutputError(
            "the file cannot be written", where=str(path), received=str(error)
        ) from error


def skeleton_bytes(
    skeleton: Skeleton,
    suffix: str,
    *,
    cloud: FloatArray | None = None,
    settings: Mapping[str, Any] | None = None,
) -> bytes:
    """Return what `write_skeleton` writes into a file of that suffix.

    Raises
    ------
    OutputError
        If the suffix is unknown or the format cannot hold the skeleton.
    MissingExtraError
        If the format needs the extra ``draw``.
    """
    encode = _ENCODERS.get(suffix.lower())
    if encode is None:
        raise OutputError(
            f"no skeleton format has the suffix '{suffix}'",
            remedy="known suffixes: " + ", ".join(SKELETON_SUFFIXES),
        )
    return encode(skeleton, cloud, settings)


def _check_place(path: Path) -> None:
    """Refuse a place that cannot be written to before any work is done for it."""
    if path.is_dir():
        raise OutputError(
            "a folder is in the file's place", remedy="give the name of a file in the folder"
        )
    if not path.parent.is_dir():
        raise OutputError(f"there is no folder {path.parent}", remedy="make the folder first")
    if not os.access(path.parent, os.W_OK):
        raise OutputError(
            "no permission to write into the folder", remedy="choose another, or chmod u+w"
        )
