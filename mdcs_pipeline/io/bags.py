"""Clouds and poses from bags of ROS 1 and ROS 2, without ROS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Literal, NamedTuple

from mdcs_pipeline.errors import InputError, MdcsError, MissingExtraError, suggestion
from mdcs_pipeline.frames import Frame
from mdcs_pipeline.io.point_cloud2 import decode_points, stamp_to_ns
from mdcs_pipeline.io.pose_track import PoseTrack

BAG_SUFFIXES = (".mcap", ".db3", ".bag")
CLOUD = "sensor_msgs/msg/PointCloud2"
POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)


class Topic(NamedTuple):
    """One topic of a bag.

    Attributes
    ----------
    name : str
    type : str
        As ROS 2 spells it, such as ``sensor_msgs/msg/PointCloud2``.
    messages : int
        How many there are.
    """

    name: str
    type: str
    messages: int


def is_bag(path: str | Path) -> bool:
    """Return whether a path looks like a bag: by its suffix, or a rosbag2 folder."""
    path = Path(path)
    return path.suffix.lower() in BAG_SUFFIXES or (path / "metadata.yaml").is_file()


def bag_topics(path: str | Path) -> list[Topic]:
    """Return the topics of a bag, by name.

    Raises
    ------
    InputError
        If there is no such bag, or it is damaged.
    MissingExtraError
        Without the extra ``bags``.
    """
    with _opened(Path(path)) as reader:
        return _topics(reader)


class BagFrames:
    """The clouds of one topic in the order in which they were recorded.

    Parameters
    ----------
    path : str or Path
        A rosbag2 folder, a lone ``.mcap`` or ``.db3``, or a ``.bag`` of ROS 1.
    topic : str, optional
        A PointCloud2 topic; may be left out if there is only one.
    poses : str, optional
        A topic of PoseStamped, PoseWithCovarianceStamped or Odometry; each cloud gets the
        pose at its stamp, interpolated.
    tolerance_ns : int
        How far from a cloud a pose may lie in time.
    unposed : {"skip", "refuse"}
        What to do with clouds that have no pose near them, as at the start of a recording;
        those skipped are counted.

    Attributes
    ----------
    topic : Topic
    pose_frame : str
        Frame that the poses lead into, once iteration has begun; empty without poses.
    skipped : int
        Clouds without a pose that the latest iteration left out.

    Raises
    ------
    InputError
        If there is no such bag or topic, or it is damaged.
    MissingExtraError
        Without the extra ``bags``.

    Notes
    -----
    Stamps are those of the messages' headers; where they are 0, as some drivers leave them,
    the time of recording.
    """

    def __init__(
        self,
        path: str | Path,
        topic: str | None = None,
        *,
        poses: str | None = None,
        tolerance_ns: int = 100_000_000,
        unposed: Literal["skip", "refuse"] = "skip",
    ) -> None:
        self.path = Path(path).expanduser()
        self.tolerance_ns = tolerance_ns
        self.unposed = unposed
        self.pose_frame = ""
        self.skipped = 0
        with _opened(self.path) as reader:
            topics = _topics(reader)
        try:
            self.topic = _choose(topics, topic, (CLOUD,))
            self._poses = None if poses is None else _choose(topics, poses, POSES)
        except InputError as error:
            raise error.located(str(self.path)) from error

    def __len__(self) -> int:
        return self.topic.messages

    def __iter__(self) -> Iterator[Frame]:
        return self.since(0)

    def since(self, first: int) -> Iterator[Frame]:
        """Iterate from the cloud of number `first`, counted from 0."""
        self.skipped = 0
        with _opened(self.path) as reader:
            track = None if self._poses is None else self._track(reader, self._poses)
            messages = _messages(reader, self.topic.name, self.path)
            for number, (recorded, cloud) in enumerate(islice(messages, first, None), first):
                try:
                    frame = self._frame(cloud, recorded, track)
                except InputError as error:
                    place = f"{self.path}, {self.topic.name}, message {number}"
                    raise error.located(place) from error
                if frame is None:
                    self.skipped += 1
                else:
                    yield frame

    def _frame(self, cloud: Any, recorded: int, track: PoseTrack | None) -> Frame | None:
        stamp = stamp_to_ns(cloud.header.stamp) or recorded
        frame = Frame(stamp, str(cloud.header.frame_id), decode_points(cloud))
        if track is None:
            return frame
        pose = track.at(stamp, self.tolerance_ns)
        if pose is not None:
            return frame._replace(pose=pose)
        if self.unposed == "skip":
            return None
        raise InputError(
            "no pose is near the cloud in time",
            received=f"stamp {stamp} ns, {len(track)} poses",
            remedy="raise the tolerance, or let such clouds be skipped",
        )

    def _track(self, reader: Any, topic: Topic) -> PoseTrack:
        stamps, places, turns, frames = [], [], [], set()
        for recorded, message in _messages(reader, topic.name, self.path):
            pose = message.pose
            pose = getattr(pose, "pose", pose)
            place, turn = pose.position, pose.orientation
            stamps.append(stamp_to_ns(message.header.stamp) or recorded)
            places.append((place.x, place.y, place.z))
            turns.append((turn.x, turn.y, turn.z, turn.w))
            frames.add(str(message.header.frame_id))
        where = f"{self.path}, {topic.name}"
        if len(frames) > 1:
            raise InputError(
                "the poses are in several frames", where=where, received=", ".join(sorted(frames))
            )
        self.pose_frame = next(iter(frames), "")
        try:
            return PoseTrack(stamps, places, turns)
        except InputError as error:
            raise error.located(where) from error


def _choose(topics: list[Topic], name: str | None, types: tuple[str, ...]) -> Topic:
    fitting = [topic for topic in topics if topic.type in types]
    listed = ", ".join(f"{topic.name} ({topic.type}, {topic.messages})" for topic in topics)
    what = " or ".join(kind.rpartition("/")[2] for kind in types)
    if name is None:
        if len(fitting) == 1:
            return fitting[0]
        raise InputError(
            f"the bag has {len(fitting) or 'no'} topics of {what}, where one was wanted",
            received=listed or "no topics",
            remedy="name the topic" if fitting else "record one",
        )
    for topic in topics:
        if topic.name != name:
            continue
        if topic.type in types:
            return topic
        raise InputError(f"the topic '{name}' is no {what}", received=topic.type)
    raise InputError(
        f"the bag has no topic '{name}'",
        received=listed or "no topics",
        remedy=suggestion(name, [topic.name for topic in fitting]),
    )


def _topics(reader: Any) -> list[Topic]:
    return [
        Topic(name, kept.msgtype or "several types", kept.msgcount)
        for name, kept in sorted(reader.topics.items())
    ]


def _messages(reader: Any, topic: str, path: Path) -> Iterator[tuple[int, Any]]:
    wanted = [connection for connection in reader.connections if connection.topic == topic]
    with _damage(path):
        for connection, recorded, raw in reader.messages(connections=wanted):
            yield recorded, reader.deserialize(raw, connection.msgtype)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "reading bags needs the package rosbags",
            received=str(error),
            remedy="pip install 'mdcs-pipeline[bags]'",
        ) from error
    path = path.expanduser()
    if not path.exists():
        raise InputError("no such bag", where=str(path), remedy="is the path relative to another?")
    with _damage(path):
        # Bags of ROS 2 before Iron hold no definitions of their messages.
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    try:
        yield
    except MdcsError:
        raise
    except Exception as error:
        # What a damaged bag ends in is anything: of SQLite, of struct, of the decompressors.
        raise InputError(
            "the bag cannot be read",
            where=str(path),
            received=f"{type(error).__name__}: {error}",
            remedy="it is damaged, still being recorded, or no bag: ros2 bag reindex may help",
        ) from error
