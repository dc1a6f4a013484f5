"""Open3D, if it is there: its import, its clouds and its line sets."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray, IntArray
from mdcs_pipeline.errors import MissingExtraError

SYSTEM_PACKAGES = "libusb-1.0-0 libegl1 libgl1 libx11-6 libudev1 libidn2-0 libgomp1"


def import_open3d() -> Any:
    """Return the module open3d, imported at the first call.

    Returns
    -------
    module

    Raises
    ------
    MissingExtraError
        If neither open3d nor open3d-cpu is installed, or if a library of the system
        that they are linked to is missing.
    """
    try:
        import open3d
    except ModuleNotFoundError as error:
        if error.name != "open3d":
            raise MissingExtraError(
                "Open3D is installed, but a Python package that it needs is not",
                received=str(error),
                remedy=f"pip install {error.name}",
            ) from error
        raise MissingExtraError(
            "Open3D is needed for this and is not installed",
            remedy="pip install 'mdcs-pipeline[open3d-cpu]' (smaller, no GPU) or "
            "'mdcs-pipeline[open3d]', never both: they hold the same module",
        ) from error
    except (ImportError, OSError) as error:
        raise _broken(error) from error
    return open3d


def _broken(error: Exception) -> MissingExtraError:
    if ".so" in str(error):
        return MissingExtraError(
            "Open3D is installed, but a library of the system that it is linked to is missing",
            received=str(error),
            remedy=f"on Debian or Ubuntu: apt-get install {SYSTEM_PACKAGES}",
        )
    return MissingExtraError(
        "Open3D is installed, but cannot be imported",
        received=str(error),
        remedy="reinstall it; open3d and open3d-cpu in one environment overwrite each other",
    )


def points_of(cloud: object) -> FloatArray | None:
    """Return the points of an Open3D cloud, or None if `cloud` is none.

    Open3D is never imported here: who holds one of its clouds has imported it already.

    Parameters
    ----------
    cloud : object
        Possibly an `open3d.geometry.PointCloud` or an `open3d.t.geometry.PointCloud`.

    Returns
    -------
    (N, 3) array or None
        Of a tensor cloud, a view of its own memory, which keeps that memory alive; copied
        only from another device than the CPU. Of a legacy cloud, a float64 copy: numpy's
        view does not keep the vector that it looks into (Open3D 0.20), and shows freed
        memory once the cloud is given other points.
    """
    open3d: Any = sys.modules.get("open3d")
    if open3d is None:
        return None
    # A module of that name that is half imported, or is another, has no geometry.
    legacy = getattr(getattr(open3d, "geometry", None), "PointCloud", None)
    if legacy is not None and isinstance(cloud, legacy):
        return np.array(cloud.points)
    tensors = getattr(getattr(open3d, "t", None), "geometry", None)
    tensor = getattr(tensors, "PointCloud", None)
    if tensor is not None and isinstance(cloud, tensor):
        if "positions" not in cloud.point:
            return np.empty((0, 3))
        positions: FloatArray = cloud.point.positions.cpu().numpy()
        return positions
    return None


def line_set(nodes: FloatArray, edges: IntArray) -> Any:
    """Return an `open3d.geometry.LineSet`.

    Parameters
    ----------
    nodes : (K, 3) float
        Positions, in input units.
    edges : (E, 2) int
        Pairs of node indices.

    Returns
    -------
    open3d.geometry.LineSet

    Raises
    ------
    MissingExtraError
        If Open3D cannot be imported.
    """
    open3d = import_open3d()
    lines = open3d.geometry.LineSet()
    lines.points = open3d.utility.Vector3dVector(np.array(nodes, dtype=np.float64))
    lines.lines = open3d.utility.Vector2iVector(np.array(edges, dtype=np.int32))
    return lines


def tensor_line_set(nodes: FloatArray, edges: IntArray, **values: FloatArray) -> Any:
    """Return an `open3d.t.geometry.LineSet` on the CPU.

    Parameters
    ----------
    nodes : (K, 3) float
    edges : (E, 2) int
    **values : (K,) float
        Further attributes of the nodes by name; as (K, 1) float64 in the line set.

    Returns
    -------
    open3d.t.geometry.LineSet

    Raises
    ------
    MissingExtraError
        If Open3D cannot be imported.
    """
    open3d = import_open3d()
    lines = open3d.t.geometry.LineSet()
    lines.point.positions = _tensor(nodes)
    lines.line.indices = _tensor(edges)
    for name, value in values.items():
        lines.point[name] = _tensor(value[:, None])
    return lines


def cloud_of(points: FloatArray, tensor: bool = False) -> Any:
    """Return points as an Open3D cloud.

    Parameters
    ----------
    points : (N, 3) float
    tensor : bool
        For `open3d.t.geometry.PointCloud`, which keeps float32; otherwise
        `open3d.geometry.PointCloud`, which holds float64.

    Returns
    -------
    open3d.geometry.PointCloud or open3d.t.geometry.PointCloud

    Raises
    ------
    MissingExtraError
        If Open3D cannot be imported.
    """
    open3d = import_open3d()
    if tensor:
        cloud = open3d.t.geometry.PointCloud()
        cloud.point.positions = _tensor(points)
        return cloud
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.array(points, np.float64)))


def _tensor(values: NDArray[Any]) -> Any:
    # A copy: Open3D writes through to an array that numpy has as read-only.
    return import_open3d().core.Tensor.from_numpy(np.array(values, order="C"))
