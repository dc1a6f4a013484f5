"""Skeletons back from the formats of other tools: PLY, GraphML and SWC, as written here.

They hold less than JSON and NPZ do: none has the assignment and the diagnostics, PLY and SWC
have no header and no names of nodes, and SWC has no mass.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.ply_lines import ply_header

Content = dict[str, Any]
_SAVE_AGAIN = "save the skeleton again, as .json if anything is to be kept"


def read_interchange(path: Path) -> Content:
    """Return the arrays and the header of a skeleton file, as `load_skeleton` gives them.

    Parameters
    ----------
    path : Path
        ``.ply``, ``.graphml`` or ``.swc``. Of the last, every node gets the same mass.

    Raises
    ------
    InputError
        If the file is damaged, or holds something else.
    OSError
        If it cannot be read.
    """
    content = INTERCHANGE[path.suffix.lower()](path.read_bytes())
    defaults: Content = {"header": {}, "settings": {}, "diagnostics": {}, "assignment": None}
    return {**defaults, "mdcs_pipeline": "unknown", **content}


def _ply(data: bytes) -> Content:
    head, found, body = data.partition(b"end_header\n")
    lines = head.decode("ascii", "replace").split("\n")
    counts = [line.rpartition(" ")[2] for line in lines if line.startswith("element ")]
    if not found or len(counts) != 2 or not all(text.isdecimal() for text in counts):
        raise InputError("this is no line set in PLY", remedy=_SAVE_AGAIN)
    count, pairs = map(int, counts)
    if head + found != ply_header(count, pairs):
        raise InputError(
            "this PLY is of another layout than skeletons have",
            received="; ".join(lines[1:4]),
            remedy=_SAVE_AGAIN,
        )
    size = count * 5 * 8
    if len(body) != size + pairs * 2 * 4:
        raise InputError(
            "the PLY is cut off or has grown",
            received=f"{len(body)} bytes behind the header, {size + pairs * 8} were declared",
            remedy=_SAVE_AGAIN,
        )
    rows = np.frombuffer(body[:size], "<f8").reshape(count, 5)
    edges = np.frombuffer(body[size:], "<i4").reshape(pairs, 2)
    return _content(rows[:, :3], edges, rows[:, 3], rows[:, 4], np.arange(count))


def _graphml(data: bytes) -> Content:
    import networkx as nx

    # GraphML needs neither; entities can blow a small file up.
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError("GraphML with a document type is not read", remedy=_SAVE_AGAIN)
    try:
        graph: nx.Graph[int] = nx.read_graphml(io.BytesIO(data), node_type=int)
        names = list(graph)
        table = [
            [held[key] for key in ("x", "y", "z", "mass", "radius")]
            for held in graph.nodes.values()
        ]
        header = {
            name: kind(graph.graph[name])
            for name, kind in (("frame_id", str), ("stamp_ns", int), ("seq", int))
        }
        rows = np.array(table, np.float64).reshape(-1, 5)
    except (ValueError, TypeError, KeyError, SyntaxError, nx.NetworkXException) as error:
        raise InputError(
            "this is no skeleton in GraphML",
            received=f"{type(error).__name__}: {error}",
            remedy=_SAVE_AGAIN,
        ) from error
    place = {name: k for k, name in enumerate(names)}
    edges = [(place[a], place[b]) for a, b in graph.edges]
    content = _content(rows[:, :3], edges, rows[:, 3], rows[:, 4], names)
    return {**content, "header": header}


def _swc(data: bytes) -> Content:
    lines = data.decode("ascii", "replace").splitlines()
    texts = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    try:
        rows = [[float(text) for text in row] for row in texts]
        table = np.array(rows, np.float64).reshape(-1, 7)
    except ValueError as error:
        raise InputError("this is no SWC", received=str(error), remedy=_SAVE_AGAIN) from error
    names, parents = table[:, 0].tolist(), table[:, 6].tolist()
    place = {name: k for k, name in enumerate(names)}
    lost = [parent for parent in parents if parent != -1 and parent not in place]
    if lost:
        raise InputError("the SWC is cut off", received=f"no node {lost[0]:g}", remedy=_SAVE_AGAIN)
    edges = [(k, place[parent]) for k, parent in enumerate(parents) if parent != -1]
    mass = np.full(len(table), 1 / max(len(table), 1))
    return _content(table[:, 2:5], edges, mass, table[:, 5], names)


INTERCHANGE: dict[str, Callable[[bytes], Content]] = {
    ".ply": _ply,
    ".graphml": _graphml,
    ".swc": _swc,
}


def _content(nodes: Any, edges: Any, mass: Any, radius: Any, names: Any) -> Content:
    pairs = np.sort(np.asarray(edges, np.int64).reshape(-1, 2), axis=1)
    return {
        "nodes": np.array(nodes),
        "edges": pairs,
        "mass": np.array(mass),
        "radius": np.array(radius),
        "node_ids": np.asarray(names).astype(np.int64),
    }
