"""Methods by name: each maps points (N, 3) to a `Result`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.topology import ablation, peers
from benchmarks.topology.peers import Result
from benchmarks.topology.solid import Floats

Method = Callable[[Floats], Result]

PEERS: dict[str, Method] = {
    "pygel": peers.pygel,
    "pygel-raw": partial(peers.pygel, finish=False),
    "pygel-ls": partial(peers.pygel, multiscale=False),
    "pygel-ls-raw": partial(peers.pygel, multiscale=False, finish=False),
    "pc-skeletor": peers.pc_skeletor,
    "pc-skeletor-pruned": partial(peers.pc_skeletor, prune=True),
}


def mdcs(points: Floats, config: str) -> Result:
    """Run this project's own method with a configuration by name or path."""
    import mdcs_pipeline

    made = mdcs_pipeline.skeletonize(points, config=config)
    return Result(np.asarray(made.nodes), np.asarray(made.edges), np.asarray(made.radius))


def method(name: str) -> Method:
    """Return the method called `name`: ``mdcs:CONFIG``, ``mdcs:without-STAGE`` or a peer.

    Raises
    ------
    ValueError
        If there is no such method.
    """
    if name.startswith("mdcs:without-"):
        return partial(mdcs, config=ablation.without(name.removeprefix("mdcs:without-")))
    if name.startswith("mdcs:"):
        return partial(mdcs, config=name.removeprefix("mdcs:"))
    if name in PEERS:
        return PEERS[name]
    raise ValueError(
        f"method must be mdcs:CONFIG, mdcs:without-STAGE or one of {sorted(PEERS)}, got {name!r}"
    )
