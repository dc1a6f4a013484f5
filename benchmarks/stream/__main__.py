"""``python -m benchmarks.stream``: what streaming must show, measured in one run."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

# One thread: times are then comparable.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from benchmarks.stream import growth, stability, table, topology  # noqa: E402
from benchmarks.topology import models  # noqa: E402

PARTS = ("orbits", "grown", "slid", "replaced", "stable", "killed")
OUT = Path(__file__).resolve().parents[1] / "results" / "stream.json"


def main(argv: list[str] | None = None) -> int:
    """Run the parts that are asked for; parts of an earlier run stay in the results."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.stream", description=__doc__)
    made.add_argument("--parts", nargs="*", default=list(PARTS), choices=[*PARTS, "live"])
    made.add_argument("--frames", type=int, default=200, help="of the growing scene")
    made.add_argument("--seconds", type=float, default=300.0, help="of the live part")
    made.add_argument("--shapes", nargs="*", help="orbits around these only")
    made.add_argument("--out", type=Path, default=OUT)
    made.add_argument("--readme", action="store_true", help="write into benchmarks/README.md")
    args = made.parse_args(argv)
    found = json.loads(args.out.read_text()) if args.out.exists() else {}
    for part in args.parts:
        print(part, file=sys.stderr, flush=True)
        found[part] = run(part, args)
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(found, indent=1) + "\n")
    print(table.table(found))
    if found.get("orbits"):
        print("\n" + table.orbit_table(found["orbits"]))
    if args.readme:
        table.write_readme(found)
    return 0


def run(part: str, args: argparse.Namespace) -> object:
    """Return the figures of one part."""
    if part == "orbits":
        meshes = topology.MESHES if models.has_data() else ()
        shapes = args.shapes or [*topology.SHAPES, *meshes]
        orbits = [(name, 0.0) for name in shapes]
        if not args.shapes:
            orbits += [(name, topology.JITTER) for name in topology.JITTERED]
        found = []
        for name, jitter in orbits:
            found.append(topology.as_record(topology.orbit(name, jitter=jitter)))
            print(" ", table.orbit_table(found[-1:]).splitlines()[-1], file=sys.stderr, flush=True)
        return found
    if part == "grown":
        return growth.grow(args.frames)
    if part == "slid":
        return growth.slide(args.frames)
    if part == "replaced":
        return growth.replace(30)
    if part == "live":
        return growth.live(args.seconds)
    if part == "stable":
        return {
            "solve": stability.warm_solve(),
            "frozen": stability.frozen(),
            "laps": {name: stability.second_lap(name) for name in stability.LAPS},
        }
    return stability.killed()


if __name__ == "__main__":
    sys.exit(main())
