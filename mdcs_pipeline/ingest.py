"""From whatever holds points to a `PointCloud` message."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

from mdcs_pipeline.arrays import finite_points, points_array
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.header import Header
from mdcs_pipeline.io.open3d_bridge import points_of
from mdcs_pipeline.messages import PointCloud


def as_point_cloud(
    points: object, header: Header | None = None, nonfinite: Literal["drop", "refuse"] = "drop"
) -> PointCloud:
    """Return a `PointCloud` message of the given points.

    Parameters
    ----------
    points : (N, 3) array-like, Open3D cloud or PointCloud
        Coordinates of any real type in any memory layout, in input units. The array
        itself is never written to. Contiguous float32 and float64 arrays and tensors on
        the CPU are looked at where they lie, without a copy, unless points are dropped.
    header : Header, optional
        Of the message. Where `points` is a `PointCloud` already, its own frame and stamp
        are kept unless this names others; the number is taken from here.
    nonfinite : {"drop", "refuse"}
        What to do with points that hold NaN or infinity; what is dropped is counted.

    Returns
    -------
    PointCloud

    Raises
    ------
    InputError
        If these are no points, there are none, or non-finite ones are refused.
    """
    if isinstance(points, PointCloud):
        cloud = points if header is None else replace(points, header=_over(points.header, header))
    else:
        held = points_of(points)
        rows = points_array(points if held is None else held)
        finite, dropped = finite_points(rows, nonfinite)
        if dropped and not len(finite):
            raise InputError(
                "all points hold NaN or infinity",
                received=f"{dropped} points",
                remedy="check the source: a sensor that sees nothing gives such clouds",
            )
        cloud = PointCloud(finite, header=header or Header(), dropped=dropped)
    if not len(cloud):
        raise InputError("the cloud is empty", remedy="pass at least one point")
    return cloud


def given_cloud(points: Any) -> PointCloud:
    """Return what a stage was called with as a message.

    In a graph that is a message already, which comes back as it is, empty ones too. In a
    script it may be anything that `as_point_cloud` takes.
    """
    return points if isinstance(points, PointCloud) else as_point_cloud(points)


def _over(own: Header, given: Header) -> Header:
    return Header(given.frame_id or own.frame_id, given.stamp_ns or own.stamp_ns, given.seq)
