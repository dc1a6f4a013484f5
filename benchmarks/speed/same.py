"""Whether a change of the code changes results: ``python -m benchmarks.speed.same FILE [--save]``.

Skeletons of 34 clouds of all kinds are kept in FILE; later runs say how far theirs are from them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from benchmarks.speed import problems
from benchmarks.topology.cases import all_cases

Floats = problems.Floats
DAMAGES = ("clean", "noise-0.15", "noise-0.3", "noise-0.5", "loss-80", "holes-1.5", "holes-2.5",
           "outliers-5", "density-7-halves", "views-2", "misaligned-3")  # fmt: skip
SHAPES = ("y", "bush", "hand5", "quadruped", "insect", "dumbbell", "egg", "cactus", "frame",
          "grid2", "helix", "trefoil", "two_bars", "torus", "mug", "chair")  # fmt: skip


def clouds() -> dict[str, Floats]:
    """Return the clouds by their names: shapes and damages in turn, models, a line, a sheet."""
    cases = {(c.shape, c.damage): c for c in all_cases(1) if c.suite == "shapes"}
    chosen = [(SHAPES[k % 16], DAMAGES[k % 11]) for k in range(28)]
    found = {f"{shape} {damage}": cases[shape, damage].cloud() for shape, damage in chosen}
    rng = np.random.default_rng(0)
    line = np.linspace(0.0, 1.0, 500)
    found["line"] = np.stack([line, line**2, 0.0 * line], axis=1)
    found["sheet"] = np.stack([*rng.random((2, 4000)), np.zeros(4000)], axis=1)
    found["lattice"] = np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3)
    if problems.ARMADILLO.exists():
        found["armadillo"] = problems.mesh()[0]
        found["armadillo 1e5"] = problems.sampled(10**5)
        found["scene"] = problems.repeated(problems.sampled(6000), 4)
    return found


def skeletons(config: str) -> dict[str, Floats]:
    """Return nodes with their radii, and edges, of every cloud's skeleton."""
    import mdcs_pipeline

    made = {}
    for name, points in clouds().items():
        skeleton = mdcs_pipeline.skeletonize(points, config)
        made[f"{name}|nodes"] = np.column_stack([skeleton.nodes, skeleton.radius, skeleton.mass])
        made[f"{name}|edges"] = np.asarray(skeleton.edges)
        print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return made


def differences(now: dict[str, Floats], before: dict[str, Floats]) -> dict[str, float]:
    """Return the largest relative difference of each cloud; infinite where graphs differ."""
    apart = {}
    for name in (key.removesuffix("|nodes") for key in now if key.endswith("|nodes")):
        one, other = (kept[f"{name}|nodes"] for kept in (now, before))
        edges = (kept[f"{name}|edges"] for kept in (now, before))
        same = one.shape == other.shape and np.array_equal(*edges)
        size = np.linalg.norm(np.ptp(other[:, :3], axis=0)) or 1.0
        apart[name] = float(abs(one - other).max() / size) if same else np.inf
    return apart


def main() -> int:
    """Save, or compare; return 1 where anything differs by more than 1e-9."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.speed.same", description=__doc__)
    made.add_argument("file", type=Path)
    made.add_argument("--save", action="store_true", help="write the file instead of reading it")
    made.add_argument("--config", default="default")
    asked = made.parse_args()
    found = skeletons(asked.config)
    if asked.save:
        np.savez(asked.file, **found)  # type: ignore[arg-type]
        return 0
    with np.load(asked.file) as before:
        apart = differences(found, dict(before))
    for name, far in apart.items():
        if far > 0.0:
            print(f"{name}: {far:.2g}")
    print(f"{sum(far == 0.0 for far in apart.values())} of {len(apart)} are the same to the bit")
    return int(max(apart.values()) > 1e-9)


if __name__ == "__main__":
    sys.exit(main())
