"""A skeleton as a file that can be read back: JSON and NPZ, of one content.

Both hold the format's name and version, the skeleton's arrays, its header, and the
settings and diagnostics of the run that made it.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.interchange import INTERCHANGE, read_interchange
from mdcs_pipeline.io.plain import json_text

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

FORMAT = "mdcs-skeleton"
FORMAT_VERSION = 1

# Name, type and shape without the first axis.
_ARRAYS: dict[str, tuple[type, tuple[int, ...]]] = {
    "nodes": (np.float64, (3,)),
    "edges": (np.int64, (2,)),
    "mass": (np.float64, ()),
    "radius": (np.float64, ()),
    "node_ids": (np.int64, ()),
}
_OPTIONAL = "assignment"
_MAPPINGS = ("header", "settings", "diagnostics")


def package_version() -> str:
    """Return the version of mdcs-pipeline, or "unknown" in an uninstalled tree."""
    try:
        return version("mdcs-pipeline")
    except PackageNotFoundError:
        return "unknown"


def _content(skeleton: Skeleton, settings: Mapping[str, Any] | None) -> dict[str, Any]:
    header = skeleton.header
    content: dict[str, Any] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "mdcs_pipeline": package_version(),
        "header": {
            "frame_id": header.frame_id,
            "stamp_ns": header.stamp_ns,
            "seq": header.seq,
        },
        "settings": dict(settings or {}),
        "diagnostics": skeleton.diagnostics,
    }
    content.update((name, getattr(skeleton, name)) for name in _ARRAYS)
    if skeleton.assignment is not None:
        content[_OPTIONAL] = skeleton.assignment
    return content


def json_bytes(skeleton: Skeleton, settings: Mapping[str, Any] | None = None) -> bytes:
    """Return the skeleton as strict JSON (RFC 8259) in UTF-8, one key a line."""
    content = _content(skeleton, settings)
    lines = [f"{json_text(key)}: {json_text(value)}" for key, value in content.items()]
    # A lone surrogate, as in a path that is no UTF-8, has no place in the file as it is.
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode("utf-8", "backslashreplace")


def npz_bytes(skeleton: Skeleton, settings: Mapping[str, Any] | None = None) -> bytes:
    """Return the skeleton as a compressed NPZ archive; mappings are in it as JSON text."""
    content = _content(skeleton, settings)
    content.update((name, json_text(content[name])) for name in _MAPPINGS)
    arrays: dict[str, Any] = {name: np.asarray(item) for name, item in content.items()}
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def load_skeleton(path: str | Path) -> dict[str, Any]:
    """Return what a skeleton file holds.

    Parameters
    ----------
    path : str or Path
        A file that `Skeleton.save` wrote: ``.json`` or ``.npz`` for all of a skeleton;
        ``.ply``, ``.graphml`` and ``.swc`` for what they hold of it, see `read_interchange`.

    Returns
    -------
    dict
        ``nodes`` (K, 3) and ``mass``, ``radius`` (K,) float64; ``edges`` (E, 2),
        ``node_ids`` (K,) and ``assignment`` (N,) int64, the last None if absent; ``header``,
        ``settings`` and ``diagnostics`` dicts; ``mdcs_pipeline``, the version that wrote it.

    Raises
    ------
    InputError
        If there is no such file, or it is no skeleton, damaged, or of a later format.
    """
    path = Path(path).expanduser()
    suffix = path.suffix.lower()
    readers = {".json": _read_json, ".npz": _read_npz}
    reader = readers.get(suffix)
    if reader is None and suffix not in INTERCHANGE:
        raise InputError(
            f"skeletons are not read back from '{path.suffix}'",
            where=str(path),
            remedy="known suffixes: " + ", ".join([*readers, *INTERCHANGE]),
        )
    try:
        if reader is None:
            return read_interchange(path)
        content = reader(path)
        _check_format(content)
        return {name: _entry(content, name) for name in (*_ARRAYS, _OPTIONAL, *_MAPPINGS)} | {
            "mdcs_pipeline": str(content.get("mdcs_pipeline", "unknown"))
        }
    except InputError as error:
        raise error.located(str(path)) from error
    except OSError as error:
        raise InputError(
            "the skeleton file cannot be read", where=str(path), remedy=str(error)
        ) from error


def _damaged(what: str, error: Exception) -> InputError:
    return InputError(
        what, received=str(error), remedy="the file is damaged or not a skeleton: save it again"
    )


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON number")


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise _damaged("the file is not JSON", error) from error
    return content if isinstance(content, dict) else {}


def _read_npz(path: Path) -> dict[str, Any]:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            raise ValueError("one bare array, as of an .npy file")
        with loaded as archive:
            content: dict[str, Any] = {name: archive[name] for name in archive.files}
        for name in ("format", "format_version", "mdcs_pipeline"):
            if name in content:
                content[name] = content[name].item()
        for name in _MAPPINGS:
            if name in content:
                content[name] = json.loads(str(content[name]), parse_constant=_no_constant)
    except OSError:
        raise
    except (ValueError, EOFError, AttributeError, zipfile.BadZipFile, zlib.error) as error:
        raise _damaged("the file is not an NPZ archive of plain arrays", error) from error
    return content


def _check_format(content: dict[str, Any]) -> None:
    if content.get("format") != FORMAT:
        raise InputError(
            f"this is no skeleton file: its 'format' is not '{FORMAT}'",
            received=content.get("format", "no such key"),
            remedy="give a file that Skeleton.save wrote as .json or .npz",
        )
    held = content.get("format_version")
    if not isinstance(held, int) or isinstance(held, bool) or held < 1:
        raise InputError("'format_version' must be a whole number from 1", received=held)
    if held > FORMAT_VERSION:
        raise InputError(
            f"the skeleton file is of format version {held}, this package reads {FORMAT_VERSION}",
            remedy="upgrade mdcs-pipeline",
        )


def _entry(content: dict[str, Any], name: str) -> Any:
    if name == _OPTIONAL and content.get(name) is None:
        return None
    if name not in content:
        raise InputError(f"the skeleton file has no '{name}'", remedy="save the skeleton again")
    value = content[name]
    if name in _MAPPINGS:
        if not isinstance(value, dict):
            raise InputError(f"'{name}' must be a mapping", received=value)
        return value
    kind, rest = _ARRAYS.get(name, (np.int64, ()))
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError) as error:
        raise _damaged(f"'{name}' is not an array", error) from error
    if array.size == 0:
        return np.empty((0, *rest), kind)
    wanted = "iu" if kind is np.int64 else "fiu"
    if array.dtype.kind not in wanted or array.shape[1:] != rest or array.ndim != len(rest) + 1:
        raise InputError(
            f"'{name}' must be {np.dtype(kind)} of the shape {('any', *rest)}",
            received=f"{array.dtype} of the shape {array.shape}",
        )
    return array.astype(kind)
