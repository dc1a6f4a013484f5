"""A pipeline as it is described: frozen specifications, each with its place."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from mdcs_pipeline.document import Place
from mdcs_pipeline.errors import ConfigError, suggestion

Nonfinite = Literal["drop", "refuse"]
# Of stages that name no other.
MAIN_HOST = "main"
NONFINITE: tuple[Nonfinite, ...] = ("drop", "refuse")


@dataclass(frozen=True)
class Ref:
    """An output that an input names: ``stage.port``, or ``sources.name``."""

    stage: str
    port: str
    place: Place

    def __str__(self) -> str:
        return f"{self.stage}.{self.port}"


@dataclass(frozen=True)
class SourceSpec:
    """A cloud that enters the graph, and what is done with its NaN and infinity."""

    name: str
    nonfinite: Nonfinite
    place: Place


@dataclass(frozen=True)
class FeedbackSpec:
    """An edge that leads back: its output, and how many values it carries a frame."""

    origin: Ref
    max_rounds: int | None
    place: Place


@dataclass(frozen=True)
class StageSpec:
    """One stage of the graph.

    Parameters
    ----------
    name : str
        Its key in the YAML, unique in the graph.
    stage : str
        Name that the stage class is registered under.
    place : Place
    inputs : dict of tuple of Ref
        By input port, in the order they are written.
    feedback : dict of tuple of FeedbackSpec
        By input port.
    settings : dict
        As written; validated when the graph is built.
    setting_places : dict of Place
        Where each of them was written.
    host : str
        Process that runs it where a graph is cut; of no account within one process.
    """

    name: str
    stage: str
    place: Place
    inputs: dict[str, tuple[Ref, ...]] = field(default_factory=dict)
    feedback: dict[str, tuple[FeedbackSpec, ...]] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    setting_places: dict[str, Place] = field(default_factory=dict)
    host: str = MAIN_HOST


@dataclass(frozen=True)
class PipelineSpec:
    """A whole pipeline, as written; `build_graph` checks that it fits together.

    `threads` are the most that a stage may use; what the machine and the environment allow
    bounds them.
    """

    name: str
    description: str
    sources: dict[str, SourceSpec]
    stages: dict[str, StageSpec]
    results: dict[str, Ref]
    file: str
    threads: int = 1


def checked_nonfinite(source: str, value: object, place: Place) -> Nonfinite:
    """Return `value` if it is one of `NONFINITE`, or raise a `ConfigError`."""
    if value in NONFINITE:
        return value
    raise ConfigError(
        f"nonfinite of source '{source}' must be one of: {', '.join(NONFINITE)}",
        where=str(place),
        received=value,
        remedy=suggestion(str(value), NONFINITE),
    )


def checked_threads(value: object, place: Place | str) -> int:
    """Return `value` if it is a number of threads, or raise a `ConfigError`."""
    if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
        return value
    raise ConfigError(
        "threads must be a whole number from 1 on",
        where=str(place),
        received=value,
        remedy="1 leaves the other processors alone",
    )
