"""The result: a curve skeleton with mass and radius at its nodes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import IntArray, finite_array, index_pairs, masses
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.header import Header

if TYPE_CHECKING:
    import networkx as nx


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A curve skeleton in the user's units and frame.

    Parameters
    ----------
    nodes : (K, 3) float64
        Positions.
    edges : (E, 2) int64
        Pairs i < j of node indices.
    mass : (K,) float64
        Mass that the transport plan carries to each node, sum 1.
    radius : (K,) float64
        Mean distance of the transported mass from the node, in input units.
    node_ids : (K,) int64
        Names of the nodes, unique.
    assignment : (N,) int64, optional
        Index of the node that each input point gives most of its mass to.
    header : Header
        Of the cloud that it was made from.
    diagnostics : dict
        Counts, rounds and errors of the run that made it.
    """

    nodes: NDArray[np.float64]
    edges: IntArray
    mass: NDArray[np.float64]
    radius: NDArray[np.float64]
    node_ids: IntArray
    assignment: IntArray | None = None
    header: Header = field(default_factory=Header)
    diagnostics: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        nodes = finite_array(self.nodes, (None, 3), "nodes")
        count = len(nodes)
        radius = finite_array(self.radius, (count,), "radius")
        ids = finite_array(self.node_ids, (count,), "node_ids", np.int64)
        if count and radius.min() < 0:
            raise InputError("radius must not be negative", received=f"minimum {radius.min()}")
        if len(np.unique(ids)) != count:
            raise InputError("node_ids must be unique", received=ids.tolist())
        values: dict[str, object] = {
            "nodes": nodes,
            "edges": index_pairs(self.edges, count),
            "mass": masses(self.mass, count),
            "radius": radius,
            "node_ids": ids,
        }
        if self.assignment is not None:
            assignment = finite_array(self.assignment, (None,), "assignment", np.int64)
            if len(assignment) and (assignment.min() < 0 or assignment.max() >= count):
                raise InputError(f"assignment must name nodes 0 to {count - 1}")
            values["assignment"] = assignment
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.nodes)

    def _count_pieces(self) -> int:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        ones = np.ones(len(self.edges))
        graph = coo_array((ones, (self.edges[:, 0], self.edges[:, 1])), shape=(len(self),) * 2)
        return int(connected_components(graph, directed=False)[0]) if len(self) else 0

    def summary(self) -> dict[str, Any]:
        """Return the counts that describe the topology.

        Returns
        -------
        dict
            ``nodes``, ``edges``, ``components``, ``cycles`` (independent loops),
            ``leaves`` (nodes of degree 1) and ``junctions`` (degree over 2).
        """
        degree = np.bincount(self.edges.ravel(), minlength=len(self))
        pieces = self._count_pieces()
        return {
            "nodes": len(self),
            "edges": len(self.edges),
            "components": pieces,
            "cycles": len(self.edges) - len(self) + pieces,
            "leaves": int(np.count_nonzero(degree == 1)),
            "junctions": int(np.count_nonzero(degree > 2)),
        }

    def to_networkx(self) -> nx.Graph[int]:
        """Return a networkx graph with ``position``, ``mass`` and ``radius`` at its nodes.

        Nodes are named by `node_ids`; edges carry their ``length`` in input units, and the
        graph ``frame_id``, ``stamp_ns`` and ``seq`` of the header.
        """
        import networkx as nx

        header = self.header
        graph: nx.Graph[int] = nx.Graph(
            frame_id=header.frame_id, stamp_ns=header.stamp_ns, seq=header.seq
        )
        for name, position, mass, radius in zip(
            self.node_ids.tolist(), self.nodes, self.mass, self.radius, strict=True
        ):
            graph.add_node(
                name,
                position=tuple(position.tolist()),
                mass=float(mass),
                radius=float(radius),
            )
        for i, j in self.edges:
            length = float(np.linalg.norm(self.nodes[i] - self.nodes[j]))
            graph.add_edge(int(self.node_ids[i]), int(self.node_ids[j]), length=length)
        return graph

    def to_lineset(self, tensor: bool = False) -> Any:
        """Return the skeleton as lines of Open3D, in memory of their own.

        Parameters
        ----------
        tensor : bool
            For an `open3d.t.geometry.LineSet`, whose points carry ``mass`` and ``radius``;
            otherwise an `open3d.geometry.LineSet`.

        Raises
        ------
        MissingExtraError
            Without the extra open3d or open3d-cpu.
        """
        from mdcs_pipeline.io.open3d_bridge import line_set, tensor_line_set

        if tensor:
            values = {"mass": self.mass, "radius": self.radius}
            return tensor_line_set(self.nodes, self.edges, **values)
        return line_set(self.nodes, self.edges)

    def save(self, path: str | Path) -> None:
        """Write the skeleton in the format that the suffix of `path` names.

        Parameters
        ----------
        path : str or Path
            ``.json``, ``.ply``, ``.graphml``, ``.npz``, ``.swc``, ``.png`` or ``.html``.

        Raises
        ------
        OutputError
            If the suffix is unknown or the file cannot be written; then no file is left.
        """
        from mdcs_pipeline.io.write import write_skeleton

        write_skeleton(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Skeleton:
        """Read a skeleton back from the file that `save` wrote.

        Parameters
        ----------
        path : str or Path
            ``.json`` or ``.npz`` for all of it. ``.graphml``, ``.ply`` and ``.swc`` hold
            no assignment and no diagnostics; the last two no header and no names of nodes,
            and SWC no mass, so that every node gets the same.

        Raises
        ------
        InputError
            If there is no such file, or it is no skeleton, damaged, or of a later format.
        """
        from mdcs_pipeline.io.record import load_skeleton

        held = load_skeleton(path)
        names = ("nodes", "edges", "mass", "radius", "node_ids", "assignment", "diagnostics")
        try:
            header = Header(**held["header"])
            return cls(header=header, **{name: held[name] for name in names})
        except (InputError, TypeError) as error:
            fault = error if isinstance(error, InputError) else InputError(f"header: {error}")
            raise fault.located(str(path)) from error
