"""A frame as things in viser's scene."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import FloatArray
from mdcs_pipeline.io.scene import CLOUD_COLOUR, make_scene, view_axes
from mdcs_pipeline.skeleton import Skeleton
from mdcs_pipeline.viewer.branches import branch_labels
from mdcs_pipeline.viewer.colours import JUNCTION, Colours, by_label, by_value
from mdcs_pipeline.viewer.film import Frame
from mdcs_pipeline.viewer.tubes import Copies, Mesh, ball_copies, tube_copies, unit_ball, unit_tube

Colouring = Literal["mass", "branch", "radius"]
COLOURINGS: tuple[Colouring, ...] = ("mass", "branch", "radius")

# The page's own unit: viser's camera sees from 0.01 to 1000, whatever the cloud's unit is.
SIZE = 10.0
_FIELD = np.deg2rad(45.0)
_DISTANCE = 1.25
# A scene that has outgrown the page gets room to grow on, so that the view seldom steps back.
_ROOM = 1.25
# Up to so many points are drawn in the size that was asked for.
_FEW = 6000
# Seen a little from the side and from above, as on the HTML page.
_ASIDE, _ABOVE = 0.3, 0.4


@dataclass(frozen=True)
class Look:
    """How a frame is drawn.

    Parameters
    ----------
    colouring : {"mass", "branch", "radius"}
    tube, point : float
        Radius of a tube and size of a point, in percent of the scene's size.
    cloud, tubes : bool
        What is drawn at all.
    """

    colouring: Colouring = "mass"
    tube: float = 0.6
    point: float = 0.15
    cloud: bool = True
    tubes: bool = True


@dataclass(frozen=True)
class Space:
    """The similarity from input units to the page's, and how to look at it.

    Fixed by the first frame, so that those that follow stand where they belong.
    """

    centre: NDArray[np.float64]
    scale: float
    axes: NDArray[np.float64]

    def to_page(self, points: FloatArray) -> NDArray[np.float64]:
        """Map (N, 3) points of the input into the page."""
        mapped: NDArray[np.float64] = (np.asarray(points, np.float64) - self.centre) * self.scale
        return mapped


def space_of(frame: Frame) -> Space | None:
    """Return the space in which a frame fills the page; None if there is nothing in it."""
    scene = make_scene(*_shape(frame))
    both = np.concatenate([scene.cloud, scene.nodes])
    if not len(both):
        return None
    axes = view_axes(scene.cloud if len(scene.cloud) else scene.nodes)
    return Space(scene.centre, SIZE / scene.size, axes)


class View(NamedTuple):
    """Where one who looks at the page stands, in its units.

    Attributes
    ----------
    centre, position, up : (3,) float64
        What is looked at, from where, and with which way up.
    size : float
        Diameter of what can be seen about the centre.
    """

    centre: NDArray[np.float64]
    position: NDArray[np.float64]
    up: NDArray[np.float64]
    size: float


def view_of(centre: NDArray[np.float64], size: float, axes: NDArray[np.float64]) -> View:
    """Return the view in which `size` about `centre` fills the page, with axes of `view_axes`."""
    right, away, up = axes
    way = _ASIDE * right + _ABOVE * up - away
    return View(centre, centre + way / np.linalg.norm(way) * size * _DISTANCE, up, size)


def colours_of(skeleton: Skeleton, colouring: Colouring) -> tuple[Colours, Colours]:
    """Return (K, 3) colours of the nodes and (E, 2, 3) colours of both halves of the edges."""
    edges = skeleton.edges
    if colouring == "branch":
        whole = by_label(branch_labels(edges, len(skeleton)))
        nodes = np.tile(JUNCTION, (len(skeleton), 1))
        degree = np.bincount(edges.ravel(), minlength=len(skeleton))
        nodes[edges.ravel()] = np.repeat(whole, 2, axis=0)
        nodes[degree > 2] = JUNCTION
        return nodes, np.stack([whole, whole], axis=1)
    nodes = by_value(skeleton.mass if colouring == "mass" else skeleton.radius)
    return nodes, nodes[edges]


def ball_radii(skeleton: Skeleton, tube: float) -> NDArray[np.float64]:
    """Return the radius of each node's ball: as wide as the tube, wider with more mass.

    By the cube root, so that volumes compare as masses do.
    """
    mass = skeleton.mass
    largest = mass.max(initial=0.0)
    share = np.cbrt(mass / largest) if largest > 0 else np.zeros(len(mass))
    radii: NDArray[np.float64] = tube * (1.02 + 0.6 * share)
    return radii


def point_size(count: int, percent: float, size: float = SIZE) -> float:
    """Return how large each of `count` points is drawn where so much is seen, in the page's unit.

    Many are drawn smaller, so that they cover no more of what lies inside than few do.
    """
    return percent / 100 * size * math.sqrt(_FEW / max(count, _FEW))


class Drawing:
    """Puts frames into the scene of a viser server, one in the place of the other."""

    def __init__(self, server: Any) -> None:
        self._server = server
        # No reflections: they wash out the colours, which mean something here.
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_light_ambient("/light", intensity=1.6)
        self._meshes = (unit_tube(), unit_ball())
        self._space: Space | None = None
        self._view: View | None = None

    @property
    def _size(self) -> float:
        return SIZE if self._view is None else self._view.size

    def draw(self, frame: Frame, look: Look) -> None:
        """Show `frame` instead of what was there."""
        if self._space is None:
            self.fit(frame)
        space = self._space
        if space is None:
            return
        with self._server.atomic():
            self._draw_cloud(frame.points if look.cloud else None, space, look)
            self._draw_skeleton(frame.skeleton if look.tubes else None, space, look)

    def fit(self, frame: Frame) -> None:
        """Let `frame` fill the page, for who looks already and for who comes later."""
        space = space_of(frame)
        if space is None:
            return
        self._space = space
        self._look_from(view_of(np.zeros(3), SIZE, space.axes), self._server.get_clients().values())

    def widen(self, frame: Frame) -> None:
        """Let those see all of `frame` who look from where they were put, if it is too large.

        Who has turned or come nearer stays there, and all things stand where they stood.
        """
        if self._space is None or self._view is None:
            return
        scene = make_scene(*_shape(frame))
        centre, size = self._space.to_page(scene.centre[None])[0], scene.size * self._space.scale
        if size + 2 * float(np.linalg.norm(centre - self._view.centre)) <= self._view.size:
            return
        place = self._view.position
        clients = self._server.get_clients().values()
        still = [c for c in clients if np.allclose(c.camera.position, place, atol=1e-3 * SIZE)]
        axes = view_axes(scene.cloud if len(scene.cloud) else scene.nodes)
        self._look_from(view_of(centre, _ROOM * size, axes), still)

    def _look_from(self, view: View, clients: Iterable[Any]) -> None:
        """Put `clients` there, and who comes later."""
        self._view = view
        scene, first = self._server.scene, self._server.initial_camera
        scene.set_up_direction(tuple(view.up))
        first.fov, first.position, first.look_at = _FIELD, view.position, view.centre
        for client in clients:
            with client.atomic():
                client.camera.up_direction = view.up
                client.camera.position = view.position
                client.camera.look_at = view.centre

    def _draw_cloud(self, points: FloatArray | None, space: Space, look: Look) -> None:
        held = np.empty((0, 3)) if points is None else space.to_page(points)
        self._server.scene.add_point_cloud(
            "/cloud",
            held.astype(np.float32),
            _rgb(CLOUD_COLOUR),
            point_size=point_size(len(held), look.point, self._size),
            point_shape="circle",
            point_shading="flat",
            precision="float32",
            visible=bool(len(held)),
        )

    def _draw_skeleton(self, skeleton: Skeleton | None, space: Space, look: Look) -> None:
        tube, ball = self._meshes
        if skeleton is None:
            for name in ("/skeleton/edges", "/skeleton/nodes"):
                self._remove(name)
            return
        nodes = space.to_page(skeleton.nodes)
        of_nodes, of_edges = colours_of(skeleton, look.colouring)
        radius = look.tube / 100 * self._size
        self._add("/skeleton/edges", tube, tube_copies(nodes, skeleton.edges, of_edges, radius))
        balls = ball_copies(nodes, of_nodes, ball_radii(skeleton, radius))
        self._add("/skeleton/nodes", ball, balls)

    def _add(self, name: str, mesh: Mesh, copies: Copies) -> None:
        if not len(copies.positions):
            self._remove(name)
            return
        self._server.scene.add_batched_meshes_simple(
            name,
            mesh.vertices,
            mesh.faces,
            copies.turns,
            copies.positions,
            batched_scales=copies.scales,
            batched_colors=copies.colours,
            # Coarser copies from afar would show as notches in thin tubes.
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _remove(self, name: str) -> None:
        handle = self._server.scene.get_handle_by_name(name)
        if handle is not None:
            handle.remove()


def _shape(frame: Frame) -> tuple[NDArray[np.float64], FloatArray | None]:
    nodes = np.empty((0, 3)) if frame.skeleton is None else frame.skeleton.nodes
    return nodes, frame.points


def _rgb(colour: str) -> tuple[int, int, int]:
    number = int(colour.removeprefix("#"), 16)
    return number >> 16, number >> 8 & 255, number & 255
