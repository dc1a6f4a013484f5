"""The lifecycle node: clouds in, a skeleton and its markers out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from mdcs_pipeline.cli.compiling import NOTICE, kernels_cached
from mdcs_pipeline.errors import ConfigError, MdcsError
from mdcs_pipeline.io.record import json_bytes
from mdcs_pipeline.io.write import write_skeleton
from mdcs_pipeline.skeleton import Skeleton

from ..latest import Latest
from .diagnostics import Diagnostics, Progress, diagnostic_array
from .inputs import Inputs, points_of
from .markers import Markers
from .parameters import Parameters

NAME = "mdcs"
NANO = 1_000_000_000
Clouds = dict[str, PointCloud2]

# One who joins late gets the latest result.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


class SkeletonNode(LifecycleNode):
    """A node that runs one pipeline.

    Parameters
    ----------
    defaults : dict
        Of the node's own parameters, under what the command line says.

    Raises
    ------
    ConfigError
        If the configuration or a parameter does not fit.
    """

    def __init__(self, defaults: dict[str, Any]) -> None:
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True)
        self._state = "unconfigured"
        self.parameters = Parameters(self, defaults, lambda: self._state != "unconfigured")
        self.host = self.parameters.host
        if not self.host.spec.sources:
            raise ConfigError(
                f"the pipeline '{self.host.spec.name}' has no sources",
                where=self.host.spec.file,
                remedy="add 'sources:'; each is a topic that clouds arrive on",
            )
        self._worker: Latest[Clouds] = Latest(self._work)
        self._markers = Markers()
        self._progress = Progress()
        self._latest: Skeleton | None = None
        self._inputs: Inputs | None = None

    # Transitions, in the order of a node's life.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make publishers, subscriptions and services."""
        if not kernels_cached():
            self.get_logger().info(NOTICE)
        own = self.parameters.own
        self._marker_topic = self.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._skeleton_topic = self.create_publisher(String, "~/skeleton", LATCHED)
        self._diagnostics_topic = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._reset_service = self.create_service(Trigger, "~/reset", self._on_reset)
        self._save_service = self.create_service(Trigger, "~/save", self._on_save)
        self._diagnostics = Diagnostics(self.get_fully_qualified_name(), self.host.spec.name)
        self._timer = self.create_timer(own.diagnostics_period, self._on_timer)
        self._inputs = Inputs(self, list(self.host.spec.sources), own, self._on_frame)
        self._state = "inactive"
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to take clouds."""
        self._worker.start()
        self._state = "active"
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Finish the frame at work and take no more; the latest result stays."""
        self._state = "inactive"
        self._worker.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take what is shown away, and undo the configuration."""
        self._forget()
        self._unmake()
        self._state = "unconfigured"
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End from any state."""
        self.close()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a transition that failed, be as if never configured."""
        self.close()
        return super().on_error(state)

    def close(self) -> None:
        """End the work, whatever the state."""
        self._state = "unconfigured"
        self._worker.stop()
        self._unmake()

    def _unmake(self) -> None:
        if self._inputs is None:
            return
        self._inputs.close()
        self._inputs = None
        self.destroy_timer(self._timer)
        for service in (self._reset_service, self._save_service):
            self.destroy_service(service)
        for publisher in (self._marker_topic, self._skeleton_topic, self._diagnostics_topic):
            self.destroy_publisher(publisher)

    # Frames.

    def _on_frame(self, clouds: Clouds) -> None:
        self._progress.cloud_at = time.monotonic()
        if self._state == "active":
            self._worker.offer(clouds)

    def _work(self, clouds: Clouds) -> bool:
        began = time.perf_counter()
        inputs = self._inputs
        try:
            poses = None if inputs is None else inputs.poses
            points, stamp_ns, frame_id = points_of(clouds, poses, self.parameters.own.pose_wait)
            skeleton = self.host.push(points, stamp_ns, frame_id)
            self._publish(skeleton)
        except MdcsError as error:
            self._progress.error = str(error)
            self.get_logger().warning(f"frame refused: {error}", throttle_duration_sec=2.0)
            return False
        except Exception as error:
            # One bad frame must not end the node; what it was is told.
            self._progress.error = f"{type(error).__name__}: {error}"
            self.get_logger().error(f"frame failed: {self._progress.error}")
            return False
        progress = self._progress
        progress.error = ""
        progress.seconds = time.perf_counter() - began
        progress.points = sum(len(held) for held in points.values())
        progress.nodes = len(skeleton)
        progress.lag = (self.get_clock().now().nanoseconds - stamp_ns) / NANO
        return True

    def _publish(self, skeleton: Skeleton) -> None:
        own = self.parameters.own
        markers = self._markers.show(skeleton, own.line_width, own.node_size)
        self._skeleton_topic.publish(String(data=json_bytes(skeleton).decode()))
        self._marker_topic.publish(markers)
        self._latest = skeleton

    # Services and timers.

    def _on_reset(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        self._forget()
        answer.success, answer.message = True, "frames and counts forgotten"
        return answer

    def _forget(self) -> None:
        self._worker.clear()
        self.host.reset()
        self._marker_topic.publish(self._markers.clear())
        self._latest = None
        self._progress = Progress()
        if self._inputs is not None:
            self._inputs.clear()

    def _on_save(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        skeleton, own = self._latest, self.parameters.own
        if skeleton is None:
            answer.success, answer.message = False, "there is no skeleton yet"
            return answer
        name = own.save_name.replace("{stamp}", str(skeleton.header.stamp_ns))
        path = Path(own.save_folder).expanduser().absolute() / name
        try:
            write_skeleton(skeleton, path, settings=self.host.settings())
        except MdcsError as error:
            answer.success, answer.message = False, str(error)
            return answer
        answer.success, answer.message = True, str(path)
        return answer

    def _on_timer(self) -> None:
        if self._inputs is None:
            return
        statuses = self._diagnostics.statuses(
            self._state,
            self._inputs.counts,
            self._worker.counts,
            self._progress,
            self.parameters.own.stale_after,
            {},
        )
        stamp = self.get_clock().now().to_msg()
        self._diagnostics_topic.publish(diagnostic_array(stamp, statuses))
