"""A skeleton as markers: edges as one line list, nodes as spheres, ids that stay."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from mdcs_pipeline.io.point_cloud2 import ns_to_stamp
from mdcs_pipeline.skeleton import Skeleton

EDGES = "edges"
NODES = "nodes"
EDGE_COLOR = (0.95, 0.45, 0.1, 1.0)
NODE_COLOR = (0.1, 0.35, 0.8, 1.0)


class Markers:
    """Makes the markers of one skeleton after another.

    Each array holds all of the skeleton, so that one that joins late sees it whole, and a
    DELETE for each marker of the array before that has no successor.
    """

    def __init__(self) -> None:
        self._shown: set[tuple[str, int]] = set()
        self._frame = ""

    def show(self, skeleton: Skeleton, line_width: float, node_size: float) -> MarkerArray:
        """Return the markers of a skeleton.

        Parameters
        ----------
        skeleton : Skeleton
        line_width : float
            In metres; 0 for a quarter of the median radius.
        node_size : float
            Diameter of a node of mean mass, in median radii.
        """
        header = header_of(skeleton)
        unit = _unit(skeleton)
        made = _spheres(skeleton, header, node_size * unit)
        if len(skeleton.edges):
            made.append(_lines(skeleton, header, line_width or 0.25 * unit))
        shown = {(marker.ns, marker.id) for marker in made}
        gone = self._deletions(self._shown - shown, header)
        self._shown, self._frame = shown, header.frame_id
        return MarkerArray(markers=gone + made)

    def clear(self) -> MarkerArray:
        """Return what takes all that is shown away."""
        gone = self._deletions(self._shown, Header(frame_id=self._frame))
        self._shown = set()
        return MarkerArray(markers=gone)

    def _deletions(self, keys: Iterable[tuple[str, int]], header: Header) -> list[Marker]:
        return [
            Marker(header=header, ns=name, id=number, action=Marker.DELETE)
            for name, number in sorted(keys)
        ]


def header_of(skeleton: Skeleton) -> Header:
    """Return the header of the cloud that a skeleton was made from."""
    seconds, rest = ns_to_stamp(skeleton.header.stamp_ns)
    return Header(stamp=Time(sec=seconds, nanosec=rest), frame_id=skeleton.header.frame_id)


def _unit(skeleton: Skeleton) -> float:
    """Return the length that sizes go by: a median radius, or some of the extent."""
    if not len(skeleton):
        return 1.0
    extent = float(np.linalg.norm(np.ptp(skeleton.nodes, axis=0)))
    return float(np.median(skeleton.radius)) or 0.01 * extent or 0.01


def _marker(header: Header, name: str, number: int, kind: int, color: Any) -> Marker:
    marker = Marker(header=header, ns=name, id=number, type=kind, action=Marker.ADD)
    marker.pose.orientation.w = 1.0
    marker.color = ColorRGBA(r=color[0], g=color[1], b=color[2], a=color[3])
    marker.lifetime = Duration()
    return marker


def _spheres(skeleton: Skeleton, header: Header, size: float) -> list[Marker]:
    # Volume goes with mass, so that a node of twice the mass looks twice as heavy.
    # A marker of size 0 is an error to viewers.
    sizes = size * np.clip(np.cbrt(skeleton.mass * len(skeleton)), 0.1, None)
    made = []
    for node, name, wide in zip(skeleton.nodes, skeleton.node_ids, sizes.tolist(), strict=True):
        # A marker's id is an int32.
        marker = _marker(header, NODES, int(name) & 0x7FFFFFFF, Marker.SPHERE, NODE_COLOR)
        place = marker.pose.position
        place.x, place.y, place.z = node.tolist()
        marker.scale = Vector3(x=wide, y=wide, z=wide)
        made.append(marker)
    return made


def _lines(skeleton: Skeleton, header: Header, width: float) -> Marker:
    marker = _marker(header, EDGES, 0, Marker.LINE_LIST, EDGE_COLOR)
    marker.scale = Vector3(x=width, y=0.0, z=0.0)
    ends = skeleton.nodes[skeleton.edges.ravel()]
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in ends.tolist()]
    return marker
