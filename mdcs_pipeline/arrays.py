"""Validation of the arrays that messages hold."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any, Literal, TypeGuard

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mdcs_pipeline.errors import InputError

if TYPE_CHECKING:
    from scipy import sparse

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_KINDS = {"i": "whole numbers", "b": "truth values"}


def frozen_view(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view; the caller's own array stays writable."""
    view = array.view()
    view.flags.writeable = False
    return view


def numeric_array(value: object, name: str) -> NDArray[Any]:
    """Return `value` as an array of real numbers, or say why it is none."""
    if isinstance(value, np.ma.MaskedArray) and np.any(value.mask):
        raise InputError(
            f"{name} holds masked values",
            received=f"{np.count_nonzero(value.mask)} of them",
            remedy="leave them out, or fill them with NaN where that may be dropped",
        )
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{name} is not an array", received=type(value).__name__, remedy=str(error)
        ) from error
    if array.dtype.kind not in "fiub":
        raise InputError(
            f"{name} must hold real numbers",
            received=f"{type(value).__name__} of dtype {array.dtype}",
            remedy="pass a numpy array of floats",
        )
    return array


def points_array(value: object, name: str = "points") -> FloatArray:
    """Return an (N, 3) floating-point array; float32 and float64 keep their type.

    Finiteness is not asked for here: see `finite_array`.
    """
    array = numeric_array(value, name)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(
            f"{name} must have the shape (N, 3)",
            received=f"shape {array.shape}",
            remedy="one row a point, three columns x, y, z",
        )
    if array.dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        array = array.astype(np.float64)
    return np.ascontiguousarray(array)


def _is_plain(value: object, dtype: DTypeLike) -> TypeGuard[NDArray[Any]]:
    """Return whether a value is an array of that type and of no kind of its own."""
    return type(value) is np.ndarray and value.dtype == dtype


def finite_array(
    value: object, shape: tuple[int | None, ...], name: str, dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """Return a contiguous array of the given shape (None: any) without NaN or infinity."""
    array = value if _is_plain(value, dtype) else numeric_array(value, name)
    fits = array.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise InputError(f"{name} must have the shape {wanted}", received=f"shape {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        bad = int(np.count_nonzero(~np.isfinite(array)))
        raise InputError(
            f"{name} must be finite", received=f"{bad} values that are NaN or infinite"
        )
    if array.dtype == dtype and array.flags.c_contiguous:
        return frozen_view(array)
    with np.errstate(invalid="ignore"):
        held = np.ascontiguousarray(array, dtype=dtype)
    # A cast to integers or truth values cuts off what they cannot hold.
    if held.dtype.kind in _KINDS and (lost := held != array).any():
        raise InputError(
            f"{name} must hold {_KINDS[held.dtype.kind]}", received=array[lost][0].item()
        )
    return frozen_view(held)


def masses(value: object, count: int, name: str = "mass") -> NDArray[np.float64]:
    """Return `count` masses, none negative, that sum to 1 within 1e-6."""
    array: NDArray[np.float64] = finite_array(value, (count,), name)
    if count and (array.min() < 0 or abs(float(array.sum()) - 1.0) > 1e-6):
        raise InputError(
            f"{name} must be non-negative and sum to 1",
            received=f"minimum {array.min():.3g}, sum {array.sum():.9g}",
        )
    return array


def index_pairs(value: object, count: int, name: str = "edges") -> IntArray:
    """Return (E, 2) int64 pairs i < j of indices below `count`, each pair once."""
    array = numeric_array(value, name)
    if array.size == 0:
        return frozen_view(np.empty((0, 2), np.int64))
    if array.ndim != 2 or array.shape[1] != 2 or array.dtype.kind not in "iu":
        raise InputError(
            f"{name} must be an (E, 2) array of integers",
            received=f"shape {array.shape}, dtype {array.dtype}",
        )
    pairs = np.ascontiguousarray(array, dtype=np.int64)
    if pairs.min() < 0 or pairs.max() >= count or (pairs[:, 0] >= pairs[:, 1]).any():
        raise InputError(
            f"{name} must name nodes 0 to {count - 1} with i < j in every pair",
            received=f"indices {pairs.min()} to {pairs.max()}",
        )
    # As numbers: they sort many times faster than rows, and cannot overflow where nodes fit.
    names = np.sort(pairs[:, 0] * count + pairs[:, 1])
    if (names[1:] == names[:-1]).any():
        raise InputError(f"{name} must name every pair once")
    return frozen_view(pairs)


def finite_points(
    points: FloatArray, nonfinite: Literal["drop", "refuse"] = "drop"
) -> tuple[FloatArray, int]:
    """Return the points whose coordinates are all finite, and how many were left out.

    Parameters
    ----------
    points : (N, 3) float
        The same array comes back when all of it is finite.
    nonfinite : {"drop", "refuse"}
        What to do with points that hold NaN or infinity.

    Returns
    -------
    points : (M, 3) float
        M <= N, in the same order and of the same type.
    dropped : int
        N - M.

    Raises
    ------
    InputError
        If there are such points and they are to be refused.
    """
    if np.isfinite(points).all():
        return points, 0
    finite = np.isfinite(points).all(axis=1)
    dropped = len(points) - int(np.count_nonzero(finite))
    if nonfinite == "refuse":
        raise InputError(
            f"{dropped} of {len(points)} points hold NaN or infinity",
            received=f"first in row {int(np.argmin(finite))}",
            remedy="remove them from the cloud, or set nonfinite to drop",
        )
    return points[finite], dropped


def set_fields(message: object, **values: object) -> None:
    """Set the fields of a frozen dataclass while it is being built."""
    for name, value in values.items():
        object.__setattr__(message, name, value)


def frozen_matrix(matrix: sparse.csr_array) -> sparse.csr_array:
    """Return a read-only matrix on the same entries; the caller's own stays writable."""
    # Its entries were checked when it was made.
    frozen = copy(matrix)
    for part in ("data", "indices", "indptr"):
        setattr(frozen, part, frozen_view(getattr(frozen, part)))
    return frozen
