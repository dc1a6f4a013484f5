"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from mdcs_pipeline.errors import OutputError


def write_atomically(path: Path, data: bytes) -> None:
    """Put `data` into the file `path`, or leave everything as it was.

    Parameters
    ----------
    path : Path
        An older file is replaced; of a symbolic link, the file that it leads to.
    data : bytes

    Raises
    ------
    OSError
        If the folder or the disk refuses; no temporary file is left.
    """
    target = Path(os.path.realpath(path))
    # Same folder: only within one file system is the replacement a single step. Not made by
    # tempfile, so that the user's umask gives the file its mode.
    temporary = target.with_name(f".mdcs-{secrets.token_hex(8)}.tmp")
    try:
        with temporary.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, target)  # noqa: PTH105 - tests stop the write here
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_or_refuse(path: Path, data: bytes) -> None:
    """Put `data` into the file `path`, whole or not at all.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    try:
        write_atomically(path, data)
    except OSError as error:
        raise OutputError(
            "the file cannot be written", where=str(path), received=str(error)
        ) from error
