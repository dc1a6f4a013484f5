"""``mdcs validate CONFIG``: does it fit together?"""

from __future__ import annotations

from mdcs_pipeline.cli.common import ConfigArgument, SetOption, load_graph
from mdcs_pipeline.cli.console import say


def validate(config: ConfigArgument, sets: SetOption = None) -> None:
    """Check a configuration without running it."""
    graph = load_graph(config, sets)
    spec = graph.spec
    counts = (
        _count(len(spec.sources), "source"),
        _count(len(spec.stages), "stage"),
        _count(sum(edge.feedback for edge in graph.edges), "feedback edge"),
        _count(len(spec.results), "result"),
    )
    say(f"{spec.file}: valid: {', '.join(counts)}")


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
