"""``mdcs-ros2``: a pipeline as a ROS 2 lifecycle node."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import Any

from mdcs_pipeline.errors import MdcsError, MissingExtraError

# Nodes reach their own machine alone unless the user says otherwise.
DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_DISCOVERY_SET = (DISCOVERY, "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "ROS_LOCALHOST_ONLY")

_EPILOG = """\
examples:
  mdcs-ros2 default --autostart --ros-args -r cloud:=/lidar/points
  mdcs-ros2 my.yaml --ros-args -p transport.epsilon:=2.5 -p qos_reliability:=best_effort
Without --autostart the node waits for a lifecycle manager to configure and activate it.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    own, ros = _split(given)
    chosen = _parser().parse_args(own)
    try:
        return _run(chosen, ros)
    except MdcsError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code


def _split(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Return the program's own arguments, and from ``--ros-args`` on those of ROS."""
    if "--ros-args" not in arguments:
        return arguments, []
    start = arguments.index("--ros-args")
    return arguments[:start], arguments[start:]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mdcs-ros2",
        description="Run a pipeline as a ROS 2 lifecycle node: PointCloud2 in, markers and "
        "skeleton out.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("config", nargs="?", help="shipped configuration or path of a YAML file")
    parser.add_argument("--host", help="run the stages of this host alone (see docs/ros2.md)")
    parser.add_argument(
        "--autostart", action="store_true", help="configure and activate without a manager"
    )
    return parser


def _run(chosen: argparse.Namespace, ros: list[str]) -> int:
    if not any(os.environ.get(name) for name in _DISCOVERY_SET):
        os.environ[DISCOVERY] = "LOCALHOST"
    try:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        from .ros.node import SkeletonNode
        from .ros.spinning import spin_until_shutdown
    except ImportError as error:
        raise MissingExtraError(
            "the ROS 2 node needs rclpy and its messages",
            received=str(error),
            remedy="install the extra: pip install 'mdcs-pipeline[ros2]', in an environment "
            "of its own",
        ) from error
    defaults: dict[str, Any] = {"autostart": True} if chosen.autostart else {}
    for name in ("config", "host"):
        if getattr(chosen, name) is not None:
            defaults[name] = getattr(chosen, name)
    rclpy.init(args=ros)
    try:
        node = SkeletonNode(defaults)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if node.parameters.own.autostart:
            node.trigger_configure()
            node.trigger_activate()
        try:
            spin_until_shutdown(executor)
        finally:
            node.close()
            executor.shutdown()
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
