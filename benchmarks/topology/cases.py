"""The list of cases: suite x shape x damage x seed, and the cloud of each."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from itertools import product

import numpy as np

from benchmarks.topology import models, paper
from benchmarks.topology.damage import DAMAGES, FIG13, POINTS
from benchmarks.topology.shapes import HELD_OUT, RANDOM, RANDOM_HELD_OUT, SHAPES, make
from benchmarks.topology.solid import Floats, Truth, sample

# The dumbbell of the paper's Fig. 14 has 736 points.
FIG14_POINTS = 736
QUICK_SHAPES = ("y", "hand5", "quadruped", "grid2", "trefoil", "dumbbell", "two_bars", "egg")
QUICK_DAMAGES = ("clean", "noise-0.3", "loss-80", "holes-1.5", "outliers-2", "density-7-smooth",
                 "views-2")  # fmt: skip
# The first have every damage; the others come with their own.
DAMAGED = ("shapes", "held-out", "random", "random-held-out")
SUITES = (*DAMAGED, "real", "table4", "spacing", "fig13", "fig14")


@dataclass(frozen=True, order=True)
class Case:
    """One cloud with its expected answer."""

    suite: str
    shape: str
    damage: str
    seed: int

    @property
    def name(self) -> str:
        """``suite|shape|damage|seed``: what filters match and reports show."""
        return f"{self.suite}|{self.shape}|{self.damage}|{self.seed}"

    def rng(self) -> np.random.Generator:
        """Return the case's own stream: the same whatever else runs."""
        text = f"{self.shape}|{self.damage}".encode()
        return np.random.default_rng([zlib.crc32(text), self.seed])

    def cloud(self) -> Floats:
        """Return the points (N, 3)."""
        rng = self.rng()
        if self.suite == "real":
            return models.sample_mesh(self.shape, POINTS, rng)
        if self.suite in ("table4", "spacing"):
            return paper.damaged(self.shape, self.damage, rng)
        shape = make(self.shape)
        if self.suite == "fig14":
            return sample(shape, FIG14_POINTS, rng).points
        damage = {**DAMAGES, **FIG13}[self.damage]
        return damage.apply(shape, POINTS, rng).points

    def truth(self) -> Truth:
        """Return the expected answer."""
        if self.suite == "real":
            return models.mesh_truth(self.shape)
        if self.suite in ("table4", "spacing"):
            return paper.truth(self.shape)
        return make(self.shape)


def all_cases(seeds: int, first: int = 0) -> list[Case]:
    """Return every case over so many seeds from `first`; those of absent data are left out."""
    parts = [
        ("shapes", SHAPES, DAMAGES),
        ("held-out", HELD_OUT, DAMAGES),
        ("random", RANDOM, DAMAGES),
        ("random-held-out", RANDOM_HELD_OUT, DAMAGES),
        ("fig13", ("humanoid", "quadruped", "tree"), FIG13),
        ("fig14", ("dumbbell",), ("clean",)),
    ]
    if models.has_data():
        parts += [
            ("real", models.MESHES, ("clean",)),
            ("table4", paper.TABLE4_MODELS, paper.TABLE4_DAMAGES),
            ("spacing", paper.TABLE4_MODELS, paper.SPACING_DAMAGES),
        ]
    return [
        Case(suite, shape, damage, seed)
        for suite, shapes, damages in parts
        for shape, damage, seed in product(shapes, damages, range(first, first + seeds))
    ]


def _matches(pattern: str, text: str) -> bool:
    """Whether one of the comma-separated regular expressions matches all of the text."""
    return any(re.fullmatch(part, text) for part in pattern.split(","))


def select(
    seeds: int = 1,
    suites: str = "shapes",
    shapes: str | None = None,
    damages: str | None = None,
    quick: bool = False,
    first: int = 0,
) -> list[Case]:
    """Return the cases that the filters leave.

    Each filter is a comma-separated list of regular expressions that must match a whole name.
    """
    chosen = [c for c in all_cases(1 if quick else seeds, first) if _matches(suites, c.suite)]
    if shapes:
        chosen = [c for c in chosen if _matches(shapes, c.shape)]
    elif quick:
        chosen = [c for c in chosen if c.suite != "shapes" or c.shape in QUICK_SHAPES]
    if damages:
        chosen = [c for c in chosen if _matches(damages, c.damage)]
    elif quick:
        chosen = [c for c in chosen if c.suite not in DAMAGED or c.damage in QUICK_DAMAGES]
    return chosen
