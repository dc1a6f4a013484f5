"""The lifecycle node: clouds in, a skeleton and its markers out."""

from __future__ import annotations

import threading
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
from mdcs_pipeline.parts.layout import Layout, check_host, layout_of
from mdcs_pipeline.skeleton import Skeleton

from ..member import Given
from .diagnostics import Diagnostics, Progress, diagnostic_array
from .engines import Engine, PartOf, Whole, Work
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
        # Several hosts of one graph stand side by side.
        name = f"{NAME}_{defaults['host']}" if defaults.get("host") else NAME
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self._state = "unconfigured"
        self.parameters = Parameters(self, defaults, lambda: self._state != "unconfigured")
        self.host = self.parameters.host
        if not self.host.spec.sources:
            raise ConfigError(
                f"the pipeline '{self.host.spec.name}' has no sources",
                where=self.host.spec.file,
                remedy="add 'sources:'; each is a topic that clouds arrive on",
            )
        self._layout = None if not self.parameters.own.host else self._laid_out()
        self._engine: Engine | None = None
        self._markers = Markers()
        # Results are shown from the thread of the frames, and taken away from the executor's.
        self._showing = threading.Lock()
        self._progress = Progress()
        self._latest: Skeleton | None = None
        self._inputs: Inputs | None = None

    def _laid_out(self) -> Layout:
        layout = layout_of(self.host.graph)
        check_host(layout, self.parameters.own.host)
        return layout

    @property
    def is_entry(self) -> bool:
        """Whether frames begin here."""
        return self._layout is None or self._layout.entry == self.parameters.own.host

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
        sources = list(self.host.spec.sources) if self.is_entry else []
        self._inputs = Inputs(self, sources, own, self._on_frame)
        self._engine = self._make_engine()
        self._state = "inactive"
        return super().on_configure(state)

    def _make_engine(self) -> Engine:
        work, own = Work(self._decode, self._publish, self._refuse), self.parameters.own
        if not own.host:
            return Whole(self.host, work)
        part = PartOf(self, self.host, own.host, work, own.frame_timeout)
        self.parameters.on_change = part.change
        return part

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to take clouds."""
        assert self._engine is not None
        self._engine.start()
        self._state = "active"
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Finish the frame at work and take no more; the latest result stays."""
        assert self._engine is not None
        self._state = "inactive"
        self._engine.stop()
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
        if self._engine is not None:
            self._engine.stop()
        self._unmake()

    def _unmake(self) -> None:
        if self._inputs is None or self._engine is None:
            return
        self._inputs.close()
        self._engine.close()
        self._inputs = self._engine = None
        self.parameters.on_change = None
        self.destroy_timer(self._timer)
        for service in (self._reset_service, self._save_service):
            self.destroy_service(service)
        for publisher in (self._marker_topic, self._skeleton_topic, self._diagnostics_topic):
            self.destroy_publisher(publisher)

    # Frames.

    def _on_frame(self, clouds: Clouds) -> None:
        self._progress.cloud_at = time.monotonic()
        if self._state == "active" and self._engine is not None:
            self._engine.offer(clouds)

    def _decode(self, clouds: Clouds) -> Given:
        poses = None if self._inputs is None else self._inputs.poses
        points, stamp_ns, frame_id = points_of(clouds, poses, self.parameters.own.pose_wait)
        self._progress.points = sum(len(held) for held in points.values())
        return Given(points, stamp_ns, frame_id)

    def _refuse(self, error: Exception) -> None:
        if isinstance(error, MdcsError):
            self._progress.error = str(error)
            self.get_logger().warning(f"frame refused: {error}", throttle_duration_sec=2.0)
            return
        # One bad frame must not end the node; what it was is told.
        self._progress.error = f"{type(error).__name__}: {error}"
        self.get_logger().error(f"frame failed: {self._progress.error}")

    def _publish(self, skeleton: Skeleton) -> None:
        own, progress = self.parameters.own, self._progress
        text = String(data=json_bytes(skeleton).decode())
        with self._showing:
            markers = self._markers.show(skeleton, own.line_width, own.node_size)
            self._skeleton_topic.publish(text)
            self._marker_topic.publish(markers)
        self._latest = skeleton
        progress.error = ""
        progress.seconds = sum(skeleton.diagnostics.get("seconds", {}).values())
        progress.nodes = len(skeleton)
        now = self.get_clock().now().nanoseconds
        progress.lag = (now - skeleton.header.stamp_ns) / NANO

    # Services and timers.

    def _on_reset(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        self._forget()
        answer.success, answer.message = True, "frames and counts forgotten"
        return answer

    def _forget(self) -> None:
        if self._engine is not None:
            self._engine.reset()
        with self._showing:
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
        if self._inputs is None or self._engine is None:
            return
        statuses = self._diagnostics.statuses(
            self._state,
            self._inputs.counts,
            self._engine.counts,
            self._progress,
            self.parameters.own.stale_after,
            self._engine.notes(),
        )
        stamp = self.get_clock().now().to_msg()
        self._diagnostics_topic.publish(diagnostic_array(stamp, statuses))
