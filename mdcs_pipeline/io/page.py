"""HTML: one page, with everything in it, that turns the skeleton in a browser."""

from __future__ import annotations

import math
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray
from mdcs_pipeline.errors import MissingExtraError
from mdcs_pipeline.io.scene import (
    CLOUD_COLOUR,
    LINE_COLOUR,
    Scene,
    make_scene,
    relative_mass,
    view_axes,
)

if TYPE_CHECKING:
    from mdcs_pipeline.skeleton import Skeleton

# Fractions of the box's diagonal: a line of a fixed pixel width would vanish in the cloud.
_LINE_WIDTH = 0.008
_NODE_SIZE = 0.02
_POINT_SIZE = 0.003
_DISTANCE = 1.0
# Through a thin cloud the skeleton inside it shows.
_CLOUD_OPACITY = 0.4


def html_bytes(skeleton: Skeleton, cloud: FloatArray | None = None) -> bytes:
    """Return a page that needs no network.

    Parameters
    ----------
    skeleton : Skeleton
        Lines and nodes in input units; nodes sized and coloured by mass.
    cloud : (N, 3) float, optional
        Drawn behind it; a fixed sample of it above 50,000 points.

    Raises
    ------
    MissingExtraError
        If k3d is not installed.
    """
    try:
        import k3d
    except ImportError as error:
        raise MissingExtraError(
            "an HTML page needs k3d",
            received=str(error),
            remedy="pip install 'mdcs-pipeline[draw]'",
        ) from error

    scene = make_scene(skeleton.nodes, cloud)
    offset = page_offset(scene)
    labels = [
        f"{name} − {shift:.15g}" if shift else name
        for name, shift in zip("xyz", offset.tolist(), strict=True)
    ]
    plot = k3d.plot(axes=labels, camera_auto_fit=False, grid_visible=False)
    plot.camera = _camera(scene, offset)
    parts = _parts(k3d, skeleton, scene, offset)
    try:
        for part in parts:
            plot += part
        # "full" holds the viewer itself; the other kinds load it from a server.
        plot.snapshot_type = "full"
        page: str = plot.get_snapshot()
    finally:
        for widget in (*parts, plot):
            _forget(widget)
    return page.encode("utf-8")


def _forget(widget: Any) -> None:
    """Take a widget and its layout out of the process's registry, where they would stay.

    The plot's own `close` does something else, so the one of the base class is called.
    """
    close = import_module("ipywidgets").Widget.close
    for item in (getattr(widget, "layout", None), widget):
        if item is not None:
            close(item)


def page_offset(scene: Scene) -> NDArray[np.float64]:
    """Return what the page takes off all coordinates: zeros unless the cloud is far away.

    The browser counts in float32, with 7 digits: a map position of 1e6 would leave a cloud
    of a metre a grid of 6 cm. The offset is round, so that its labels can be read.
    """
    if np.abs(scene.centre).max() < 1000 * scene.size:
        return np.zeros(3)
    step = 10.0 ** math.floor(math.log10(scene.size))
    offset: NDArray[np.float64] = np.round(scene.centre / step) * step
    return offset


def _camera(scene: Scene, offset: NDArray[np.float64]) -> list[float]:
    """Return position, target and upright axis of a camera that sees all of the scene."""
    right, away, up = view_axes(scene.cloud if len(scene.cloud) else scene.nodes)
    target = scene.centre - offset
    direction = 0.3 * right + 0.4 * up - away
    position = target + direction / np.linalg.norm(direction) * scene.size * _DISTANCE
    camera: list[float] = np.concatenate([position, target, up]).tolist()
    return camera


def _parts(k3d: Any, skeleton: Skeleton, scene: Scene, offset: NDArray[np.float64]) -> list[Any]:
    parts = []
    shift = scene.centre - offset
    nodes = (scene.nodes + shift).astype(np.float32)
    if len(scene.cloud):
        parts.append(
            k3d.points(
                (scene.cloud + shift).astype(np.float32),
                point_size=_POINT_SIZE * scene.size,
                opacity=_CLOUD_OPACITY,
                color=_number(CLOUD_COLOUR),
                shader="flat",
                name="cloud",
            )
        )
    if len(skeleton.edges):
        parts.append(
            k3d.lines(
                nodes,
                skeleton.edges.astype(np.uint32),
                indices_type="segment",
                shader="mesh",
                width=_LINE_WIDTH * scene.size,
                color=_number(LINE_COLOUR),
                name="skeleton",
            )
        )
    if len(nodes):
        share = relative_mass(skeleton.mass)
        parts.append(
            k3d.points(
                nodes,
                point_sizes=(_NODE_SIZE * scene.size * (0.5 + 0.5 * share)).astype(np.float32),
                attribute=skeleton.mass.astype(np.float32),
                color_map=k3d.colormaps.matplotlib_color_maps.Viridis,
                color_range=[0.0, float(skeleton.mass.max()) or 1.0],
                shader="mesh",
                name="nodes, coloured by mass",
            )
        )
    return parts


def _number(colour: str) -> int:
    return int(colour.removeprefix("#"), 16)
