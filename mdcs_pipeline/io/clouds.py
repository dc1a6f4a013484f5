"""Point clouds from files.

Open3D warns where it should fail: it gives back part of a damaged file, or points that
were never in it. So a file is checked against its own header and rows first, and what
comes back is counted again.
"""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mdcs_pipeline.arrays import FloatArray, points_array
from mdcs_pipeline.errors import InputError, nearest_name, suggestion
from mdcs_pipeline.io.open3d_bridge import import_open3d
from mdcs_pipeline.io.pcd_files import check_pcd
from mdcs_pipeline.io.ply_files import check_ply
from mdcs_pipeline.io.rows import Checked, check_pts, check_xyz

_CHECKS: dict[str, Callable[[Path], Checked]] = {
    ".ply": check_ply,
    ".pcd": check_pcd,
    ".xyz": lambda path: check_xyz(path, 3),
    ".xyzn": lambda path: check_xyz(path, 6),
    ".pts": check_pts,
}
CLOUD_SUFFIXES = (*_CHECKS, ".npy", ".npz")

# How files begin, where the beginning tells. What has no suffix of ours is named in words.
_MAGIC = {
    b"ply": ".ply",
    b"# .PCD": ".pcd",
    b"VERSION ": ".pcd",
    b"\x93NUMPY": ".npy",
    b"PK\x03\x04": ".npz",
    b"LASF": "LAS or LAZ",
    b"glTF": "binary glTF",
    b"solid ": "STL",
    b"OFF": "OFF",
    b"\x89PNG": "PNG",
    b"\x89HDF": "HDF5",
    b"\x1f\x8b": "gzip",
}
_ARRAY_NAMES = ("points", "positions")


def read_points(path: str | Path) -> FloatArray:
    """Return the points of a file, in the file's units.

    Parameters
    ----------
    path : str or Path
        ``.ply`` (also of a mesh: its vertices), ``.pcd``, ``.xyz``, ``.xyzn`` and ``.pts``
        are read by Open3D; ``.npy``, ``.npz`` and a binary ``.ply`` that begins with its
        vertices by numpy. An ``.npz`` needs an array ``points`` or ``positions``, or one
        (N, 3) array alone.

    Returns
    -------
    (N, 3) float32 or float64
        N > 0, in the file's order and precision. NaN and infinity are kept.

    Raises
    ------
    InputError
        If there is no such file, or it is unreadable, of another format, damaged or empty.
    MissingExtraError
        If the format needs Open3D, and that cannot be imported.
    """
    path = Path(path).expanduser()
    suffix = path.suffix.lower()
    if suffix not in CLOUD_SUFFIXES:
        raise InputError(
            f"no cloud format has the suffix '{path.suffix}'",
            where=str(path),
            remedy="known suffixes: " + ", ".join(CLOUD_SUFFIXES),
        )
    _check_contents(path, suffix)
    try:
        checked = _CHECKS[suffix](path) if suffix in _CHECKS else None
        if checked is not None and not checked.points:
            raise _empty(path)
        if checked is not None and checked.sure and checked.coordinates is not None:
            # Open3D takes half a second to import.
            return checked.coordinates
        points = _read_numpy(path) if checked is None else _read_open3d(path, suffix)
    except OSError as error:
        raise _unreadable(path, error) from error
    if checked is not None:
        _compare(path, points, checked)
    if len(points) == 0:
        raise _empty(path)
    return points


def _compare(path: Path, points: FloatArray, checked: Checked) -> None:
    """Refuse what Open3D read if the file holds other points."""
    if len(points) != checked.points:
        raise InputError(
            f"the file declares {checked.points} points, Open3D read {len(points)}",
            where=str(path),
            remedy="the file is of a variant that Open3D does not know: export it again",
        )
    if checked.coordinates is None:
        return
    # As loose as float32, which some columns are declared to be; what this is about is
    # unset memory, as in rows of PTS that end in a space (Open3D 0.20).
    same = np.isclose(points, checked.coordinates, rtol=1e-6, atol=1e-37, equal_nan=True)
    if not same.all():
        row = int(np.argmin(same.all(axis=1)))
        raise InputError(
            f"Open3D misread {np.count_nonzero(~same.all(axis=1))} of {len(points)} points",
            where=str(path),
            received=f"point {row + 1}: {points[row].tolist()}, the file says "
            f"{checked.coordinates[row].tolist()}",
            remedy="write the rows with single spaces, none at the end and no tabs, "
            "and coordinates that fit their declared type",
        )


def _empty(path: Path) -> InputError:
    return InputError("the file holds no points", where=str(path))


def _unreadable(path: Path, error: OSError) -> InputError:
    if isinstance(error, PermissionError):
        return InputError(
            "no permission to read the file", where=str(path), remedy="chmod u+r, or another user"
        )
    return InputError("the file cannot be read", where=str(path), remedy=str(error))


def _check_contents(path: Path, suffix: str) -> None:
    """Refuse what is no file, an empty one, or one whose first bytes belie its suffix."""
    if path.is_dir():
        raise InputError(
            "a folder, where a file was wanted",
            where=str(path),
            remedy="name one of its files; frame_files lists them in order",
        )
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
    except FileNotFoundError as error:
        near = sorted(p.name for p in path.parent.iterdir()) if path.parent.is_dir() else None
        raise InputError(
            "no such file",
            where=str(path),
            remedy=f"there is no folder {path.parent}"
            if near is None
            else suggestion(path.name, near)
            if nearest_name(path.name, near)
            else "is the path relative to another folder?",
        ) from error
    except OSError as error:
        raise _unreadable(path, error) from error
    if not head:
        raise InputError("the file is empty", where=str(path))
    # An older PCD file may start with any comment or field: its own check reads on.
    held = next((name for magic, name in _MAGIC.items() if head.startswith(magic)), None)
    needs_magic = suffix in (".ply", ".npy", ".npz")
    if held == suffix or (held is None and not needs_magic):
        return
    if held is None:
        raise InputError(
            f"the contents are not of the format that '{suffix}' names",
            where=str(path),
            received=head,
            remedy="the file is damaged, or its suffix is wrong",
        )
    raise InputError(
        f"the suffix says '{suffix}', the contents are {held}",
        where=str(path),
        remedy=f"rename the file to {path.with_suffix(held).name}"
        if held in CLOUD_SUFFIXES
        else "convert it to one of " + ", ".join(CLOUD_SUFFIXES),
    )


def _read_open3d(path: Path, suffix: str) -> FloatArray:
    open3d = import_open3d()
    silent = open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error)
    keep_all: dict[str, Any] = {"remove_nan_points": False, "remove_infinite_points": False}
    try:
        with silent:
            if suffix == ".pcd":
                # The legacy reader gives zeros for 8-byte coordinates and crashes on more
                # field layouts than the tensor one (Open3D 0.20).
                cloud = open3d.t.io.read_point_cloud(str(path), format="pcd", **keep_all)
                found = "positions" in cloud.point
                return points_array(cloud.point.positions.numpy() if found else np.empty((0, 3)))
            cloud = open3d.io.read_point_cloud(str(path), format=suffix[1:], **keep_all)
            # A copy, so that the cloud's normals and colours can be freed.
            return np.array(cloud.points)
    except RuntimeError as error:
        raise InputError(
            "Open3D cannot read the file", where=str(path), remedy=str(error)
        ) from error


def _read_numpy(path: Path) -> FloatArray:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return points_array(loaded, "the array")
        with loaded as archive:
            name, array = _pick_array(archive)
        return points_array(array, f"the array '{name}'")
    except InputError as error:
        raise error.located(str(path)) from error
    except (ValueError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            "numpy cannot read the file: it is damaged or holds Python objects",
            where=str(path),
            received=str(error),
            remedy="save a plain float array again",
        ) from error


def _pick_array(archive: Any) -> tuple[str, Any]:
    keys = list(archive.files)
    if {"format", "node_ids"} <= set(keys):
        raise InputError("this is a skeleton, not a cloud", remedy="load it by Skeleton.load")
    for name in _ARRAY_NAMES:
        if name in keys:
            return name, archive[name]
    arrays = {name: archive[name] for name in keys}
    fitting = [name for name, array in arrays.items() if array.ndim == 2 and array.shape[1] == 3]
    if len(fitting) != 1:
        raise InputError(
            f"{len(fitting) or 'no'} arrays of the shape (N, 3), where one was wanted",
            received=", ".join(f"{name} {array.shape}" for name, array in arrays.items()),
            remedy="save the cloud under the key 'points'",
        )
    return fitting[0], arrays[fitting[0]]


def natural_key(path: Path) -> tuple[list[str | int], str]:
    """Return what sorts files so that ``frame_2`` stands before ``frame_10``."""
    parts = re.split("([0-9]+)", path.name.lower())
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], path.name


def frame_files(folder: str | Path) -> list[Path]:
    """Return the cloud files of a folder, numbers in their names in order of size.

    Parameters
    ----------
    folder : str or Path
        Searched itself, not what is in its folders; hidden files are left out.

    Returns
    -------
    list of Path
        At least one; ``frame_2`` stands before ``frame_10``.

    Raises
    ------
    InputError
        If it is no folder that can be read, or there is no cloud file in it.
    """
    folder = Path(folder).expanduser()
    try:
        present = [path for path in folder.iterdir() if path.is_file()]
    except OSError as error:
        raise InputError(
            "a folder of cloud files was wanted", where=str(folder), remedy=str(error)
        ) from error
    files = [
        path
        for path in present
        if path.suffix.lower() in CLOUD_SUFFIXES and not path.name.startswith(".")
    ]
    if not files:
        raise InputError(
            "the folder holds no cloud file",
            where=str(folder),
            received=f"{len(present)} other files",
            remedy="known suffixes: " + ", ".join(CLOUD_SUFFIXES),
        )
    return sorted(files, key=natural_key)
