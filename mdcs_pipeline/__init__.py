"""Mass-driven curve skeletons of point clouds, as composable stages wired by YAML."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mdcs_pipeline.errors import (
        ConfigError,
        InputError,
        MdcsError,
        MissingExtraError,
        OutputError,
        StageError,
    )
    from mdcs_pipeline.header import Header
    from mdcs_pipeline.measures import Measures, measure
    from mdcs_pipeline.messages import PointCloud
    from mdcs_pipeline.pipeline import Pipeline, skeletonize
    from mdcs_pipeline.skeleton import Skeleton
    from mdcs_pipeline.stream import Stream

    __version__: str

__all__ = [
    "ConfigError",
    "Header",
    "InputError",
    "MdcsError",
    "Measures",
    "MissingExtraError",
    "OutputError",
    "Pipeline",
    "PointCloud",
    "Skeleton",
    "StageError",
    "Stream",
    "__version__",
    "measure",
    "skeletonize",
]

_HOMES = {
    "Header": "header",
    "Measures": "measures",
    "Pipeline": "pipeline",
    "PointCloud": "messages",
    "measure": "measures",
    "Skeleton": "skeleton",
    "Stream": "stream",
    "skeletonize": "pipeline",
}


def __getattr__(name: str) -> Any:
    # Found at first use, so that the import alone loads neither compiler nor graph library.
    if name == "__version__":
        from importlib.metadata import version

        return version("mdcs-pipeline")
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    home = importlib.import_module(f"{__name__}.{_HOMES.get(name, 'errors')}")
    return getattr(home, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
