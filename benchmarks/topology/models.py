"""Real models: meshes with mean-curvature-flow skeletons, read from the shared data folder.

The data are not part of the repository. `MDCS_DATA` names the folder; its default is the
``shared/data`` beside the checkout. Without it these cases are left out, and said to be.
"""

from __future__ import annotations

import json
import os
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.topology.solid import Floats, Ints, Truth, graph_counts

MESHES = (
    "cloudcontr_fertility",
    "cloudcontr_ninehandletorus",
    "gel_armadillo",
    "gel_hand",
    "gel_octopus",
    "gel_wolf",
    "rfalque_dog",
    "rfalque_human_mesh",
)


def data_folder() -> Path:
    """Return where the shared data are expected."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("MDCS_DATA", beside))


def has_data() -> bool:
    """Whether the shared data are there."""
    return (data_folder() / "meshes").is_dir()


@cache
def _ply(path: Path) -> tuple[Floats, Ints]:
    """Read a binary little-endian PLY of float32 x, y, z and, if there, triangles."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    counts = {
        words[1]: int(words[2])
        for words in (line.split() for line in head.decode("ascii").splitlines())
        if words[:1] == ["element"]
    }
    size = counts["vertex"]
    points = np.frombuffer(body, "<f4", 3 * size).reshape(-1, 3).astype(np.float64)
    row = np.dtype([("n", "u1"), ("ijk", "<i4", 3)])
    faces = np.frombuffer(body, row, counts.get("face", 0), offset=12 * size)
    return points, faces["ijk"].astype(np.int64)


def cloud(name: str) -> Floats:
    """Return the points (N, 3) of ``clouds/name``."""
    return _ply(data_folder() / "clouds" / f"{name}.ply")[0]


def mesh(name: str) -> tuple[Floats, Ints]:
    """Return vertices (V, 3) and triangles (F, 3) of ``meshes/name``."""
    return _ply(data_folder() / "meshes" / f"{name}.ply")


def sample_mesh(name: str, n: int, rng: np.random.Generator) -> Floats:
    """Return `n` points uniform by area on a mesh."""
    vertices, faces = mesh(name)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    pick = rng.choice(len(faces), n, p=area / area.sum())
    u, v = rng.random((2, n, 1))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return np.asarray(a[pick] + u * (b - a)[pick] + v * (c - a)[pick])


def skeleton(name: str) -> tuple[Floats, Ints]:
    """Return nodes and edges of the mean-curvature-flow skeleton of a mesh."""
    read = json.loads((data_folder() / "skeletons" / f"{name}.json").read_text(encoding="utf-8"))
    nodes = np.asarray(read["nodes"], dtype=np.float64).reshape(-1, 3)
    return nodes, np.asarray(read["edges"], dtype=np.int64).reshape(-1, 2)


@cache
def mesh_truth(name: str) -> Truth:
    """Return the truth of a mesh; leaves are reported, not counted, and radii are unknown."""
    nodes, edges = skeleton(name)
    components, cycles, leaves = graph_counts(len(nodes), edges)
    diagonal = float(np.linalg.norm(np.ptp(mesh(name)[0], axis=0)))
    return Truth(name, nodes, edges, None, components, cycles, leaves, diagonal, False)
