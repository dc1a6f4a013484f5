"""Arrays as Apache Arrow lists, read where they lie."""

from __future__ import annotations

from typing import Any

import numpy as np

from mdcs_pipeline.errors import InputError, MissingExtraError, OutputError

_CSR = ("data", "indices", "indptr", "shape")


def arrow() -> Any:
    """Return pyarrow, or raise a `MissingExtraError`."""
    try:
        import pyarrow
    except ImportError as error:
        raise MissingExtraError(
            "messages between processes need pyarrow",
            received=str(error),
            remedy="install an extra that brings it: pip install 'mdcs-pipeline[ros2]' or [dora]",
        ) from error
    return pyarrow


def list_of(array: np.ndarray[Any, Any]) -> Any:
    """Return an array as an Arrow list array of one row; not a copy where numpy allows.

    Parameters
    ----------
    array : (n,) or (n, k) array
        Of numbers or truth values; the latter become uint8.

    Raises
    ------
    OutputError
        If it is of another shape or type.
    """
    pa = arrow()
    if array.ndim not in (1, 2) or array.dtype.kind not in "fiub":
        raise OutputError(
            "an array of this shape or type does not travel between processes",
            received=f"{array.ndim} axes of {array.dtype}",
        )
    held = array.view(np.uint8) if array.dtype == np.bool_ else array
    native = np.ascontiguousarray(held, held.dtype.newbyteorder("="))
    values = pa.array(native.reshape(-1))
    if array.ndim == 2:
        if not array.shape[1]:
            raise OutputError("an array of no columns does not travel between processes")
        values = pa.FixedSizeListArray.from_arrays(values, array.shape[1])
    return pa.ListArray.from_arrays(pa.array([0, len(array)], pa.int32()), values)


def array_of(column: Any, truth: bool = False) -> np.ndarray[Any, Any]:
    """Return the array that a row of Arrow lists holds, as a view of Arrow's memory.

    Parameters
    ----------
    column : pyarrow.ListArray
        Of one row.
    truth : bool
        Whether uint8 means truth values.

    Raises
    ------
    InputError
        If it is no list, or a truth value is neither 0 nor 1.
    """
    pa = arrow()
    if not pa.types.is_list(column.type):
        raise InputError("a list was expected", received=str(column.type))
    values, width = column.flatten(), None
    if pa.types.is_fixed_size_list(values.type):
        width = values.type.list_size
        values = values.flatten()
    # A message may be of no points; then there is no buffer to look at.
    flat: np.ndarray[Any, Any] = values.to_numpy(zero_copy_only=bool(len(values)))
    array = flat if width is None else flat.reshape(-1, width)
    if truth and array.dtype == np.uint8:
        if len(array) and array.max() > 1:
            raise InputError("truth values are 0 or 1", received=int(array.max()))
        return array.view(np.bool_)
    return array


def csr_struct(matrix: Any) -> Any:
    """Return a scipy ``csr_array`` as an Arrow struct array of one row."""
    parts = (matrix.data, matrix.indices, matrix.indptr, np.asarray(matrix.shape, np.int64))
    return arrow().StructArray.from_arrays([list_of(part) for part in parts], list(_CSR))


def csr_of(column: Any) -> Any:
    """Return the scipy ``csr_array`` that an Arrow struct holds, over Arrow's memory.

    Raises
    ------
    InputError
        If its parts do not make a matrix.
    """
    from scipy import sparse

    data, indices, indptr, shape = (array_of(column.field(name)) for name in _CSR)
    rows, columns = (int(n) for n in shape)
    whole = (
        len(indptr) == rows + 1
        and len(data) == len(indices) == indptr[-1]
        and indptr[0] == 0
        and (np.diff(indptr) >= 0).all()
        and (not len(indices) or 0 <= indices.min() <= indices.max() < columns)
    )
    if not whole:
        raise InputError("the sparse matrix does not fit together", received=f"shape {shape}")
    return sparse.csr_array((data, indices, indptr), shape=(rows, columns), copy=False)
