"""Other public tools, at the settings that their own documentation and examples use."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.topology.solid import Floats, Ints


class Result(NamedTuple):
    """A skeleton; `seconds` where the method must be timed from inside."""

    nodes: Floats
    edges: Ints
    radius: Floats | None = None
    seconds: float | None = None


# Spurs shorter than this share of the diagonal are cut in the "-pruned" variants.
SPUR = 0.03
_WORKER = """
import sys
import time
import numpy as np
import open3d as o3d
from pc_skeletor import LBC
points = np.load(sys.argv[1], allow_pickle=False)
start = time.perf_counter()
lbc = LBC(point_cloud=o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)))
lbc.extract_skeleton()
lbc.extract_topology()
seconds = time.perf_counter() - start
nodes, edges = np.asarray(lbc.topology.points), np.asarray(lbc.topology.lines)
np.savez(sys.argv[2], nodes=nodes, edges=edges, seconds=seconds)
"""


def prune_spurs(nodes: Floats, edges: Ints, length: float) -> tuple[Floats, Ints]:
    """Cut end branches shorter than `length` off their junctions, once.

    A branch that ends at both sides is a component of its own and stays.
    """
    adjacent: dict[int, list[int]] = {k: [] for k in range(len(nodes))}
    for i, j in edges:
        adjacent[int(i)].append(int(j))
        adjacent[int(j)].append(int(i))
    cut: set[int] = set()
    for leaf in (k for k, near in adjacent.items() if len(near) == 1):
        path, here, before, way = [leaf], leaf, -1, 0.0
        while len(adjacent[here]) <= 2:
            ahead = [k for k in adjacent[here] if k != before]
            if not ahead:
                break
            way += float(np.linalg.norm(nodes[ahead[0]] - nodes[here]))
            before, here = here, ahead[0]
            path.append(here)
        if len(adjacent[here]) > 2 and way < length:
            cut.update(path[:-1])
    kept = np.array([k for k in range(len(nodes)) if k not in cut], dtype=np.int64)
    number = np.full(len(nodes), -1)
    number[kept] = np.arange(len(kept))
    pairs = number[edges]
    return nodes[kept], pairs[(pairs >= 0).all(axis=1)]


@contextmanager
def quiet() -> Iterator[None]:
    """Send what C++ prints past `sys.stdout` nowhere; a thousand reports would hide ours."""
    sys.stdout.flush()
    kept, silent = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(silent)


def _pruned(points: Floats, result: Result, prune: bool) -> Result:
    if not prune:
        return result
    length = SPUR * float(np.linalg.norm(np.ptp(points, axis=0)))
    nodes, edges = prune_spurs(result.nodes, result.edges, length)
    return Result(nodes, edges, None, result.seconds)


def pygel(points: Floats, multiscale: bool = True, finish: bool = True) -> Result:
    """PyGEL3D: local separators on the neighbour graph of the cloud.

    As in its point-cloud demo, points join their nearest 15 within a radius; its radius is in the
    units of one model, so twice the median distance to the 15th neighbour stands for it. `finish`
    is that of its skeleton example: prune, contract at 5 % of the mean edge, smooth 10 x 0.1.
    Tried beside on six clean shapes: 8 neighbours (hundreds of false loops), ``grow_thresh=512``
    (no better), cutting short spurs instead of its own pruning (a hundred leaves stay).
    """
    from pygel3d import graph

    away, near = cKDTree(points).query(points, 16)
    source = graph.Graph()
    for point in points:
        source.add_node(point)
    close = away[:, 1:] <= 2 * np.median(away[:, 15])
    pairs = np.stack(np.broadcast_arrays(np.arange(len(points))[:, None], near[:, 1:]), axis=-1)
    for i, j in np.unique(np.sort(pairs[close], axis=1), axis=0).tolist():
        source.connect_nodes(i, j)
    with quiet():
        made = graph.MSLS_skeleton(source) if multiscale else graph.LS_skeleton(source)
    if finish:
        graph.prune(made)
        graph.edge_contract(made, dist_thresh=0.05 * made.average_edge_length())
        graph.smooth(made, num_iter=10, alpha=0.1)
        made.cleanup()
    used = [int(k) for k in made.nodes()]
    number = {k: index for index, k in enumerate(used)}
    links = {tuple(sorted((number[k], number[int(n)]))) for k in used for n in made.neighbors(k)}
    edges = np.array(sorted(e for e in links if e[0] != e[1]), dtype=np.int64).reshape(-1, 2)
    return Result(np.asarray(made.positions())[used], edges)


def pc_skeletor(points: Floats, prune: bool = False) -> Result:
    """pc-skeletor: Laplacian-based contraction, all settings at their defaults.

    It pins packages that this project cannot have (mistree 1.2.0, torch, dgl), so it runs in an
    interpreter of its own: `PC_SKELETOR_PYTHON` names it; the README says how to make one. Its time
    is taken in there, without starting and importing.
    """
    python = os.environ.get("PC_SKELETOR_PYTHON")
    if not python:
        raise RuntimeError("set PC_SKELETOR_PYTHON to a python that has pc-skeletor")
    with tempfile.TemporaryDirectory() as folder:
        cloud, answer = Path(folder, "cloud.npy"), Path(folder, "skeleton.npz")
        np.save(cloud, points)
        command = [python, "-c", _WORKER, str(cloud), str(answer)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
        if done.returncode:
            raise RuntimeError(f"pc-skeletor failed: {done.stderr.strip()[-300:]}")
        with np.load(answer, allow_pickle=False) as read:
            nodes, edges = read["nodes"].astype(np.float64), read["edges"].astype(np.int64)
            seconds = float(read["seconds"])
    edges = edges[edges[:, 0] != edges[:, 1]]
    return _pruned(points, Result(nodes, edges, None, seconds), prune)
