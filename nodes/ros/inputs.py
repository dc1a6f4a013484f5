"""What comes in: clouds, a set of several sources at a time, and poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from sensor_msgs.msg import PointCloud2

from mdcs_pipeline.errors import InputError, MdcsError
from mdcs_pipeline.io.point_cloud2 import decode_points, stamp_to_ns
from mdcs_pipeline.poses import posed

from ..poses import PoseBuffer, make_pose
from .settings import NodeSettings

NANO = 1_000_000_000


@dataclass
class InputCounts:
    """What reached the node, by message.

    Parameters
    ----------
    clouds, poses : int
    unmatched : int
        Clouds of one source that found no partner of the others in time.
    bad_poses : int
    lost : int
        Messages that the middleware reports as lost on their way.
    publishers : dict of int
        By topic, how many publish now.
    """

    clouds: int = 0
    poses: int = 0
    unmatched: int = 0
    bad_poses: int = 0
    lost: int = 0
    publishers: dict[str, int] | None = None


class Inputs:
    """The subscriptions of a node.

    Parameters
    ----------
    node : LifecycleNode
    sources : list of str
        Names of the graph's sources, which are the topics too.
    settings : NodeSettings
    on_frame : callable
        Takes one cloud of each source.
    """

    def __init__(
        self,
        node: LifecycleNode,
        sources: list[str],
        settings: NodeSettings,
        on_frame: Callable[[dict[str, PointCloud2]], None],
    ) -> None:
        self._node = node
        self._settings = settings
        self._on_frame = on_frame
        self._held: dict[str, PointCloud2 | None] = dict.fromkeys(sources)
        self._topics: dict[str, tuple[Any, Callable[[Any], None]]] = {
            source: (PointCloud2, partial(self._on_cloud, source)) for source in sources
        }
        self.poses: PoseBuffer | None = None
        if settings.pose_type != "none":
            self.poses = PoseBuffer(round(settings.pose_tolerance * NANO))
            kind = PoseStamped if settings.pose_type == "pose_stamped" else Odometry
            self._topics["pose"] = (kind, self._on_pose)
        self.counts = InputCounts(publishers=dict.fromkeys(self._topics, 0))
        self.reliability = dict.fromkeys(
            self._topics,
            ReliabilityPolicy.BEST_EFFORT
            if settings.qos_reliability == "best_effort"
            else ReliabilityPolicy.RELIABLE,
        )
        self._subscriptions = {topic: self._subscribe(topic) for topic in self._topics}

    def close(self) -> None:
        """End all subscriptions."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def clear(self) -> None:
        """Forget what waits for a partner, and the counts."""
        self._held = dict.fromkeys(self._held)
        self.counts = InputCounts(publishers=self.counts.publishers)
        if self.poses is not None:
            self.poses.clear()

    def _subscribe(self, topic: str) -> Any:
        kind, callback = self._topics[topic]
        durability = (
            DurabilityPolicy.TRANSIENT_LOCAL
            if self._settings.qos_durability == "transient_local"
            else DurabilityPolicy.VOLATILE
        )
        depth = self._settings.qos_depth if topic != "pose" else 100
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=depth,
            reliability=self.reliability[topic],
            durability=durability,
        )
        events = SubscriptionEventCallbacks(
            incompatible_qos=partial(self._on_incompatible, topic),
            message_lost=self._on_lost,
            matched=partial(self._on_matched, topic),
        )
        return self._node.create_subscription(
            kind, topic, callback, profile, event_callbacks=events
        )

    def _on_lost(self, event: Any) -> None:
        self.counts.lost += event.total_count_change

    def _on_matched(self, topic: str, event: Any) -> None:
        assert self.counts.publishers is not None
        self.counts.publishers[topic] = event.current_count

    def _on_incompatible(self, topic: str, event: Any) -> None:
        logger = self._node.get_logger()
        yields = (
            self._settings.qos_reliability == "auto"
            and event.last_policy_kind == QoSPolicyKind.RELIABILITY
            and self.reliability[topic] == ReliabilityPolicy.RELIABLE
        )
        if not yields:
            logger.warning(
                f"a publisher on '{topic}' offers a QoS that does not fit, nothing comes from "
                "it; set qos_reliability or qos_durability"
            )
            return
        logger.info(f"a publisher on '{topic}' offers best effort; asking for no more")
        self.reliability[topic] = ReliabilityPolicy.BEST_EFFORT
        old = self._subscriptions[topic]
        self._subscriptions[topic] = self._subscribe(topic)
        # Not from within its own event.
        timer: Any = None

        def retire() -> None:
            self._node.destroy_timer(timer)
            self._node.destroy_subscription(old)

        timer = self._node.create_timer(0.0, retire)

    def _on_cloud(self, source: str, message: PointCloud2) -> None:
        self.counts.clouds += 1
        if len(self._held) == 1:
            self._on_frame({source: message})
            return
        if self._held[source] is not None:
            self.counts.unmatched += 1
        self._held[source] = message
        whole = together(self._held, round(self._settings.sync_tolerance * NANO))
        if whole is not None:
            self._held = dict.fromkeys(self._held)
            self._on_frame(whole)

    def _on_pose(self, message: Any) -> None:
        self.counts.poses += 1
        held = message.pose.pose if isinstance(message, Odometry) else message.pose
        place, turn = held.position, held.orientation
        try:
            pose = make_pose(
                stamp_to_ns(message.header.stamp),
                message.header.frame_id,
                (place.x, place.y, place.z),
                (turn.x, turn.y, turn.z, turn.w),
            )
        except MdcsError as error:
            self.counts.bad_poses += 1
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        if self.poses is not None:
            self.poses.add(pose)


def together(
    held: dict[str, PointCloud2 | None], tolerance_ns: int
) -> dict[str, PointCloud2] | None:
    """Return the clouds if there is one of each source and their stamps are near."""
    whole = {name: cloud for name, cloud in held.items() if cloud is not None}
    if len(whole) < len(held):
        return None
    stamps = [stamp_to_ns(cloud.header.stamp) for cloud in whole.values()]
    return whole if max(stamps) - min(stamps) <= tolerance_ns else None


def points_of(
    clouds: dict[str, PointCloud2], poses: PoseBuffer | None, pose_wait: float
) -> tuple[dict[str, Any], int, str]:
    """Return the points by source, with the stamp and the frame of the first one.

    With poses, the points are led into the frame of the poses, and that frame is returned.

    Raises
    ------
    InputError
        If a cloud cannot be read, clouds are of different frames, or there is no pose.
    """
    headers = [cloud.header for cloud in clouds.values()]
    frames = {header.frame_id for header in headers}
    if len(frames) > 1:
        raise InputError(
            "the clouds are of different frames",
            received=", ".join(sorted(frames)),
            remedy="transform them into one frame first",
        )
    stamp_ns = stamp_to_ns(headers[0].stamp)
    points: dict[str, Any] = {}
    frame_id = headers[0].frame_id
    for source, cloud in clouds.items():
        try:
            decoded = decode_points(cloud)
        except InputError as error:
            raise error.located(f"source '{source}'") from error
        if poses is not None:
            pose, frame_id = poses.wait(stamp_to_ns(cloud.header.stamp), pose_wait)
            decoded = posed(decoded, pose)
        points[source] = decoded
    return points, stamp_ns, frame_id
