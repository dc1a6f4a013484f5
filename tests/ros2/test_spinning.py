"""An end at any moment is an end, and a fault stays a fault."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from mdcs_pipeline.nodes.ros.spinning import spin_until_shutdown


class _EndedBetween(SingleThreadedExecutor):
    """Its context goes, as by a signal, after the loop's look at it and before the wait set."""

    def spin_once(self, timeout_sec: float | None = None) -> None:
        self.context.try_shutdown()
        super().spin_once(timeout_sec)


class _Faulty(SingleThreadedExecutor):
    def spin_once(self, timeout_sec: float | None = None) -> None:
        raise RCLError("no more file descriptors")


@pytest.fixture
def context() -> Iterator[Context]:
    own = Context()
    rclpy.init(args=[], context=own)
    yield own
    own.try_shutdown()


def test_a_shutdown_before_the_wait_set_is_an_end(context: Any) -> None:
    with pytest.raises((RCLError, ExternalShutdownException)):
        _EndedBetween(context=context).spin()
    again = Context()
    rclpy.init(args=[], context=again)
    spin_until_shutdown(_EndedBetween(context=again))
    assert not again.ok()


def test_a_fault_of_rcl_is_told(context: Any) -> None:
    with pytest.raises(RCLError, match="descriptors"):
        spin_until_shutdown(_Faulty(context=context))
