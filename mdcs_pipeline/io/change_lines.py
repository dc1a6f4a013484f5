"""Changes of a scene as lines of JSON, one a frame."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from mdcs_pipeline.errors import OutputError
from mdcs_pipeline.io.plain import json_text

if TYPE_CHECKING:
    from mdcs_pipeline.scene.change import SceneChange


def record_of(change: SceneChange) -> dict[str, Any]:
    """Return a change as plain values.

    ``added`` and ``moved`` name nodes with their places in input units, ``removed`` names
    nodes, ``joined`` and ``parted`` edges by the ids of their nodes. Applied in the order
    parted, removed, added, moved, joined, the lines of a scene give its skeleton.
    """
    header, split = change.header, len(change.added)
    places = change.positions.tolist()
    return {
        "seq": header.seq,
        "stamp_ns": header.stamp_ns,
        "frame_id": header.frame_id,
        "scene": change.scene,
        "added": dict(zip(map(str, change.added.tolist()), places[:split], strict=True)),
        "moved": dict(zip(map(str, change.moved.tolist()), places[split:], strict=True)),
        "removed": change.removed.tolist(),
        "joined": change.joined.tolist(),
        "parted": change.parted.tolist(),
        "figures": change.figures,
    }


class ChangeLines:
    """A file that a line is appended to for every frame.

    Parameters
    ----------
    path : Path
    length : int, optional
        Bytes of an earlier run's file to go on from; what is behind them is cut off. A new
        file is begun when absent.

    Raises
    ------
    OutputError
        If it cannot be written, or the earlier run's file is gone or shorter.
    """

    def __init__(self, path: Path, length: int | None = None) -> None:
        self.path = path
        try:
            self._stream: BinaryIO = path.open("wb" if length is None else "r+b")
            if length is None:
                return
            held = self._stream.seek(0, os.SEEK_END)
            if held < length:
                self._stream.close()
                raise OutputError(
                    "the file is shorter than when the checkpoint was made",
                    where=str(path),
                    received=f"{held} bytes, {length} wanted",
                    remedy="put the file back, or remove the checkpoint to begin anew",
                )
            self._stream.truncate(length)
            self._stream.seek(length)
        except OutputError:
            raise
        except OSError as error:
            raise self._refused(error) from error

    def write(self, change: SceneChange) -> None:
        """Append the line of a change."""
        try:
            self._stream.write(json_text(record_of(change)).encode("utf-8", "backslashreplace"))
            self._stream.write(b"\n")
            self._stream.flush()
        except OSError as error:
            raise self._refused(error) from error

    def sync(self) -> int:
        """Bring all lines to the disk and return the length of the file."""
        try:
            os.fsync(self._stream.fileno())
            return self._stream.tell()
        except OSError as error:
            raise self._refused(error) from error

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _refused(self, error: OSError) -> OutputError:
        return OutputError("the lines cannot be written", where=str(self.path), received=str(error))
