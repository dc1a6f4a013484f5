"""SWC, the neuron-tracing format: trees of nodes with radii.

Columns: id, type, x, y, z, radius, parent. Source: R. C. Cannon et al., An on-line
archive of reconstructed hippocampal neurons, J. Neurosci. Methods 84 (1998), with the
type codes of neuromorpho.org (0 undefined, 5 fork point, 6 end point).
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from mdcs_pipeline.errors import OutputError

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

_UNDEFINED, _FORK, _END = 0, 5, 6


def swc_bytes(skeleton: Skeleton) -> bytes:
    """Return SWC text; every tree is rooted at its thickest node.

    Raises
    ------
    OutputError
        If the skeleton has a loop, which a format of parents cannot hold.
    """
    loops = skeleton.summary()["cycles"]
    if loops:
        raise OutputError(
            "SWC holds trees only, and the skeleton has loops",
            received=f"{loops} independent loops",
            remedy="write .graphml, .ply or .json, which keep loops",
        )
    degree = np.bincount(skeleton.edges.ravel(), minlength=len(skeleton))
    number: dict[int, int] = {}
    lines = [
        f"# curve skeleton by mdcs-pipeline, frame {json.dumps(skeleton.header.frame_id)}",
        "# coordinates and radius in input units",
        "# id type x y z radius parent",
    ]
    for node, parent in _parents_first(skeleton):
        number[node] = len(number) + 1
        kind = _FORK if degree[node] > 2 else _END if degree[node] == 1 else _UNDEFINED
        x, y, z = skeleton.nodes[node].tolist()
        radius = float(skeleton.radius[node])
        above = -1 if parent is None else number[parent]
        lines.append(f"{number[node]} {kind} {x!r} {y!r} {z!r} {radius!r} {above}")
    return ("\n".join(lines) + "\n").encode("ascii")


def _parents_first(skeleton: Skeleton) -> list[tuple[int, int | None]]:
    """Return every node with its parent, branch by branch, thickest roots first."""
    neighbours: list[list[int]] = [[] for _ in range(len(skeleton))]
    for i, j in skeleton.edges.tolist():
        neighbours[i].append(j)
        neighbours[j].append(i)
    order: list[tuple[int, int | None]] = []
    seen: set[int] = set()
    # Stable, so that of equal radii the lower index is the root.
    for root in np.argsort(-skeleton.radius, kind="stable").tolist():
        if root in seen:
            continue
        stack: list[tuple[int, int | None]] = [(root, None)]
        while stack:
            node, parent = stack.pop()
            seen.add(node)
            order.append((node, parent))
            stack.extend((other, node) for other in reversed(neighbours[node]) if other != parent)
    return order
