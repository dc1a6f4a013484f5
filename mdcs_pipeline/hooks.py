"""Hooks: what watches a run without taking part in it."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mdcs_pipeline.graph import Graph
    from mdcs_pipeline.runner import RunRecord


@dataclass(frozen=True)
class StageEvent:
    """One firing of a stage, once it is over.

    Parameters
    ----------
    name : str
        Name of the stage in the graph.
    firing : int
        Running number of this firing within the run, from 1.
    seconds : float
        Time that the stage took.
    figures : dict
        The ``summary()`` of its outputs, merged.
    """

    name: str
    firing: int
    seconds: float
    figures: dict[str, Any]


class Hook:
    """Base of every hook; override what you want to hear of.

    A hook cannot change a result: an exception of its own becomes a warning, save for
    `KeyboardInterrupt`, which ends the run.
    """

    def run_started(self, graph: Graph) -> None:
        """Hear that a run begins."""

    def stage_started(self, name: str, firing: int) -> None:
        """Hear that a stage is about to fire."""

    def stage_finished(self, event: StageEvent) -> None:
        """Hear that a stage has fired."""

    def run_finished(self, record: RunRecord) -> None:
        """Hear that a run has ended well; not called after an error."""


def notify(hooks: Iterable[Hook], method: str, *arguments: object) -> None:
    """Call `method` of every hook; an exception of a hook becomes a `RuntimeWarning`."""
    for hook in hooks:
        try:
            getattr(hook, method)(*arguments)
        except Exception as error:
            warnings.warn(
                f"hook {type(hook).__name__}.{method} failed: {type(error).__name__}: {error}",
                RuntimeWarning,
                stacklevel=2,
            )


def figures_of(outputs: Mapping[str, object]) -> dict[str, Any]:
    """Return the merged ``summary()`` of those outputs that have one."""
    figures: dict[str, Any] = {}
    for port, value in outputs.items():
        summary = getattr(value, "summary", None)
        if not callable(summary):
            continue
        try:
            figures.update(summary())
        except Exception as error:
            warnings.warn(
                f"summary of '{port}' failed: {type(error).__name__}: {error}",
                RuntimeWarning,
                stacklevel=2,
            )
    return figures
