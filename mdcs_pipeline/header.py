"""Where and when a message was measured."""

from __future__ import annotations

from dataclasses import dataclass

from mdcs_pipeline.errors import InputError


@dataclass(frozen=True)
class Header:
    """Frame, time and number of a message, copied from input to result.

    Parameters
    ----------
    frame_id : str
        Name of the coordinate frame.
    stamp_ns : int
        Time of measurement in nanoseconds.
    seq : int
        Running number of the frame, from 0.
    """

    frame_id: str = ""
    stamp_ns: int = 0
    seq: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.frame_id, str):
            raise InputError("frame_id must be text", received=self.frame_id)
        for name in ("stamp_ns", "seq"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 0:
                raise InputError(f"{name} must be a non-negative integer", received=value)
