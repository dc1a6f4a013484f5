"""PNG: three views of a skeleton in its cloud, drawn without a screen."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray
from mdcs_pipeline.errors import MissingExtraError
from mdcs_pipeline.io.scene import (
    CLOUD_COLOUR,
    LINE_COLOUR,
    NODE_COLOUR,
    make_scene,
    relative_mass,
    view_axes,
)

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

_INCHES = (15.0, 6.0)
_DPI = 100
# Elevation and turn in degrees: face on, turned about the upright axis, from above.
_VIEWS = ((0.0, 0.0), (12.0, 65.0), (55.0, 20.0))
# Room about the shape, as a fraction of a panel: half a thick node must still fit.
_MARGIN = 0.05


def png_bytes(skeleton: Skeleton, cloud: FloatArray | None = None) -> bytes:
    """Return a picture of 1500 x 600 pixels: three parallel projections of one scale.

    Parameters
    ----------
    skeleton : Skeleton
    cloud : (N, 3) float, optional
        Drawn behind it; a fixed sample of it above 50,000 points.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError(
            "a PNG picture needs matplotlib",
            received=str(error),
            remedy="pip install 'mdcs-pipeline[draw]'",
        ) from error

    scene = make_scene(skeleton.nodes, cloud)
    axes = view_axes(scene.cloud if len(scene.cloud) else scene.nodes)
    views = [_turned(axes, *angles) for angles in _VIEWS]
    scale = _common_scale(np.concatenate([scene.cloud, scene.nodes]), views)
    # Not by pyplot: its state is the whole process's, and its backend may want a screen.
    figure = Figure(figsize=_INCHES, dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    for column, view in enumerate(views):
        panel = figure.add_axes((column / 3, 0.0, 1 / 3, 1.0))
        panel.set_axis_off()
        _draw(panel, view, scale, scene.cloud, scene.nodes, skeleton)
    stream = io.BytesIO()
    canvas.print_figure(stream, format="png", dpi=_DPI)
    return stream.getvalue()


def _turned(axes: NDArray[np.float64], elevation: float, turn: float) -> NDArray[np.float64]:
    """Return the rows right and up of a view, turned about the upright axis, then raised."""
    raised, turned = np.deg2rad(elevation), np.deg2rad(turn)
    right, away, up = axes
    aside = np.cos(turned) * right + np.sin(turned) * away
    ahead = np.cos(turned) * away - np.sin(turned) * right
    above: NDArray[np.float64] = np.cos(raised) * up + np.sin(raised) * ahead
    return np.array([aside, above])


def _extent(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the middle and the spans of (N, 2) points."""
    if not len(points):
        return np.zeros(2), np.zeros(2)
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, high - low


def _common_scale(points: NDArray[np.float64], views: list[NDArray[np.float64]]) -> float:
    """Return the input units an inch with which every view fits into its panel."""
    panel = np.array([_INCHES[0] / len(views), _INCHES[1]]) * (1 - 2 * _MARGIN)
    scales = [float((_extent(points @ view.T)[1] / panel).max()) for view in views]
    return max(scales) or 1.0


def _draw(
    panel: Any,
    view: NDArray[np.float64],
    scale: float,
    cloud: NDArray[np.float64],
    nodes: NDArray[np.float64],
    skeleton: Skeleton,
) -> None:
    from matplotlib.collections import LineCollection

    points, flat = cloud @ view.T, nodes @ view.T
    middle, _ = _extent(np.concatenate([points, flat]))
    half = np.array([_INCHES[0] / len(_VIEWS), _INCHES[1]]) * scale / 2
    panel.set_xlim(middle[0] - half[0], middle[0] + half[0])
    panel.set_ylim(middle[1] - half[1], middle[1] + half[1])
    # The skeleton over the whole cloud, for it lies inside and would be hidden.
    panel.scatter(*points.T, s=1.5, c=CLOUD_COLOUR, linewidths=0, zorder=1)
    panel.add_collection(
        LineCollection(
            list(flat[skeleton.edges]),
            colors=LINE_COLOUR,
            linewidths=3.0,
            capstyle="round",
            zorder=2,
        ),
        autolim=False,
    )
    sizes = 6.0 + 50.0 * relative_mass(skeleton.mass)
    panel.scatter(*flat.T, s=sizes, c=NODE_COLOUR, linewidths=0, zorder=3)
