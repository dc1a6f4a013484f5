"""What the page writes beside the picture."""

from __future__ import annotations

from mdcs_pipeline.errors import MdcsError
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.viewer.colours import value_range
from mdcs_pipeline.viewer.drawing import Colouring
from mdcs_pipeline.viewer.film import Film, Frame

#: The status line where there is nothing else to say.
READY = "ready"

# Names of `Skeleton.summary`, as people say them.
_COUNTS = {
    "nodes": "nodes",
    "edges": "edges",
    "components": "pieces",
    "cycles": "loops",
    "leaves": "ends",
    "junctions": "junctions",
}


def title_text(film: Film, frame: Frame) -> str:
    """Return label and place of the frame."""
    place = f"frame {film.cursor + 1} of {film.last + 1}" if len(film) > 1 else ""
    label = f"**{plain(frame.label)}**" if frame.label else ""
    return ", ".join(filter(None, [label, place]))


def counts_text(frame: Frame) -> str:
    """Return how many points are drawn, and the counts of the skeleton."""
    words = [] if frame.points is None else [f"points drawn {len(frame.points)}"]
    if frame.skeleton is not None:
        counts = frame.skeleton.summary()
        words += [f"{said} {counts[name]}" for name, said in _COUNTS.items()]
    return ", ".join(words)


def times_text(skeleton: Skeleton | None) -> str:
    """Return a table of the seconds of each stage; empty if they are not known."""
    seconds = {} if skeleton is None else skeleton.diagnostics.get("seconds")
    if not isinstance(seconds, dict) or not seconds:
        return ""
    rows = [f"| {plain(name)} | {1000 * value:.1f} |" for name, value in seconds.items()]
    total = f"| **all stages** | **{1000 * sum(seconds.values()):.1f}** |"
    return "\n".join(["| stage | ms |", "| :-- | --: |", *rows, total])


def legend_text(skeleton: Skeleton | None, colouring: Colouring) -> str:
    """Return what the colours mean."""
    if skeleton is None or not len(skeleton):
        return ""
    if colouring == "branch":
        return "one colour a branch; junctions are grey"
    low, high = value_range(skeleton.mass if colouring == "mass" else skeleton.radius)
    return f"{colouring}: violet {low:.3g}, yellow {high:.3g}"


def fault_text(error: MdcsError) -> str:
    """Return an error for the status line."""
    return f"**failed**: {plain(str(error))}"


def plain(text: str) -> str:
    """Return text that markdown shows as it is: names of files are no markup."""
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>()#+-!|~&" else c for c in text)
