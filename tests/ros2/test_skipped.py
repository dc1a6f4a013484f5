"""Tells, where ROS 2 is not installed, that its tests were left out."""

from __future__ import annotations

import pytest


def test_ros2_is_tested_in_an_environment_of_its_own() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 has its own environment: make test-ros2")
