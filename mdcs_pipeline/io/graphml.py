"""GraphML, for graph tools."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton


def graphml_bytes(skeleton: Skeleton) -> bytes:
    """Return GraphML with x, y, z, mass and radius at the nodes and length at the edges.

    Nodes are named by `node_ids`; the header's fields are attributes of the graph.
    """
    import networkx as nx

    header = skeleton.header
    # XML cannot hold control characters, whatever their escape.
    frame = header.frame_id if header.frame_id.isprintable() else json.dumps(header.frame_id)
    graph: nx.Graph[int] = nx.Graph(frame_id=frame, stamp_ns=header.stamp_ns, seq=header.seq)
    names = skeleton.node_ids.tolist()
    columns = np.column_stack([skeleton.nodes, skeleton.mass, skeleton.radius]).tolist()
    for name, (x, y, z, mass, radius) in zip(names, columns, strict=True):
        graph.add_node(name, x=x, y=y, z=z, mass=mass, radius=radius)
    for i, j in skeleton.edges.tolist():
        length = float(np.linalg.norm(skeleton.nodes[i] - skeleton.nodes[j]))
        graph.add_edge(names[i], names[j], length=length)
    stream = io.BytesIO()
    nx.write_graphml(graph, stream)
    return stream.getvalue()
