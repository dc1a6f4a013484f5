"""``mdcs warmup``: compile ahead of time."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from mdcs_pipeline.cli.compiling import kernels_cached
from mdcs_pipeline.cli.console import say


def warmup(
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
) -> None:
    """Compile the kernels, so that no later run waits for it."""
    import numpy as np

    from mdcs_pipeline.config import config_names
    from mdcs_pipeline.demo import demo_cloud
    from mdcs_pipeline.pipeline import skeletonize
    from mdcs_pipeline.stream import Stream

    began = time.perf_counter()
    fresh = not kernels_cached()
    points = demo_cloud(count=1500)
    for name in config_names():
        for kind in (np.float64, np.float32):
            skeletonize(points.astype(kind), name)
    # Kernels that only meet a scene which is there already. What one process compiles with
    # others compiling beside it may differ in its last digits: all is to be made here.
    stream = Stream.from_config("streaming", scene={"voxel_size": 0.02})
    order = np.argsort(points[:, 0])
    for part in np.array_split(order, 4):
        stream.push(points[part])
    if not quiet:
        what = "compiled" if fresh else "already compiled"
        say(f"kernels {what}, {time.perf_counter() - began:.1f} s")
