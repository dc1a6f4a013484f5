"""A skeleton's markers as ROS messages; what they show is decided in `mdcs_pipeline.io.markers`."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from mdcs_pipeline.io.markers import MarkerHistory, MarkerValues
from mdcs_pipeline.io.point_cloud2 import ns_to_stamp
from mdcs_pipeline.skeleton import Skeleton


class Markers:
    """Makes the markers of one skeleton after another, with deletions of what has vanished."""

    def __init__(self) -> None:
        self._history = MarkerHistory()
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
        self._frame = header.frame_id
        return _array(self._history.show(skeleton, line_width, node_size), header)

    def clear(self) -> MarkerArray:
        """Return what takes all that is shown away."""
        return _array(self._history.clear(), Header(frame_id=self._frame))


def header_of(skeleton: Skeleton) -> Header:
    """Return the header of the cloud that a skeleton was made from."""
    seconds, rest = ns_to_stamp(skeleton.header.stamp_ns)
    return Header(stamp=Time(sec=seconds, nanosec=rest), frame_id=skeleton.header.frame_id)


def _array(values: list[MarkerValues], header: Header) -> MarkerArray:
    return MarkerArray(markers=[_message(value, header) for value in values])


def _message(value: MarkerValues, header: Header) -> Marker:
    marker = Marker(header=header, ns=value.ns, id=value.id, type=value.type, action=value.action)
    place = marker.pose.position
    place.x, place.y, place.z = value.position
    marker.pose.orientation.w = 1.0
    red, green, blue, alpha = value.color
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    wide, deep, high = value.scale
    marker.scale = Vector3(x=wide, y=deep, z=high)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in value.points.tolist()]
    return marker
