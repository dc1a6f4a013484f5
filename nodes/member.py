"""One host of a cut graph at work: clouds that wait, letters, results, counts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from mdcs_pipeline import wire
from mdcs_pipeline.errors import MdcsError
from mdcs_pipeline.graph import Graph
from mdcs_pipeline.header import Header
from mdcs_pipeline.ingest import as_point_cloud
from mdcs_pipeline.parts.letters import Letter, read_head
from mdcs_pipeline.parts.part import Part
from mdcs_pipeline.parts.state import Step
from mdcs_pipeline.pipeline import recorded, result_name
from mdcs_pipeline.skeleton import Skeleton

from .latest import Counts


@dataclass(frozen=True)
class Given:
    """Points by source, and the header that they share."""

    points: Mapping[str, Any]
    stamp_ns: int
    frame_id: str


class Member:
    """A part, and the clouds that wait for it; for one thread.

    Parameters
    ----------
    graph : Graph
    host : str
    send : callable
        Takes each letter, in order.
    publish : callable
        Takes each skeleton, at the exit.
    refuse : callable
        Takes the error of each frame that failed, at the entry, and of each bad letter.
    waiting : int
        Clouds that wait at the entry; more than these push out the oldest.
    **options
        Of `Part`.
    """

    def __init__(
        self,
        graph: Graph,
        host: str,
        send: Callable[[Letter], None],
        publish: Callable[[Skeleton], None],
        refuse: Callable[[MdcsError], None],
        waiting: int = 1,
        **options: Any,
    ) -> None:
        self.part = Part(graph, host, **options)
        self._graph = graph
        self._send, self._publish, self._refuse = send, publish, refuse
        self._most = waiting
        self._waiting: deque[Given] = deque()
        self._result = result_name(graph)
        self._begun = 0
        self.counts = Counts()

    def change(self, graph: Graph) -> None:
        """Run what comes with other settings."""
        self._graph = graph
        self.part.change(graph)

    @property
    def idle(self) -> bool:
        """Whether nothing waits here or is under way from here."""
        return not self._waiting and not self.part.under_way

    def offer(self, given: Given) -> None:
        """Give a cloud of each source; begin with it now or when its turn comes."""
        self.counts = replace(self.counts, offered=self.counts.offered + 1)
        self._waiting.append(given)
        while len(self._waiting) > self._most:
            self._waiting.popleft()
            self.counts = replace(self.counts, replaced=self.counts.replaced + 1)
        self._go_on()

    def reject(self, error: MdcsError) -> None:
        """Count a cloud that could not even be read."""
        self.counts = replace(self.counts, offered=self.counts.offered + 1)
        self._failed(error)

    def receive(self, letter: Letter) -> None:
        """Take a letter from another host; a bad one is refused and forgotten."""
        try:
            step = self.part.receive(letter)
        except MdcsError as error:
            self._refuse(error.located(f"letter from '{letter.sender}'"))
            return
        self._take(step)
        self._go_on()

    def tick(self) -> None:
        """Send again what may be lost, give up what takes too long, begin what can."""
        self._take(self.part.tick())
        self._go_on()

    def clear(self) -> None:
        """Drop what waits, and begin the counts again."""
        self._waiting.clear()
        self.counts = Counts()

    def _go_on(self) -> None:
        while self._waiting and self.part.why_not() is None:
            given = self._waiting.popleft()
            try:
                clouds = self._clouds(given)
                dropped = sum(cloud.dropped for cloud in clouds.values())
                step = self.part.begin(clouds, {"dropped": dropped})
            except MdcsError as error:
                self._failed(error)
                continue
            self._begun += 1
            self._take(step)

    def _clouds(self, given: Given) -> dict[str, Any]:
        header = Header(given.frame_id, given.stamp_ns, self._begun)
        sources = self._graph.spec.sources
        clouds = {}
        for name, points in given.points.items():
            try:
                nonfinite = sources[name].nonfinite if name in sources else "drop"
                clouds[name] = as_point_cloud(points, header, nonfinite)
            except MdcsError as error:
                raise error.located(f"source '{name}'") from error
        return clouds

    def _take(self, step: Step) -> None:
        for result in step.results:
            held = result.record.results[self._result]
            self._publish(recorded(held, result.record, int(result.notes.get("dropped", 0))))
        for letter in step.letters:
            self._send(letter)
        for ended in step.ended:
            if ended.error is None:
                self.counts = replace(self.counts, done=self.counts.done + 1)
            else:
                self._failed(ended.error)

    def _failed(self, error: MdcsError) -> None:
        self.counts = replace(self.counts, failed=self.counts.failed + 1)
        self._refuse(error)


def opened(part: Part, head: str, held: Any) -> Letter:
    """Return the letter of a head and what came with it, the message as its port has it.

    Raises
    ------
    InputError
        If it is no letter, or its message is not one of its port.
    """
    letter = read_head(head)
    if letter.kind != "value":
        return letter
    origin, port, _ = letter.key
    kind = part.layout.message_type((origin, port))
    return replace(letter, message=wire.from_arrow(held, kind))
