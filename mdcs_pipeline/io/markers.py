"""A skeleton as the values of `visualization_msgs/Marker`, without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

SPHERE, LINE_LIST = 2, 5
ADD, DELETE = 0, 2
EDGES, NODES = "edges", "nodes"
_EDGE_COLOR = (0.95, 0.45, 0.1, 1.0)
_NODE_COLOR = (0.1, 0.35, 0.8, 1.0)
_CLEAR = (0.0, 0.0, 0.0, 0.0)
# A node of no mass at all is still to be seen, and viewers refuse a size of 0.
_LEAST = 0.1
# A marker's id is an int32.
_ID_BITS = 0x7FFFFFFF


class MarkerValues(NamedTuple):
    """What a marker of a skeleton consists of.

    Attributes
    ----------
    ns : str
        ``edges`` or ``nodes``.
    id : int
        Of the node, from `Skeleton.node_ids`; 0 for the edges.
    type, action : int
        As the message counts them; the type of a deletion is that of what it deletes.
    position : tuple of float
        Of a sphere; the origin for lines.
    scale : tuple of float
        Diameters of a sphere; of lines the width, then zeros.
    color : tuple of float
        r, g, b, a.
    points : (2 E, 3) float64
        Ends of the lines, two by two; (0, 3) for a sphere.
    """

    ns: str
    id: int
    type: int
    action: int
    position: tuple[float, float, float]
    scale: tuple[float, float, float]
    color: tuple[float, float, float, float]
    points: NDArray[np.float64]


class MarkerHistory:
    """Makes the markers of one skeleton after another.

    Each array holds all of the skeleton, so that who joins late sees it whole, and a DELETE
    for every marker of the array before that has no successor.
    """

    def __init__(self) -> None:
        self._shown: dict[tuple[str, int], int] = {}

    def show(
        self, skeleton: Skeleton, line_width: float = 0.0, node_size: float = 1.0
    ) -> list[MarkerValues]:
        """Return the deletions and markers that show `skeleton` in place of the last one."""
        made = skeleton_markers(skeleton, line_width, node_size)
        gone = self._without({(marker.ns, marker.id) for marker in made})
        self._shown = {(marker.ns, marker.id): marker.type for marker in made}
        return gone + made

    def clear(self) -> list[MarkerValues]:
        """Return what takes all that is shown away."""
        gone = self._without(set())
        self._shown = {}
        return gone

    def _without(self, kept: set[tuple[str, int]]) -> list[MarkerValues]:
        return [
            _marker(ns, number, kind, _CLEAR)._replace(action=DELETE)
            for (ns, number), kind in self._shown.items()
            if (ns, number) not in kept
        ]


def skeleton_markers(
    skeleton: Skeleton, line_width: float = 0.0, node_size: float = 1.0
) -> list[MarkerValues]:
    """Return the edges as one list of lines and the nodes as spheres.

    A sphere's volume goes with its node's mass. Thin lines vanish inside the cloud.

    Parameters
    ----------
    skeleton : Skeleton
    line_width : float
        In the skeleton's unit; 0 for a quarter of the median radius.
    node_size : float
        Diameter of a node of mean mass, in median radii.

    Returns
    -------
    list of MarkerValues
    """
    if not len(skeleton):
        return []
    extent = float(np.linalg.norm(np.ptp(skeleton.nodes, axis=0)))
    unit = float(np.median(skeleton.radius)) or 0.01 * extent or 0.01
    sizes = node_size * unit * np.clip(np.cbrt(skeleton.mass * len(skeleton)), _LEAST, None)
    made = []
    for (x, y, z), name, wide in zip(
        skeleton.nodes.tolist(), skeleton.node_ids.tolist(), sizes.tolist(), strict=True
    ):
        sphere = _marker(NODES, name & _ID_BITS, SPHERE, _NODE_COLOR)
        made.append(sphere._replace(position=(x, y, z), scale=(wide, wide, wide)))
    if len(skeleton.edges):
        lines = _marker(EDGES, 0, LINE_LIST, _EDGE_COLOR)
        ends = skeleton.nodes[skeleton.edges.ravel()]
        width = line_width or 0.25 * unit
        made.append(lines._replace(scale=(width, 0.0, 0.0), points=ends))
    return made


def _marker(
    ns: str, number: int, kind: int, color: tuple[float, float, float, float]
) -> MarkerValues:
    origin = (0.0, 0.0, 0.0)
    return MarkerValues(ns, number, kind, ADD, origin, origin, color, np.empty((0, 3)))
