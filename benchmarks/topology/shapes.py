"""The shapes that may be tuned on: at least one of every kind that skeletons fail at."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.topology import shapes_held_out, shapes_loops, shapes_random, shapes_trees
from benchmarks.topology.solid import Shape, sample

__all__ = ["HELD_OUT", "RANDOM", "RANDOM_HELD_OUT", "SHAPES", "make", "sample"]

SHAPES: dict[str, Callable[[], Shape]] = {
    maker.__name__: maker for maker in shapes_trees.MAKERS + shapes_loops.MAKERS
}
HELD_OUT = shapes_held_out.HELD_OUT
RANDOM, RANDOM_HELD_OUT = shapes_random.NAMES, shapes_random.HELD_OUT


def make(name: str) -> Shape:
    """Return the named shape, held-out and random ones included."""
    if name in RANDOM + RANDOM_HELD_OUT:
        return shapes_random.random_shape(name)
    return {**SHAPES, **HELD_OUT}[name]()
