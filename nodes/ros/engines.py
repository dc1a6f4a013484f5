"""What runs the frames of a node: a whole pipeline, or one host's part of it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from mdcs_pipeline import wire
from mdcs_pipeline.errors import InputError, MdcsError
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.parts.layout import Channel, Layout
from mdcs_pipeline.parts.letters import Letter, head_text
from mdcs_pipeline.skeleton import Skeleton

from ..host import Host
from ..latest import Counts, Latest
from ..member import Given, Member, opened

# Letters of a frame that may be under way at once, with room to spare.
LETTERS = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
HELLO_SECONDS = 0.25
SILENCE_SECONDS = 5.0


@dataclass(frozen=True)
class Work:
    """What an engine needs of its node.

    Parameters
    ----------
    decode : callable
        From the clouds of a frame to points and header; raises an `MdcsError`.
    publish : callable
        Takes each skeleton.
    refuse : callable
        Takes whatever a frame failed with.
    """

    decode: Callable[[Any], Given]
    publish: Callable[[Skeleton], None]
    refuse: Callable[[Exception], None]


class Engine(Protocol):
    """Runs frames on a thread of its own."""

    @property
    def counts(self) -> Counts:
        """What became of the frames offered here."""

    def start(self) -> None:
        """Begin to work."""

    def stop(self) -> None:
        """Finish what is at work."""

    def offer(self, clouds: Any) -> None:
        """Give the clouds of a frame; newer ones push out older ones."""

    def reset(self) -> None:
        """Forget what waits, and the counts."""

    def close(self) -> None:
        """Undo what was made for the node."""

    def notes(self) -> dict[str, Any]:
        """Return what else diagnostics should tell."""


class Whole:
    """All of a pipeline, in this process.

    Parameters
    ----------
    host : Host
    work : Work
    """

    def __init__(self, host: Host, work: Work) -> None:
        self._host, self._hands = host, work
        self._worker: Latest[Any] = Latest(self._run)

    @property
    def counts(self) -> Counts:
        """What became of the frames."""
        return self._worker.counts

    def start(self) -> None:
        """Begin to work."""
        self._worker.start()

    def stop(self) -> None:
        """Finish the frame at work."""
        self._worker.stop()

    def offer(self, clouds: Any) -> None:
        """Give the clouds of a frame."""
        self._worker.offer(clouds)

    def reset(self) -> None:
        """Forget what waits, what frames left behind, and the counts."""
        self._worker.clear()
        self._host.reset()

    def close(self) -> None:
        """Nothing was made for the node."""

    def notes(self) -> dict[str, Any]:
        """Nothing else to tell."""
        return {}

    def _run(self, clouds: Any) -> bool:
        try:
            given = self._hands.decode(clouds)
            self._hands.publish(self._host.push(given.points, given.stamp_ns, given.frame_id))
        except Exception as error:
            # One bad frame must not end the node.
            self._hands.refuse(error)
            return False
        return True


class PartOf:
    """One host's part of a pipeline; letters go over topics of their own.

    Parameters
    ----------
    node : LifecycleNode
    host : Host
    name : str
        Of the host in the configuration.
    work : Work
    frame_seconds : float
        Time after which a frame counts as lost.
    """

    def __init__(
        self, node: LifecycleNode, host: Host, name: str, work: Work, frame_seconds: float
    ) -> None:
        self._node, self._hands = node, work
        self._events: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._member = Member(
            host.graph,
            name,
            self._send,
            work.publish,
            work.refuse,
            frame_seconds=frame_seconds,
            silence=SILENCE_SECONDS,
        )
        self._layout = self._member.part.layout
        self._thread: threading.Thread | None = None
        self._matched: dict[str, int] = {}
        self._wanted = _readers_of(self._layout, name)
        self._topics = {
            channel: node.create_publisher(UInt8MultiArray, topic_of(channel), LETTERS)
            for channel in [None, *self._layout.spoken(name)]
        }
        self._subscriptions = [
            self._subscribe(channel) for channel in [None, *self._layout.heard(name)]
        ]
        self._writers = {topic_of(channel): 1 for channel in self._layout.heard(name)}
        self._writers[topic_of(None)] = len(self._layout.hosts) - 1
        self._timer = node.create_timer(HELLO_SECONDS, self._on_timer)

    @property
    def counts(self) -> Counts:
        """What became of the frames that began here."""
        return self._member.counts

    def change(self, graph: Graph) -> None:
        """Run what comes with other settings."""
        self._events.put(partial(self._member.change, graph))

    def start(self) -> None:
        """Begin to work."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="letters", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Finish the stage at work; letters that come while stopped are lost."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._events.put(None)
            thread.join()

    def offer(self, clouds: Any) -> None:
        """Give the clouds of a frame."""

        def begin() -> None:
            try:
                given = self._hands.decode(clouds)
            except MdcsError as error:
                self._member.reject(error)
            else:
                self._member.offer(given)

        self._events.put(begin)

    def reset(self) -> None:
        """Forget what waits, and the counts."""
        self._events.put(self._member.clear)

    def close(self) -> None:
        """Leave the topics of the letters."""
        self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in self._topics.values():
            self._node.destroy_publisher(publisher)

    def notes(self) -> dict[str, Any]:
        """Return what this host is, and what it waits for."""
        part = self._member.part
        entry = part.host == self._layout.entry
        told = {"host": part.host, "stages": ", ".join(self._layout.stages(part.host))}
        return {**told, "waits for": part.why_not() or "nothing"} if entry else told

    def _run(self) -> None:
        while (event := self._events.get()) is not None:
            try:
                event()
            except Exception as error:
                self._hands.refuse(error)

    def _ready(self) -> bool:
        """Return whether all that listens and speaks to this host has found it."""
        heard = all(
            publisher.get_subscription_count() >= self._wanted[channel]
            for channel, publisher in self._topics.items()
        )
        return heard and all(
            self._matched.get(topic, 0) >= count for topic, count in self._writers.items()
        )

    def _on_timer(self) -> None:
        if self._thread is None:
            return
        self._post(None, self._member.part.hello(self._ready()))
        self._events.put(self._member.tick)

    def _send(self, letter: Letter) -> None:
        self._post(letter.key[:2] if letter.kind == "value" else None, letter)

    def _post(self, channel: Channel | None, letter: Letter) -> None:
        message = UInt8MultiArray()
        message.data = wire.to_bytes(letter.message, head_text(letter))
        self._topics[channel].publish(message)

    def _subscribe(self, channel: Channel | None) -> Any:
        topic = topic_of(channel)

        def matched(event: Any) -> None:
            self._matched[topic] = event.current_count

        return self._node.create_subscription(
            UInt8MultiArray,
            topic,
            self._on_letter,
            LETTERS,
            event_callbacks=SubscriptionEventCallbacks(matched=matched),
        )

    def _on_letter(self, message: UInt8MultiArray) -> None:
        if self._thread is not None:
            self._events.put(partial(self._open, message))

    def _open(self, message: UInt8MultiArray) -> None:
        head, held = wire.from_bytes(message.data)
        part = self._member.part
        try:
            self._member.receive(opened(part, head, held))
        except InputError as error:
            self._hands.refuse(error)


def topic_of(channel: Channel | None) -> str:
    """Return the topic of a channel, relative to the node's namespace; None is the turn's."""
    if channel is None:
        return "parts/turn"
    origin, port = (name.replace("-", "_") for name in channel)
    # A source is called sources.NAME, and its port NAME again.
    return f"parts/{origin.replace('.', '/')}" if "." in origin else f"parts/{origin}/{port}"


def _readers_of(layout: Layout, host: str) -> dict[Channel | None, int]:
    readers: dict[Channel | None, int] = {None: len(layout.hosts) - 1}
    readers.update((channel, len(hosts)) for channel, hosts in layout.readers().items())
    return {k: count for k, count in readers.items() if k is None or layout.host(k[0]) == host}
