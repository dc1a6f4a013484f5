"""The other side of a ROS node under test: a process of its own, and what it hears."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from mdcs_pipeline.io.point_cloud2 import encode_points, ns_to_stamp
from mdcs_pipeline.skeleton import Skeleton

LATCHED = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}


def program(name: str) -> str:
    return str(Path(sys.executable).with_name(name))


def start(*arguments: str, cwd: Path | None = None) -> subprocess.Popen[str]:
    """Start mdcs-ros2 in a process of its own, in this process's domain."""
    return subprocess.Popen(
        [program("mdcs-ros2"), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=cwd,
    )


def cloud_of(
    points: Any, stamp_ns: int = 0, frame_id: str = "lidar", *, double: bool = False
) -> PointCloud2:
    packed = encode_points(points, double=double)
    message = PointCloud2(
        height=packed.height,
        width=packed.width,
        is_bigendian=packed.is_bigendian,
        point_step=packed.point_step,
        row_step=packed.row_step,
        is_dense=packed.is_dense,
        fields=[
            PointField(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count)
            for f in packed.fields
        ],
    )
    message.data = packed.data.tobytes()
    stamp(message, stamp_ns, frame_id)
    return message


def stamp(message: Any, stamp_ns: int, frame_id: str) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = ns_to_stamp(stamp_ns)
    message.header.frame_id = frame_id
    return message


def pose_of(stamp_ns: int, position: Any, quaternion: Any, frame_id: str = "odom") -> PoseStamped:
    message = stamp(PoseStamped(), stamp_ns, frame_id)
    fill_pose(message.pose, position, quaternion)
    return message


def odometry_of(stamp_ns: int, position: Any, quaternion: Any, frame_id: str = "odom") -> Odometry:
    message = stamp(Odometry(), stamp_ns, frame_id)
    fill_pose(message.pose.pose, position, quaternion)
    return message


def fill_pose(pose: Any, position: Any, quaternion: Any) -> None:
    place, turn = pose.position, pose.orientation
    place.x, place.y, place.z = (float(value) for value in position)
    turn.x, turn.y, turn.z, turn.w = (float(value) for value in quaternion)


QUICK = ("-p", "diagnostics_period:=0.1")


def active(launch: Any, *more: str) -> Any:
    return launch("default", "--autostart", "--ros-args", *QUICK, *more)


def loaded(text: str, folder: Path) -> Skeleton:
    path = folder / "heard.json"
    path.write_text(text)
    return Skeleton.load(path)


def same(found: Skeleton, expected: Skeleton) -> None:
    for name in ("nodes", "edges", "mass", "radius", "node_ids"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


class Peer:
    """A ROS node in the test's own process that talks to one under test.

    Parameters
    ----------
    target : str
        Full name of the node under test.
    """

    def __init__(self, target: str = "/mdcs") -> None:
        self.target = target
        self.context = Context()
        self.context.init(args=[])
        self.node = Node("peer", context=self.context)
        self.skeletons: list[str] = []
        self.markers: list[MarkerArray] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.changed = threading.Condition()
        self.listen(String, f"{target}/skeleton", lambda m: self.skeletons.append(m.data), LATCHED)
        self.listen(MarkerArray, f"{target}/markers", self.markers.append, LATCHED)
        self.listen(DiagnosticArray, "/diagnostics", self.diagnostics.append, RELIABLE)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def close(self) -> None:
        self.executor.shutdown()
        self.thread.join()
        self.node.destroy_node()
        self.context.try_shutdown()

    def listen(self, kind: Any, topic: str, keep: Callable[[Any], Any], profile: Any) -> Any:
        def heard(message: Any) -> None:
            with self.changed:
                keep(message)
                self.changed.notify_all()

        return self.node.create_subscription(kind, topic, heard, profile)

    def wait(self, happened: Callable[[], Any], what: str, seconds: float = 60.0) -> Any:
        end = time.monotonic() + seconds
        while not (found := happened()):
            left = end - time.monotonic()
            assert left > 0, f"waited {seconds:g} s in vain: {what}"
            with self.changed:
                self.changed.wait(min(left, 0.05))
        return found

    def publisher(self, kind: Any = PointCloud2, topic: str = "cloud", qos: Any = RELIABLE) -> Any:
        made = self.node.create_publisher(kind, topic, qos)
        self.wait(lambda: made.get_subscription_count() > 0, f"a subscription to {topic}")
        return made

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, f"{self.target}/{name}")
        try:
            assert client.wait_for_service(timeout_sec=60.0), f"no service {name}"
            future = client.call_async(request)
            self.wait(future.done, f"an answer of {name}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def trigger(self, name: str) -> Any:
        return self.call(Trigger, name, Trigger.Request())

    def change_state(self, *names: str) -> bool:
        went_well = True
        for name in names:
            request = ChangeState.Request(transition=Transition(id=TRANSITIONS[name]))
            went_well &= self.call(ChangeState, "change_state", request).success
        return went_well

    def state(self) -> str:
        label: str = self.call(GetState, "get_state", GetState.Request()).current_state.label
        return label

    def set(self, **values: Any) -> Any:
        """Set one parameter, its dots written as two underscores; return the result."""
        ((name, value),) = values.items()
        parameter = Parameter(name.replace("__", "."), value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        return self.call(SetParameters, "set_parameters", request).results[0]

    def set_together(self, values: dict[str, Any]) -> Any:
        parameters = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        return self.call(SetParametersAtomically, "set_parameters_atomically", request).result

    def get(self, *names: str) -> list[Any]:
        request = GetParameters.Request(names=list(names))
        held = self.call(GetParameters, "get_parameters", request).values
        return [parameter_value_to_python(value) for value in held]

    def parameter_names(self) -> list[str]:
        answer = self.call(ListParameters, "list_parameters", ListParameters.Request())
        return list(answer.result.names)

    def describe(self, name: str) -> Any:
        request = DescribeParameters.Request(names=[name])
        return self.call(DescribeParameters, "describe_parameters", request).descriptors[0]

    def status(self, part: str) -> tuple[bytes, str, dict[str, str]] | None:
        """Return level, message and values of the latest diagnostics of a part."""
        for array in reversed(self.diagnostics):
            for status in array.status:
                if status.name == f"{self.target}: {part}":
                    values = {item.key: item.value for item in status.values}
                    return status.level, status.message, values
        return None

    def wait_status(
        self, part: str, fits: Callable[[bytes, str, dict[str, str]], bool], what: str
    ) -> dict[str, str]:
        def fitting() -> dict[str, str] | None:
            found = self.status(part)
            return found[2] if found is not None and fits(*found) else None

        found: dict[str, str] = self.wait(fitting, what)
        return found


OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR
STALE = DiagnosticStatus.STALE


def limb(count: int = 400, seed: int = 0, length: float = 2.0) -> np.ndarray:
    """Return the surface of a tube along x, in float32 as it travels."""
    rng = np.random.default_rng(seed)
    along, around = rng.uniform(0, length, count), rng.uniform(0, 2 * np.pi, count)
    return np.c_[along, 0.1 * np.cos(around), 0.1 * np.sin(around)].astype(np.float32)


def cross(count: int = 400, seed: int = 0) -> np.ndarray:
    """Return two tubes that meet, so that the skeleton has a junction."""
    first = limb(count // 2, seed) - [1, 0, 0]
    second = limb(count // 2, seed + 1)[:, [1, 0, 2]] - [0, 1, 0]
    return np.concatenate([first, second]).astype(np.float32)


def domain() -> str:
    # Of this test run, so that two on one machine do not hear each other.
    return str(1 + os.getpid() % 100)


def end(process: subprocess.Popen[str], signals: Sequence[int] = ()) -> str:
    """End a process kindly, then by force; return what it said."""
    for number in signals:
        process.send_signal(number)
    if not signals:
        process.terminate()
    try:
        said, _ = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        said, _ = process.communicate()
    return said
