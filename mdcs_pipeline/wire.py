"""Messages as Apache Arrow: one struct a message, read where it lies.

A message is a frozen dataclass; its Arrow form is a struct of its fields, one row long:

=====================  ===========================================================
field                  Arrow type
=====================  ===========================================================
(n,) array             list<T>; truth values as uint8
(n, k) array           list<fixed_size_list<T>[k]>
scipy csr_array        struct<data, indices, indptr: lists; shape: list<int64>>
tuple of numbers       list<double> or list<int64>
float, int, bool, str  double, int64, bool, string
dict                   string, strict JSON
another dataclass      its struct
None                   left out
=====================  ===========================================================

The types are read off the annotations, so a stage of another package may have messages of
its own. What is read is built by the dataclass itself, which checks it; nothing is executed.
"""

from __future__ import annotations

import dataclasses
import json
import types
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from mdcs_pipeline.errors import InputError, MdcsError, OutputError
from mdcs_pipeline.io.arrow import array_of, arrow, csr_of, csr_struct, list_of
from mdcs_pipeline.io.plain import json_text

if TYPE_CHECKING:
    import pyarrow as pa

M = TypeVar("M")
SCHEMA_VERSION = 1
_HEAD = b"mdcs"


def to_arrow(message: Any) -> pa.StructArray:
    """Return a message as an Arrow struct array of one row.

    Parameters
    ----------
    message : dataclass

    Returns
    -------
    pyarrow.StructArray
        Its arrays are those of the message, not copies.

    Raises
    ------
    OutputError
        If a field is of a type that the table above does not name.
    MissingExtraError
        If pyarrow is not installed.
    """
    pa = arrow()
    if not dataclasses.is_dataclass(message) or isinstance(message, type):
        raise OutputError(
            "only dataclasses travel between processes", received=type(message).__name__
        )
    names, columns = [], []
    for item in dataclasses.fields(message):
        value = getattr(message, item.name)
        if value is None:
            continue
        try:
            columns.append(_column(value, pa))
        except OutputError as error:
            raise error.located(f"{type(message).__name__}.{item.name}") from error
        names.append(item.name)
    return pa.StructArray.from_arrays(columns, names)


def from_arrow(array: pa.StructArray, kind: type[M]) -> M:
    """Return the message that an Arrow struct array holds.

    Parameters
    ----------
    array : pyarrow.StructArray
        Of one row, as `to_arrow` makes it.
    kind : dataclass type

    Returns
    -------
    kind
        Its arrays are views of Arrow's memory, read-only.

    Raises
    ------
    InputError
        If the array holds no such message, or one that is not valid.
    """
    pa = arrow()
    what = kind.__name__
    if not pa.types.is_struct(array.type) or len(array) != 1:
        raise InputError(
            f"what arrived is no {what}",
            received=f"{len(array)} rows of {array.type}",
            remedy="send one row of a struct; see docs/wire.md",
        )
    try:
        return kind(**_fields(array, kind))
    except MdcsError:
        raise
    except (TypeError, ValueError, LookupError, OverflowError, pa.ArrowException) as error:
        raise InputError(f"what arrived is no whole {what}", received=str(error)) from error


def _fields(array: pa.StructArray, kind: type[Any]) -> dict[str, Any]:
    hints = _hints(kind)  # type: ignore[arg-type]  # classes are hashable
    values = {}
    for index, item in enumerate(array.type):
        if item.name not in hints:
            raise InputError(
                f"a {kind.__name__} has no field '{item.name}'",
                received=", ".join(field.name for field in array.type),
                remedy="run the same mdcs-pipeline on every host",
            )
        try:
            values[item.name] = _value(array.field(index), hints[item.name])
        except MdcsError as error:
            raise error.located(f"{kind.__name__}.{item.name}") from error
    return values


def to_bytes(message: Any | None, head: str) -> bytes:
    """Return a message and the head of its letter as one Arrow IPC stream.

    Parameters
    ----------
    message : dataclass, optional
        A stream without columns when absent.
    head : str
        Kept in the schema's metadata under ``mdcs``.
    """
    pa = arrow()
    metadata = {_HEAD: head.encode()}
    if message is None:
        batch = pa.RecordBatch.from_pydict({}, schema=pa.schema([]))
    else:
        batch = pa.RecordBatch.from_struct_array(to_arrow(message))
    batch = batch.replace_schema_metadata(metadata)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    return bytes(sink.getvalue())


def from_bytes(data: Any) -> tuple[str, pa.StructArray]:
    """Return the head and the Arrow form of the message of an Arrow IPC stream.

    Parameters
    ----------
    data : buffer
        Read where it lies, and kept alive by what is read from it.

    Raises
    ------
    InputError
        If it is no such stream.
    """
    pa = arrow()
    try:
        with pa.ipc.open_stream(pa.py_buffer(data)) as reader:
            batch = reader.read_next_batch()
            batch.validate(full=True)
        head = (batch.schema.metadata or {})[_HEAD].decode()
    except (pa.ArrowException, OSError, LookupError, StopIteration, ValueError) as error:
        raise InputError(
            "what arrived is no Arrow stream of a part",
            received=f"{type(error).__name__}: {error}",
            remedy="see docs/wire.md for what a stream holds",
        ) from error
    return head, batch.to_struct_array()


def _column(value: Any, pa: Any) -> Any:
    """Return one field as an Arrow array of one row."""
    if isinstance(value, np.ndarray):
        return list_of(value)
    if _is_csr(value):
        return csr_struct(value)
    if dataclasses.is_dataclass(value):
        return to_arrow(value)
    if isinstance(value, dict):
        return pa.array([json_text(value)], pa.string())
    if isinstance(value, tuple) and all(isinstance(v, int | float) for v in value):
        whole = value and all(isinstance(v, int) for v in value)
        return list_of(np.asarray(value, np.int64 if whole else np.float64))
    if isinstance(value, bool | int | float | str | np.generic):
        return pa.array([value.item() if isinstance(value, np.generic) else value])
    raise OutputError(
        "a field of this type does not travel between processes",
        received=type(value).__name__,
        remedy="use arrays, numbers, text or dataclasses of them; see docs/wire.md",
    )


def _value(column: Any, hint: Any) -> Any:
    """Return what one field of a message holds, as its annotation has it."""
    if column.null_count:
        return None
    hint = _without_none(hint)
    origin = get_origin(hint) or hint
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return from_arrow(column, hint)
    if isinstance(origin, type) and issubclass(origin, dict):
        return dict(json.loads(column[0].as_py()))
    if origin is tuple:
        return tuple(array_of(column).tolist())
    if origin is np.ndarray:
        return array_of(column, truth=_is_truth(hint))
    if _names_csr(hint):
        return csr_of(column)
    value = column[0].as_py()
    if hint is float and type(value) is int:
        return float(value)
    if isinstance(hint, type) and not isinstance(value, hint):
        raise InputError(f"{hint.__name__} was expected", received=type(value).__name__)
    return value


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    fields = {item.name for item in dataclasses.fields(kind)}
    return {name: hint for name, hint in get_type_hints(kind).items() if name in fields}


def _without_none(hint: Any) -> Any:
    if get_origin(hint) in (Union, types.UnionType):
        rest = [part for part in get_args(hint) if part is not type(None)]
        return rest[0] if len(rest) == 1 else Any
    return hint


def _is_truth(hint: Any) -> bool:
    return np.bool_ in [part for held in get_args(hint) for part in get_args(held)]


def _names_csr(hint: Any) -> bool:
    return getattr(hint, "__name__", "") in ("csr_array", "csr_matrix")


def _is_csr(value: Any) -> bool:
    return getattr(value, "format", "") == "csr" and hasattr(value, "indptr")


def describe(message: Any, indent: str = "") -> str:
    """Return the Arrow schema of a message, one field a line, as the documentation has it."""
    return "\n".join(_lines(to_arrow(message).type, indent))


def _lines(kind: Any, indent: str) -> list[str]:
    pa = arrow()
    lines = []
    is_struct: Callable[[Any], bool] = pa.types.is_struct
    for field in kind:
        if is_struct(field.type):
            lines += [f"{indent}{field.name}: struct", *_lines(field.type, indent + "  ")]
        else:
            text = str(field.type).replace("item: ", "")
            lines.append(f"{indent}{field.name}: {text}")
    return lines
