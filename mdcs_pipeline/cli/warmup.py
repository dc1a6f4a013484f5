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

    began = time.perf_counter()
    fresh = not kernels_cached()
    points = demo_cloud(count=1500)
    for name in config_names():
        for kind in (np.float64, np.float32):
            skeletonize(points.astype(kind), name)
    if not quiet:
        what = "compiled" if fresh else "already compiled"
        say(f"kernels {what}, {time.perf_counter() - began:.1f} s")
