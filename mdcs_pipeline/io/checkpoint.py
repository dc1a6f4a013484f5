"""Checkpoints: plain arrays and values in one file that is there whole or not at all."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.atomic import write_or_refuse

FORMAT = "mdcs-checkpoint"
FORMAT_VERSION = 1
_MAGIC = b"MDCSCKPT"


def write_checkpoint(path: Path, values: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write a checkpoint in place of an older one, in one step.

    Parameters
    ----------
    path : Path
    values : dict
        Fit for JSON.
    arrays : dict of array
        Of numbers or truth values.

    Raises
    ------
    OutputError
        If it cannot be written; then an older one is kept.
    """
    head = {"format": FORMAT, "format_version": FORMAT_VERSION, "values": values}
    stream = io.BytesIO()
    held: dict[str, Any] = {"head": np.array(json.dumps(head)), **arrays}
    np.savez(stream, **held)
    body = stream.getvalue()
    # An archive's own sums leave its headers out.
    write_or_refuse(path, _MAGIC + zlib.crc32(body).to_bytes(4, "big") + body)


def read_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the values and arrays of a checkpoint.

    Raises
    ------
    InputError
        If there is no such file, or it is none of ours, damaged or of a later format.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            "the checkpoint cannot be read", where=str(path), received=str(error)
        ) from error
    if not data.startswith(_MAGIC):
        raise _refused(path, "the file is no checkpoint of mdcs-pipeline", data[:8])
    sum_, body = data[8:12], data[12:]
    if zlib.crc32(body).to_bytes(4, "big") != sum_:
        raise _refused(path, "the checkpoint is damaged", f"{len(data)} bytes with a wrong sum")
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        head = json.loads(str(arrays.pop("head")))
        known = head["format"] == FORMAT and head["format_version"] <= FORMAT_VERSION
        values: dict[str, Any] = head["values"]
    except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise _refused(path, "the checkpoint is damaged", str(error)) from error
    if not known:
        version = head["format_version"]
        raise _refused(path, f"the checkpoint is of format version {version}", FORMAT_VERSION)
    return values, arrays


def _refused(path: Path, what: str, received: object) -> InputError:
    return InputError(
        what,
        where=str(path),
        received=received,
        remedy="remove the file to begin anew, or name another checkpoint",
    )
