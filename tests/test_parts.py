"""A cut graph in one process: any cut, any order of delivery, the same results."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy import LOOPS, TOYS, Number, graph_of

from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import ConfigError, InputError, MdcsError, StageError
from mdcs_pipeline.graph import Graph, build_graph
from mdcs_pipeline.ingest import as_point_cloud
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.parts.layout import layout_of
from mdcs_pipeline.parts.letters import Letter, head_text, read_head
from mdcs_pipeline.parts.part import Part
from mdcs_pipeline.parts.state import Ended, Step
from mdcs_pipeline.runner import Runner, RunRecord
from mdcs_pipeline.stage import stage_class

FORK = """
sources: {cloud: {}}
stages:
  size: {stage: size, inputs: {cloud: sources.cloud}}
  left: {stage: add, inputs: {number: size.number}, settings: {by: 1}}
  right: {stage: add, inputs: {number: size.number}, settings: {by: 2}}
  hush: {stage: silent, inputs: {number: right.number}}
  join: {stage: join, inputs: {numbers: [right.number, left.number, size.number]}}
  maybe: {stage: maybe, inputs: {number: hush.number}}
  last: {stage: add, inputs: {number: join.number, other: maybe.number}}
results: {number: last.number, size: size.number, cloud: sources.cloud}
"""


def placed(graph: Graph, hosts: Sequence[str]) -> Graph:
    """Return the graph with its stages on these hosts, taken in turn."""
    stages = {
        name: replace(stage, host=hosts[k % len(hosts)])
        for k, (name, stage) in enumerate(graph.spec.stages.items())
    }
    spec = replace(graph.spec, stages=stages)
    known = {**TOYS}
    return build_graph(spec, lambda name: known.get(name) or stage_class(name))


class Post:
    """Parts that write to each other, with letters in any order that a network may choose.

    Letters of one channel between two hosts keep their order, as both transports promise.
    """

    def __init__(self, graph: Graph, seed: int = 0, loss: float = 0, **options: Any) -> None:
        self.graph, self.options, self.loss = graph, options, loss
        self.layout = layout_of(graph)
        self.random = random.Random(seed)
        self.parts = {host: Part(graph, host, **options) for host in self.layout.hosts}
        self.entry = self.parts[self.layout.entry]
        self.boxes: dict[Any, list[Letter]] = {}
        self.results: list[tuple[int, RunRecord]] = []
        self.ended: list[Ended] = []
        self.sent = 0
        for part in self.parts.values():
            self.send(part.hello())
        self.deliver()

    def send(self, letter: Letter) -> None:
        self.sent += 1
        copy = replace(read_head(head_text(letter)), message=letter.message)
        channel = copy.key[:2] if copy.kind == "value" else None
        heard = self.layout.readers().get(channel, ()) if channel else self.layout.hosts
        for host in heard:
            lost = letter.kind != "hello" and self.random.random() < self.loss
            if host != letter.sender and not lost:
                self.boxes.setdefault((letter.sender, host, channel), []).append(copy)

    def take(self, step: Step) -> None:
        self.results += [(result.frame, result.record) for result in step.results]
        self.ended += step.ended
        for letter in step.letters:
            self.send(letter)

    def deliver(self, at_most: float = math.inf) -> None:
        while any(self.boxes.values()) and at_most > 0:
            at_most -= 1
            ways = sorted((key for key, held in self.boxes.items() if held), key=repr)
            way = self.random.choice(ways)
            self.take(self.parts[way[1]].receive(self.boxes[way].pop(0)))

    def restart(self, host: str) -> None:
        """Put a new process in the place of one, which takes its letters with it."""
        self.parts[host] = Part(self.graph, host, **self.options)
        self.boxes = {way: held for way, held in self.boxes.items() if way[1] != host}
        self.send(self.parts[host].hello())


def cloud(count: int = 3) -> PointCloud:
    return PointCloud(np.arange(3.0 * count).reshape(count, 3))


def as_one(graph: Graph, sources: dict[str, Any]) -> RunRecord | MdcsError:
    try:
        return Runner(graph).run(sources)
    except MdcsError as error:
        return error


def alike(found: RunRecord, expected: RunRecord) -> None:
    assert found.rounds == expected.rounds
    assert found.exhausted == expected.exhausted
    assert found.firings == expected.firings
    assert found.results.keys() == expected.results.keys()
    for key, value in expected.results.items():
        if isinstance(value, Number):
            assert found.results[key] == value


@settings(max_examples=150, deadline=None)
@given(
    text=st.sampled_from([LOOPS, FORK, LOOPS.replace("max_rounds: 10}", "max_rounds: 1}")]),
    hosts=st.lists(st.sampled_from("abcd"), min_size=1, max_size=8),
    seed=st.integers(0, 2**32),
)
def test_any_cut_gives_what_one_process_gives(text: str, hosts: list[str], seed: int) -> None:
    graph = placed(graph_of(text), hosts)
    sources = {"cloud": cloud()} if graph.spec.sources else {}
    post = Post(graph, seed)
    for _ in range(2):
        post.take(post.entry.begin(sources))
        post.deliver()
    expected = as_one(graph, sources)
    assert isinstance(expected, RunRecord)
    assert [number for number, _ in post.results] == [0, 1]
    assert post.ended == [Ended(0), Ended(1)]
    for _, record in post.results:
        alike(record, expected)


@settings(max_examples=60, deadline=None)
@given(
    hosts=st.lists(st.sampled_from("abc"), min_size=2, max_size=6),
    seed=st.integers(0, 2**32),
    before=st.integers(0, 40),
    data=st.data(),
)
def test_a_host_that_starts_anew_costs_no_frame(
    hosts: list[str], seed: int, before: int, data: st.DataObject
) -> None:
    graph = placed(graph_of(LOOPS), hosts)
    post = Post(graph, seed)
    others = sorted(set(post.parts) - {post.layout.entry})
    post.take(post.entry.begin({}))
    post.deliver(at_most=before)
    if others:
        post.restart(data.draw(st.sampled_from(others)))
    post.deliver()
    # What had ended before is not run again.
    assert post.ended == [Ended(0)]
    assert {number for number, _ in post.results} == {0}
    expected = as_one(graph, {})
    assert isinstance(expected, RunRecord)
    alike(post.results[-1][1], expected)
    post.take(post.entry.begin({}))
    post.deliver()
    assert post.ended[1:] == [Ended(1)]


@settings(max_examples=60, deadline=None)
@given(
    text=st.sampled_from([LOOPS, FORK]),
    hosts=st.lists(st.sampled_from("abc"), min_size=2, max_size=6),
    seed=st.integers(0, 2**32),
    loss=st.floats(0, 0.5),
)
def test_letters_that_get_lost_cost_time_and_nothing_else(
    text: str, hosts: list[str], seed: int, loss: float
) -> None:
    now = [0.0]
    graph = placed(graph_of(text), hosts)
    sources = {"cloud": cloud()} if graph.spec.sources else {}
    post = Post(graph, seed, loss, clock=lambda: now[0], frame_seconds=1e9)
    post.take(post.entry.begin(sources))
    for _ in range(2000):
        post.deliver()
        if post.ended:
            break
        now[0] += 0.5
        for part in list(post.parts.values()):
            post.take(part.tick())
    assert post.ended == [Ended(0)]
    expected = as_one(graph, sources)
    assert isinstance(expected, RunRecord)
    ((_, record),) = post.results
    alike(record, expected)


@pytest.mark.parametrize("hosts", ["ab", "abc", "aabb"])
def test_several_frames_on_their_way(hosts: str) -> None:
    graph = placed(graph_of(FORK), hosts)
    post = Post(graph, in_flight=3)
    for count in (2, 3, 4):
        post.take(post.entry.begin({"cloud": cloud(count)}))
    assert post.entry.why_not() == "frames are still on their way"
    with pytest.raises(InputError, match="cannot begin"):
        post.entry.begin({"cloud": cloud(5)})
    post.deliver()
    found = {number: record.results["size"].value for number, record in post.results}
    assert found == {0: 2, 1: 3, 2: 4}
    assert post.entry.why_not() is None


def test_the_real_graph_cut_stage_by_stage(tube: np.ndarray) -> None:
    """Every stage on a host of its own, the loops of Algorithm 1 cut to pieces."""
    graph = build_graph(load_spec("default"))
    sources = {"cloud": as_point_cloud(tube)}
    expected = Runner(graph).run(sources)
    post = Post(placed(graph, "abcdefghijklmn"))
    post.take(post.entry.begin(sources))
    post.deliver()
    ((_, record),) = post.results
    assert record.firings == expected.firings and record.rounds == expected.rounds
    for name in ("nodes", "edges", "mass", "radius", "node_ids"):
        found = getattr(record.results["skeleton"], name)
        np.testing.assert_array_equal(found, getattr(expected.results["skeleton"], name))
    assert sum(record.rounds.values()) > 0


@pytest.fixture
def tube() -> np.ndarray:
    rng = np.random.default_rng(1)
    along, around = rng.uniform(-1, 1, 300), rng.uniform(0, 2 * np.pi, 300)
    return np.c_[along, 0.1 * np.cos(around), 0.1 * np.sin(around)]


def test_values_of_earlier_rounds_are_not_kept() -> None:
    graph = placed(graph_of(LOOPS), "ab")
    post = Post(graph)
    most = 0
    post.take(post.entry.begin({}))
    while any(post.boxes.values()):
        post.deliver(at_most=1)
        for part in post.parts.values():
            most = max([most, *(len(state.values) for state in part._states.values())])
    assert post.results[0][1].firings["step"] > 8
    assert most <= 12
    assert not any(part._states for part in post.parts.values())


def failing() -> Graph:
    text = FORK.replace(
        "results: {number: last.number", "results: {never: hush.number, number: last.number"
    )
    return graph_of(text)


def test_a_failure_is_told_at_the_entry_and_ends_the_frame() -> None:
    graph = placed(failing(), "abc")
    post = Post(graph)
    post.take(post.entry.begin({"cloud": cloud()}))
    post.deliver()
    expected = as_one(graph, {"cloud": cloud()})
    assert isinstance(expected, StageError)
    assert not post.results
    (ended,) = post.ended
    assert isinstance(ended.error, StageError)
    assert str(ended.error) == str(expected)
    assert not any(part._states for part in post.parts.values())
    assert post.entry.why_not() is None


def test_a_frame_that_gets_lost_is_given_up() -> None:
    now = [0.0]
    clock: Callable[[], float] = lambda: now[0]  # noqa: E731
    post = Post(placed(graph_of(FORK), "ab"), frame_seconds=5, clock=clock)
    post.entry.begin({"cloud": cloud()})
    now[0] = 5.0
    assert post.entry.tick().ended == []
    now[0] = 5.1
    step = post.entry.tick()
    (ended,) = step.ended
    assert "lost on its way" in str(ended.error)
    assert post.entry.under_way == 0
    post.take(step)
    post.deliver()
    post.take(post.entry.begin({"cloud": cloud(2)}))
    post.deliver()
    assert [number for number, _ in post.results] == [1]


def test_hosts_that_are_silent_or_not_ready_hold_the_entry() -> None:
    now = [0.0]
    graph = placed(graph_of(FORK), "ab")
    entry = Part(graph, "a", silence=2, clock=lambda: now[0])
    other = Part(graph, "b")
    assert entry.why_not() == "the host 'b' is not there"
    entry.receive(other.hello(ready=False))
    assert entry.why_not() == "the host 'b' is not ready"
    entry.receive(other.hello())
    assert entry.why_not() is None
    now[0] = 2.1
    assert entry.why_not() == "the host 'b' is not there"
    assert other.why_not() == "frames begin on the host 'a'"


def test_a_host_with_another_graph_is_refused() -> None:
    entry = Part(placed(graph_of(FORK), "ab"), "a")
    other = Part(placed(graph_of(LOOPS), "ab"), "b")
    with pytest.raises(InputError, match="runs another graph"):
        entry.receive(other.hello())
    assert entry.why_not() == "the host 'b' is not there"


def test_an_entry_that_starts_anew_is_followed() -> None:
    graph = placed(graph_of(FORK), "ab")
    post = Post(graph)
    post.take(post.entry.begin({"cloud": cloud(2)}))
    post.deliver(at_most=2)
    post.restart("a")
    post.entry = post.parts["a"]
    post.send(post.parts["b"].hello())
    post.deliver()
    post.take(post.entry.begin({"cloud": cloud(4)}))
    post.deliver()
    assert post.results[-1][1].results["size"] == Number(4)


def test_a_host_that_nobody_names_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"no stage of .* is on the host 'c'[\s\S]*known names"):
        Part(placed(graph_of(FORK), "ab"), "c")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "{" * 100_000,
        '{"mdcs":2}',
        '{"mdcs":1,"kind":"order","sender":"a","session":1,"frame":0,"attempt":0,"body":{}}',
        '{"mdcs":1,"kind":"value","sender":"a","session":1,"frame":0,"attempt":0,"body":{}}',
        '{"mdcs":1,"kind":"turn","sender":"a","session":"x","frame":0,"attempt":0,"body":{}}',
    ],
)
def test_what_is_no_letter_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        read_head(text)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda ledger: ledger.clear(),
        lambda ledger: ledger["slots"].pop("left"),
        lambda ledger: ledger["slots"]["left"].update(number=[]),
        lambda ledger: ledger["slots"]["left"].update(number=[["size", "number", "x"]]),
        lambda ledger: ledger.update(rounds=3, firings=None),
        lambda ledger: ledger["latest"].append(7),
    ],
)
def test_a_spoilt_ledger_is_refused_and_the_frame_can_still_end(spoil: Any) -> None:
    graph = placed(graph_of(FORK), ["a", "b"])
    post = Post(graph)
    step = post.entry.begin({"cloud": cloud()})
    (turn,) = [letter for letter in step.letters if letter.kind == "turn"]
    bad = read_head(head_text(turn))
    spoil(bad.body["ledger"])
    with pytest.raises(InputError, match="not one of this graph"):
        post.parts["b"].receive(bad)
    post.take(step)
    post.deliver()
    assert post.ended == [Ended(0)]


def test_a_graph_that_remembers_frames_is_not_cut() -> None:
    with pytest.raises(ConfigError, match="runs in one process"):
        layout_of(build_graph(load_spec("streaming")))
