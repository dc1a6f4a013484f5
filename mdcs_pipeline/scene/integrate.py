"""A frame into the scene's map."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.header import Header
from mdcs_pipeline.kernels.canonical import canonical_frame
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.scene.state import Scene, World
from mdcs_pipeline.scene.voxels import NOBODY


class FrameRule(NamedTuple):
    """How frames add up.

    Parameters
    ----------
    voxel : float
        Edge of a voxel in unit lengths.
    voxel_size : float or None
        The same in input units; given, it fixes the unit.
    mode : {"accumulate", "window", "replace"}
    window_frames : int or None
    window_seconds : float or None
    least_hits : int
        Points from which a voxel is surface.
    patience : int
        Frames within which they must come.
    shift : float
        Distance, in voxels, from which a moved centroid is a change.
    """

    voxel: float = 0.016
    voxel_size: float | None = None
    mode: Literal["accumulate", "window", "replace"] = "accumulate"
    window_frames: int | None = None
    window_seconds: float | None = None
    least_hits: int = 3
    patience: int = 5
    shift: float = 0.35


def refusal(scene: Scene, header: Header) -> str | None:
    """Return why a frame is too late for the scene, or None."""
    if scene.frame_id is None or header.frame_id != scene.frame_id:
        return None
    if header.stamp_ns == scene.stamp_ns:
        return "a frame of this stamp was there already"
    if header.stamp_ns < scene.stamp_ns:
        return "the frame is older than the last one"
    return None


def add_frame(scene: Scene, cloud: PointCloud, rule: FrameRule) -> None:
    """Add a frame; one in another coordinate frame begins a new scene.

    Parameters
    ----------
    scene : Scene
        Changed, unless an error is raised.
    cloud : PointCloud
        In the scene's frame, in input units.
    rule : FrameRule

    Raises
    ------
    InputError
        If points lie beyond the reach of the map.
    """
    header = cloud.header
    if scene.frame_id is not None and header.frame_id != scene.frame_id:
        scene.begin_anew()
    world = scene.world or _begin(cloud, rule)
    points = world.unit.to_unit(cloud.positions)
    number = scene.frames
    if rule.mode == "replace":
        world.voxels.check_reach(points)
        world.voxels.empty()
    least = rule.least_hits if number else _least_at_first(points, rule)
    touched, fresh, moved = world.voxels.add(points, number, least, rule.patience, rule.shift)
    scene.world = world
    scene.frames = number + 1
    scene.frame_id, scene.stamp_ns = header.frame_id, header.stamp_ns
    scene.changed = np.concatenate([scene.changed, fresh, moved])
    if rule.mode != "accumulate":
        scene.hits.append((number, header.stamp_ns, touched))
        _forget(scene, world, _expired(scene, rule))


def _least_at_first(points: NDArray[np.float64], rule: FrameRule) -> int:
    """Return the points from which a voxel of a scene's first frame is surface.

    Where most of its points are in voxels that hold fewer than `least_hits`, the frame is too
    sparse to tell noise from surface by them, and there is nothing else to go by yet.
    """
    cells = np.floor(points / rule.voxel).astype(np.int64)
    _, held = np.unique(cells, axis=0, return_counts=True)
    firm = held[held >= rule.least_hits].sum()
    return rule.least_hits if 2 * firm >= len(points) else 1


def _begin(cloud: PointCloud, rule: FrameRule) -> World:
    frame = canonical_frame(cloud.positions, cloud.weights)
    if rule.voxel_size is not None:
        return World.begin(frame.centre, rule.voxel_size / rule.voxel, rule.voxel)
    size = float(np.abs(cloud.positions).max())
    # A first frame without extent has no scale to give: any will do until a voxel is asked for.
    length = frame.length if frame.length > 1e-12 * size else max(size, 1.0)
    return World.begin(frame.centre, length, rule.voxel)


def _expired(scene: Scene, rule: FrameRule) -> list[tuple[int, IntArray]]:
    """Return number and hits of the frames that the mode has no room for any more."""
    frames, seconds = rule.window_frames, rule.window_seconds
    if rule.mode == "replace":
        frames, seconds = 1, None
    gone = []
    while len(scene.hits) > 1:
        number, stamp, slots = scene.hits[0]
        many = frames is not None and len(scene.hits) > frames
        old = seconds is not None and stamp < scene.stamp_ns - round(seconds * 1e9)
        if not (many or old):
            break
        scene.hits.popleft()
        gone.append((number, slots))
    return gone


def _forget(scene: Scene, world: World, gone: list[tuple[int, IntArray]]) -> None:
    """Drop the voxels that no frame since has hit."""
    for number, slots in gone:
        lost: NDArray[np.int64] = slots[world.voxels.seen[slots] == number]
        owners = np.unique(world.voxels.owner[lost])
        scene.vacated.update(owners[owners != NOBODY].tolist())
        world.voxels.drop(lost)
