"""Loops compiled by numba; everything else in `kernels` is plain numpy."""

from pathlib import Path

from numba import config

from mdcs_pipeline.kernels.cache import drop_stale

# Before any of them is loaded: what was compiled of an older version must not be.
drop_stale(Path(__file__).parent, config.CACHE_DIR)  # type: ignore[attr-defined]
