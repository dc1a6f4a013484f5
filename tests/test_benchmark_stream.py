"""The streaming benchmark's own arithmetic, on figures whose answers are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.stream.growth import around, moment
from benchmarks.stream.run import Cold, Timed
from benchmarks.stream.table import rows_of
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.stream import Stream


def _timed(seconds: list[float]) -> Timed:
    count = len(seconds)
    return Timed(
        Stream.from_config(), seconds, [0.5 * s for s in seconds], [100] * count, [2000] * count
    )


def _cold(seconds: float) -> Cold:
    one = np.zeros((1, 3)), np.zeros((0, 2), np.int64), np.ones(1), np.ones(1)
    return Cold(Skeleton(*one, np.zeros(1, np.int64)), seconds, 0.8 * seconds, 5000)


def _grown(*moments: dict[str, Any]) -> dict[str, Any]:
    return {
        "frames": 200,
        "voxels": 10,
        "streamed": [0, 0, 0],
        "moments": list(moments),
        "quarters": [0.1] * 4,
        "flatness": 1.0,
        "cpu_flatness": 1.0,
        "bytes_per_voxel": 100.0,
        "memory_growth": 1000,
    }


@pytest.mark.parametrize(("held", "expected"), [(25, (13, 38)), (200, (188, 200)), (5, (0, 18))])
def test_frames_around_a_moment_stay_within_the_stream(
    held: int, expected: tuple[int, int]
) -> None:
    near = around(200, held)
    assert (near.start, near.stop) == expected


def test_the_ratio_is_that_of_the_median_frame_near_the_moment() -> None:
    """Means would let one slow frame, or frames far from the moment, speak for all."""
    seconds = [9.0] * 10 + [0.05] * 40
    seconds[24] = 3.0
    made = moment(_timed(seconds), 25, 24_000, _cold(2.0))
    assert made["ratio"] == pytest.approx(40.0)
    assert made["cpu_ratio"] == pytest.approx(1.6 / 0.025)
    assert made["frame_ms"] == pytest.approx(50.0)
    assert made["entries"] == [5000, 100]


def test_only_the_moment_that_was_asked_for_has_a_bound() -> None:
    timed = _timed([0.1] * 60)
    slow, late = moment(timed, 25, 1000, _cold(2.9)), moment(timed, 50, 2000, _cold(9.0))
    fast = moment(timed, 25, 1000, _cold(3.1))
    rows = [row for row in rows_of({"grown": _grown(slow, late)}) if "cold over a frame" in row[0]]
    assert [(row[0][-2:], row[1], row[3]) for row in rows] == [
        ("25", "≥ 30", False),
        ("50", "", None),
    ]
    assert rows_of({"grown": _grown(fast)})[0][3] is True
