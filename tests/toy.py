"""Small stages with known answers, and pipelines of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from mdcs_pipeline.config import parse_spec
from mdcs_pipeline.graph import Graph, build_graph
from mdcs_pipeline.messages import PointCloud, Skeleton
from mdcs_pipeline.runner import Runner
from mdcs_pipeline.stage import Settings, Stage


@dataclass(frozen=True)
class Number:
    value: int

    def summary(self) -> dict[str, Any]:
        return {"value": self.value}


@dataclass(frozen=True)
class SmallNumber(Number):
    """A subtype of `Number`."""


class Out(NamedTuple):
    number: Number


class SmallOut(NamedTuple):
    number: SmallNumber


class Loop(NamedTuple):
    number: Number
    again: Number | None


class Outcome(NamedTuple):
    skeleton: Skeleton


class OneSettings(Settings):
    value: int = Field(1, ge=0, description="What it gives, a number of at least 0.")


class One(Stage[OneSettings]):
    """Give a number."""

    Settings = OneSettings

    def __call__(self) -> SmallOut:
        return SmallOut(SmallNumber(self.settings.value))


class Size(Stage[Settings]):
    """Count points."""

    def __call__(self, cloud: PointCloud) -> Out:
        return Out(Number(len(cloud)))


class AddSettings(Settings):
    by: int = Field(1, description="What is added.")


class Add(Stage[AddSettings]):
    """Add a constant, and another number if there is one."""

    Settings = AddSettings

    def __call__(self, number: Number, other: Number | None) -> Out:
        return Out(Number(number.value + self.settings.by + (other.value if other else 0)))


class Join(Stage[Settings]):
    """Read the digits of several numbers as one, so that their order shows."""

    def __call__(self, numbers: tuple[Number, ...]) -> Out:
        return Out(Number(int("".join(str(n.value) for n in numbers))))


class UntilSettings(Settings):
    multiple: int = Field(1, description="Send back unless the number is a multiple of this.")
    least: int = Field(0, description="Send back below this.")


class Until(Stage[UntilSettings]):
    """Pass a number on, and send it back as long as it does not suit."""

    Settings = UntilSettings

    def __call__(self, number: Number) -> Loop:
        suits = number.value % self.settings.multiple == 0 and number.value >= self.settings.least
        return Loop(number, None if suits else number)


class Silent(Stage[Settings]):
    """Give nothing."""

    def __call__(self, number: Number) -> Out:
        return Out(None)  # type: ignore[arg-type]


class Sink(Stage[Settings]):
    """Take a number."""

    def __call__(self, number: Number) -> None:
        return None


class Maybe(Stage[Settings]):
    """Take a number or none."""

    def __call__(self, number: Number | None = None) -> Out:
        return Out(number or Number(0))


class Corner(Stage[Settings]):
    """Give the first two points as a skeleton of one edge."""

    def __call__(self, cloud: PointCloud) -> Outcome:
        nodes = np.array(cloud.positions[:2], np.float64)
        half = np.full(2, 0.5)
        skeleton = Skeleton(
            nodes, np.array([[0, 1]]), half, half, np.arange(2), None, cloud.header, {"own": 1}
        )
        return Outcome(skeleton)


TOYS: dict[str, type[Stage[Any]]] = {
    "one": One,
    "size": Size,
    "add": Add,
    "join": Join,
    "until": Until,
    "silent": Silent,
    "sink": Sink,
    "maybe": Maybe,
    "corner": Corner,
}


def toys(name: str) -> type[Stage[Any]]:
    return TOYS[name]


def graph_of(text: str, **more: type[Stage[Any]]) -> Graph:
    return build_graph(parse_spec(text, "toy.yaml"), {**TOYS, **more}.__getitem__)


def runner_of(text: str, hooks: Any = (), **more: type[Stage[Any]]) -> Runner:
    return Runner(graph_of(text, **more), hooks)


# Both loops of Algorithm 1: the number counts the firings of `step`.
LOOPS = """
stages:
  start: {stage: one, settings: {value: 0}}
  step:
    stage: add
    inputs: {number: start.number}
    feedback:
      number:
        - {from: inner.again, max_rounds: 100}
        - {from: outer.again, max_rounds: 10}
  inner: {stage: until, inputs: {number: step.number}, settings: {multiple: 4}}
  outer: {stage: until, inputs: {number: inner.number}, settings: {least: 12}}
  end: {stage: add, inputs: {number: outer.number}, settings: {by: 100}}
results: {number: end.number}
"""
