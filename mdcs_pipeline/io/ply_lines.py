"""PLY line sets: vertices with mass and radius, joined by edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton


def ply_bytes(skeleton: Skeleton) -> bytes:
    """Return a binary little-endian PLY that Open3D's `read_line_set` opens.

    Written here because Open3D's `write_line_set` knows no vertex properties but the
    position: mass and radius would be lost, and Open3D would be needed to save.
    """
    rows = np.column_stack([skeleton.nodes, skeleton.mass, skeleton.radius])
    return b"".join(
        [
            ply_header(len(skeleton.nodes), len(skeleton.edges)),
            rows.astype("<f8").tobytes(),
            skeleton.edges.astype("<i4").tobytes(),
        ]
    )


def ply_header(count: int, edges: int) -> bytes:
    """Return the header of a line set of `count` nodes."""
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment curve skeleton by mdcs-pipeline; x y z radius in input units, mass sums to 1",
        f"element vertex {count}",
        *(f"property double {name}" for name in ("x", "y", "z", "mass", "radius")),
        f"element edge {edges}",
        "property int vertex1",
        "property int vertex2",
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")
