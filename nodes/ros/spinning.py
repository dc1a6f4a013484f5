"""Spin an executor until it is told to stop."""

from __future__ import annotations

from rclpy._rclpy_pybind11 import RCLError  # rclpy has no public name for it
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor


def spin_until_shutdown(executor: SingleThreadedExecutor) -> None:
    """Run callbacks until a signal or a shutdown of the executor's context.

    A signal's handler shuts the context down at any moment: between the executor's own look at it
    and the wait set, or while a callback publishes. rclpy then raises what it raises for faults,
    so what counts is whether the context still stands.

    Raises
    ------
    RCLError
        If rcl fails and the context is valid.
    """
    context = executor.context
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if context.ok():
            raise
