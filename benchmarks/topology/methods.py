"""Methods by name: each maps points (N, 3) to a `Result`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import yaml

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


def mdcs(points: Floats, config: str, settings: dict[str, Any] | None = None) -> Result:
    """Run this project's own method with a configuration by name or path, and other settings."""
    import mdcs_pipeline

    made = mdcs_pipeline.skeletonize(points, config=config, **(settings or {}))
    return Result(np.asarray(made.nodes), np.asarray(made.edges), np.asarray(made.radius))


def method(name: str) -> Method:
    """Return the method called `name`: ``mdcs:CONFIG``, ``mdcs:without-STAGE`` or a peer.

    Settings of a configuration follow it as ``+STAGE.SETTING=VALUE``.

    Raises
    ------
    ValueError
        If there is no such method.
    """
    if name.startswith("mdcs:without-"):
        return partial(mdcs, config=ablation.without(name.removeprefix("mdcs:without-")))
    if name.startswith("mdcs:"):
        config, *changes = name.removeprefix("mdcs:").split("+")
        pairs = (change.partition("=")[::2] for change in changes)
        settings = {setting: yaml.safe_load(value) for setting, value in pairs}
        return partial(mdcs, config=config, settings=settings)
    if name in PEERS:
        return PEERS[name]
    raise ValueError(
        f"method must be mdcs:CONFIG, mdcs:without-STAGE or one of {sorted(PEERS)}, got {name!r}"
    )
