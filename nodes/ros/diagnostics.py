"""How a node fares, as `diagnostic_msgs/DiagnosticArray`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..latest import Counts
from .inputs import InputCounts


@dataclass
class Progress:
    """What the frames have left behind, for those who watch.

    Parameters
    ----------
    lag : float
        Seconds from the latest result's stamp to when it was published.
    seconds : float
        Time that the latest frame took.
    points, nodes : int
        Of the latest frame.
    error : str
        Why the latest frame failed; empty after one that went well.
    cloud_at : float or None
        Monotonic time of the latest cloud.
    """

    lag: float = 0.0
    seconds: float = 0.0
    points: int = 0
    nodes: int = 0
    error: str = ""
    cloud_at: float | None = None


@dataclass
class _Window:
    at: float = field(default_factory=time.monotonic)
    clouds: int = 0
    done: int = 0


class Diagnostics:
    """Turns counts into statuses; rates are those since the statuses before.

    Parameters
    ----------
    name : str
        Of the node.
    hardware : str
        Of the pipeline.
    """

    def __init__(self, name: str, hardware: str) -> None:
        self._name = name
        self._hardware = hardware
        self._before = _Window()

    def statuses(
        self,
        state: str,
        inputs: InputCounts,
        counts: Counts,
        progress: Progress,
        stale_after: float,
        more: Mapping[str, Any],
    ) -> list[DiagnosticStatus]:
        """Return the status of the input and that of the pipeline."""
        now = _Window(clouds=inputs.clouds, done=counts.done)
        span = max(now.at - self._before.at, 1e-9)
        rate_in = max(now.clouds - self._before.clouds, 0) / span
        rate_out = max(now.done - self._before.done, 0) / span
        self._before = now
        age = None if progress.cloud_at is None else now.at - progress.cloud_at
        received = {
            "clouds": inputs.clouds,
            "rate (Hz)": f"{rate_in:.2f}",
            "age of the latest (s)": "none yet" if age is None else f"{age:.2f}",
            "lost in the middleware": inputs.lost,
            "unmatched": inputs.unmatched,
            "poses": inputs.poses,
            "bad poses": inputs.bad_poses,
            **{f"publishers on {k}": v for k, v in (inputs.publishers or {}).items()},
        }
        frames = {
            "state": state,
            "frames offered": counts.offered,
            "frames done": counts.done,
            "frames failed": counts.failed,
            "frames dropped": counts.replaced,
            "rate (Hz)": f"{rate_out:.2f}",
            "lag (s)": f"{progress.lag:.3f}",
            "time of a frame (s)": f"{progress.seconds:.3f}",
            "points": progress.points,
            "nodes": progress.nodes,
            "latest error": progress.error or "none",
            **more,
        }
        return [
            self._status("input", *_input_level(state, age, inputs, stale_after), received),
            self._status("pipeline", *_pipeline_level(state, progress), frames),
        ]

    def _status(
        self, part: str, level: bytes, message: str, values: Mapping[str, Any]
    ) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=level,
            name=f"{self._name}: {part}",
            message=message,
            hardware_id=self._hardware,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )


def _input_level(
    state: str, age: float | None, inputs: InputCounts, stale_after: float
) -> tuple[bytes, str]:
    if state != "active":
        return DiagnosticStatus.OK, f"not asked for while {state}"
    if not inputs.publishers:
        return DiagnosticStatus.OK, "clouds come in on another host"
    silent = [name for name, count in (inputs.publishers or {}).items() if not count]
    if silent:
        return DiagnosticStatus.WARN, f"nobody publishes {', '.join(silent)}"
    if age is None or age > stale_after:
        return DiagnosticStatus.STALE, f"no cloud within {stale_after:g} s"
    return DiagnosticStatus.OK, "clouds arrive"


def _pipeline_level(state: str, progress: Progress) -> tuple[bytes, str]:
    if progress.error:
        return DiagnosticStatus.ERROR, progress.error.splitlines()[0]
    return DiagnosticStatus.OK, state


def diagnostic_array(stamp: Any, statuses: list[DiagnosticStatus]) -> DiagnosticArray:
    """Return the message for the topic /diagnostics."""
    array = DiagnosticArray(status=statuses)
    array.header.stamp = stamp
    return array
