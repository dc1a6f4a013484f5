"""Clouds, poses and skeletons into a bag that ROS 2 and Foxglove open."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mdcs_pipeline.errors import MissingExtraError, OutputError
from mdcs_pipeline.io.markers import MarkerHistory, MarkerValues
from mdcs_pipeline.io.point_cloud2 import encode_points, ns_to_stamp

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

# Viewers draw nothing that is in no frame.
DEFAULT_FRAME = "map"
# Of ROS 2 Iron, so that it and what came after it can play the bag.
_BAG_VERSION: Literal[8] = 8


class BagWriter:
    """A bag that is there whole or not at all.

    Parameters
    ----------
    path : str or Path
        A name with the suffix ``.mcap`` becomes a lone file; any other a rosbag2 folder,
        which must not exist.
    storage : {"mcap", "sqlite3"}
        What is inside the folder.

    Raises
    ------
    OutputError
        If the place is taken or cannot be written to.
    MissingExtraError
        Without the extra ``bags``.

    Examples
    --------
    >>> with BagWriter("result.mcap") as bag:  # doctest: +SKIP
    ...     bag.add_cloud(points, stamp_ns, "map")
    ...     bag.add_skeleton(skeleton)
    """

    def __init__(self, path: str | Path, storage: Literal["mcap", "sqlite3"] = "mcap") -> None:
        self.path = Path(path).expanduser()
        self._lone = self.path.suffix.lower() == ".mcap"
        if self._lone and storage != "mcap":
            raise OutputError("a lone .mcap holds no sqlite3", where=str(self.path))
        self._check_place()
        self._store = _typestore()
        self._storage = storage
        self._topics: dict[str, Any] = {}
        self._history: dict[str, MarkerHistory] = {}

    def _check_place(self) -> None:
        if self.path.is_dir() or (self.path.exists() and not self._lone):
            raise OutputError(
                "the bag's place is taken",
                where=str(self.path),
                remedy="name another; what is there is not written over",
            )
        if not self.path.parent.is_dir():
            raise OutputError(
                f"there is no folder {self.path.parent}",
                where=str(self.path),
                remedy="make the folder first",
            )

    def __enter__(self) -> BagWriter:
        from rosbags.rosbag2 import StoragePlugin, Writer

        plugin = StoragePlugin.MCAP if self._storage == "mcap" else StoragePlugin.SQLITE3
        # Beside its place, so that the last step is a single one.
        self._scratch = self.path.with_name(f".mdcs-{secrets.token_hex(8)}.tmp")
        try:
            self._scratch.mkdir()
            self._writer = Writer(
                self._scratch / self.path.stem if self._lone else self._scratch / self.path.name,
                version=_BAG_VERSION,
                storage_plugin=plugin,
            )
            self._writer.open()
        except OSError as error:
            self._discard()
            raise self._refused(error) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if kind is not None:
                self._writer.abort()
                return
            self._writer.close()
            held = self._writer.path
            os.replace(held / f"{held.name}.mcap" if self._lone else held, self.path)  # noqa: PTH105
        except OSError as fault:
            raise self._refused(fault) from fault
        finally:
            self._discard()

    def _discard(self) -> None:
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _refused(self, error: OSError) -> OutputError:
        return OutputError("the bag cannot be written", where=str(self.path), received=str(error))

    def add_cloud(
        self,
        points: ArrayLike,
        stamp_ns: int,
        frame_id: str = "",
        *,
        topic: str = "/points",
        columns: Mapping[str, ArrayLike] | None = None,
        recorded_ns: int | None = None,
    ) -> None:
        """Write a `sensor_msgs/PointCloud2`.

        Parameters
        ----------
        points : (N, 3) array-like
            Written as float32.
        stamp_ns : int
        frame_id : str
            Written as ``map`` when empty, for viewers draw nothing that is in no frame.
        topic : str
        columns : mapping of str to (N,) array-like, optional
            Further fields; see `encode_points`.
        recorded_ns : int, optional
            Where the message stands in the bag; its stamp when absent.
        """
        packed = encode_points(points, columns)
        field = self._store.types["sensor_msgs/msg/PointField"]
        values = packed._asdict()
        values["fields"] = [field(f.name, f.offset, f.datatype, f.count) for f in packed.fields]
        header = self._header(stamp_ns, frame_id)
        self._write(topic, "sensor_msgs/msg/PointCloud2", recorded_ns, stamp_ns, header, **values)

    def add_pose(
        self,
        pose: ArrayLike,
        stamp_ns: int,
        frame_id: str = "",
        *,
        topic: str = "/pose",
        recorded_ns: int | None = None,
    ) -> None:
        """Write a `geometry_msgs/PoseStamped` of a (4, 4) rigid motion."""
        from scipy.spatial.transform import Rotation

        matrix = np.asarray(pose, np.float64)
        place = tuple(matrix[:3, 3].tolist())
        turn = tuple(Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist())
        header = self._header(stamp_ns, frame_id)
        held = self._pose(place, turn)
        self._write(topic, "geometry_msgs/msg/PoseStamped", recorded_ns, stamp_ns, header, held)

    def add_skeleton(
        self, skeleton: Skeleton, *, topic: str = "/skeleton", recorded_ns: int | None = None
    ) -> None:
        """Write a `visualization_msgs/MarkerArray`, with its header's stamp and frame.

        Markers keep the ids of their nodes from skeleton to skeleton, and those that have
        gone are deleted.
        """
        held = skeleton.header
        header = self._header(held.stamp_ns, held.frame_id)
        history = self._history.setdefault(topic, MarkerHistory())
        markers = [self._marker(values, header) for values in history.show(skeleton)]
        kind = "visualization_msgs/msg/MarkerArray"
        self._write(topic, kind, recorded_ns, held.stamp_ns, markers)

    def _write(
        self,
        topic: str,
        kind: str,
        recorded_ns: int | None,
        stamp_ns: int,
        *parts: Any,
        **values: Any,
    ) -> None:
        message = self._store.types[kind](*parts, **values)
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        when = stamp_ns if recorded_ns is None else recorded_ns
        try:
            raw = self._store.serialize_cdr(message, kind)
            self._writer.write(self._topics[topic], when, raw)
        except OSError as error:
            raise self._refused(error) from error

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        stamp = self._store.types["builtin_interfaces/msg/Time"](*ns_to_stamp(stamp_ns))
        return self._store.types["std_msgs/msg/Header"](stamp, frame_id or DEFAULT_FRAME)

    def _pose(
        self,
        place: tuple[float, ...] = (0.0, 0.0, 0.0),
        turn: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
    ) -> Any:
        types = self._store.types
        return types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](*place),
            types["geometry_msgs/msg/Quaternion"](*turn),
        )

    def _marker(self, values: MarkerValues, header: Any) -> Any:
        types = self._store.types
        point = types["geometry_msgs/msg/Point"]
        nothing = np.empty(0, np.uint8)
        return types["visualization_msgs/msg/Marker"](
            header=header,
            ns=values.ns,
            id=values.id,
            type=values.type,
            action=values.action,
            pose=self._pose(values.position),
            scale=types["geometry_msgs/msg/Vector3"](*values.scale),
            color=types["std_msgs/msg/ColorRGBA"](*values.color),
            lifetime=types["builtin_interfaces/msg/Duration"](0, 0),
            frame_locked=False,
            points=[point(*place) for place in values.points.tolist()],
            colors=[],
            texture_resource="",
            texture=types["sensor_msgs/msg/CompressedImage"](header, "", nothing),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=types["visualization_msgs/msg/MeshFile"]("", nothing),
            mesh_use_embedded_materials=False,
        )


def _typestore() -> Any:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "writing bags needs the package rosbags",
            received=str(error),
            remedy="pip install 'mdcs-pipeline[bags]'",
        ) from error
    return get_typestore(Stores.ROS2_JAZZY)
