"""Streams: local updates, modes, time, poses, changes, checkpoints."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import frames
import numpy as np
import pytest
import shapes

from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import ConfigError, InputError, StageError
from mdcs_pipeline.graph import build_graph
from mdcs_pipeline.messages import Skeleton
from mdcs_pipeline.scene.change import SceneChange
from mdcs_pipeline.stream import Stream


def stream(**settings: Any) -> Stream:
    return Stream.from_config(**{**frames.SETTINGS, **settings})


def run(clouds: Iterable[np.ndarray], **settings: Any) -> Stream:
    made = stream(**settings)
    for number, cloud in enumerate(clouds):
        made.push(cloud, stamp_ns=number + 1, frame_id="map")
    made.flush()
    return made


def same(one: Skeleton, other: Skeleton) -> bool:
    names = ("nodes", "edges", "mass", "radius", "node_ids")
    return all(np.array_equal(getattr(one, n), getattr(other, n)) for n in names)


def places(skeleton: Skeleton) -> dict[int, tuple[float, ...]]:
    return dict(zip(skeleton.node_ids.tolist(), map(tuple, skeleton.nodes.tolist()), strict=True))


@pytest.fixture(scope="module")
def orbit() -> list[np.ndarray]:
    return frames.orbit()


@pytest.fixture(scope="module")
def finished(orbit: list[np.ndarray]) -> Skeleton:
    return run(orbit).skeleton()


# --- what comes of frames


def test_an_orbit_gives_the_shape(finished: Skeleton) -> None:
    summary = finished.summary()
    assert (summary["components"], summary["cycles"], summary["leaves"]) == (1, 0, 3)
    tips = np.array([limb.end for limb in shapes.Y_LIMBS])
    gap = np.linalg.norm(finished.nodes[:, None] - tips, axis=2).min(axis=0)
    assert gap.max() < 0.15
    assert finished.header.frame_id == "map"


def test_mass_is_the_surface_that_a_node_stands_for() -> None:
    """An even rod: mass goes with the length of rod around each node."""
    skeleton = run([frames.rod(0, 4, 20_000)]).skeleton()
    assert np.isclose(skeleton.mass.sum(), 1.0)
    order = np.argsort(skeleton.nodes[:, 0])
    x = skeleton.nodes[order, 0]
    borders = np.concatenate([[0.0], (x[1:] + x[:-1]) / 2, [4.0]])
    expected = np.diff(borders) / 4.0
    assert np.abs(skeleton.mass[order] - expected).sum() < 0.1


def test_a_ring_that_closes_over_frames_keeps_its_loop() -> None:
    """A spanning tree over frames could hold none."""
    ring = shapes.torus(40_000)
    turn = np.arctan2(ring[:, 1], ring[:, 0]) % (2 * np.pi)
    parts = [ring[(turn >= a) & (turn < a + 1.3)] for a in np.linspace(0, 2 * np.pi - 1.0, 7)]
    found = run(parts, **{"scene.voxel_size": 0.08}).skeleton().summary()
    assert (found["components"], found["cycles"], found["leaves"]) == (1, 1, 0)


def test_the_same_frames_give_the_same_bits(orbit: list[np.ndarray], finished: Skeleton) -> None:
    assert same(run(orbit).skeleton(), finished)


def test_changes_alone_give_the_whole_skeleton(orbit: list[np.ndarray]) -> None:
    made = stream()
    held: dict[int, tuple[float, ...]] = {}
    edges: set[tuple[int, ...]] = set()
    changes = [made.push(c, stamp_ns=k + 1) for k, c in enumerate(orbit)]
    for change in [*changes, *made.flush()]:
        apply(change, held, edges)
    whole = made.skeleton()
    assert held == places(whole)
    names = np.sort(whole.node_ids[whole.edges], axis=1)
    assert edges == set(map(tuple, names.tolist()))
    assert sum(len(c.moved) for c in changes) > 0
    assert sum(len(c.removed) for c in changes) > 0


def apply(
    change: SceneChange, held: dict[int, tuple[float, ...]], edges: set[tuple[int, ...]]
) -> None:
    for pair in map(tuple, change.parted.tolist()):
        edges.remove(pair)
    for name in change.removed.tolist():
        del held[name]
    assert not set(change.added.tolist()) & held.keys()
    assert set(change.moved.tolist()) <= held.keys()
    names = change.added.tolist() + change.moved.tolist()
    held.update(zip(names, map(tuple, change.positions.tolist()), strict=True))
    for pair in map(tuple, change.joined.tolist()):
        assert pair not in edges
        edges.add(pair)


def test_far_from_a_change_nothing_moves_by_a_bit() -> None:
    made = stream()
    for k in range(6):
        made.push(frames.rod(k, k + 1.3, seed=k), stamp_ns=k + 1)
        made.flush()
    before = places(made.skeleton())
    far = {name for name, place in before.items() if place[0] < 4.0}
    change = made.push(frames.rod(6, 7.3, seed=9), stamp_ns=9)
    after = places(made.skeleton())
    assert len(change.added)
    assert len(far) > 10
    assert {name: after.get(name) for name in far} == {name: before[name] for name in far}
    touched = set(change.added.tolist()) | set(change.moved.tolist()) | set(change.removed.tolist())
    assert not far & touched
    assert change.figures["active"] < change.figures["nodes"] / 2


@pytest.mark.parametrize("mode", ["accumulate", "window", "replace"])
def test_every_voxel_belongs_to_a_node_that_stands(orbit: list[np.ndarray], mode: str) -> None:
    """A node that is in sight in part only once lost the voxels that were not: its name stayed
    on them when it went, and a later frame failed over it. A single update does not show this.
    """
    made = stream(**{"scene.mode": mode, "scene.window_frames": 3, "scene.most": 700})
    walk = [frames.rod(0.7 * k, 0.7 * k + 1.5, seed=k) for k in range(6)]
    for k, cloud in enumerate([*orbit, *walk]):
        made.push(cloud, stamp_ns=k + 1)
        assert made.scene.world is not None
        voxels, graph = made.scene.world.voxels, made.scene.world.graph
        owned = np.flatnonzero(voxels.owner >= 0)
        assert set(voxels.owner[owned].tolist()) <= graph.nodes.keys()
        cells = [n.cells[voxels.owner[n.cells] == name] for name, n in graph.nodes.items()]
        listed = np.concatenate(cells)
        np.testing.assert_array_equal(np.sort(listed), owned)
        for name, node in graph.nodes.items():
            assert all(name in graph.nodes[other].links for other in node.links)
            assert all(name in graph.nodes[other].near for other in node.near), name


def test_seeing_the_same_again_changes_nothing(orbit: list[np.ndarray]) -> None:
    made = run(orbit)
    before = made.skeleton()
    for k, cloud in enumerate(orbit):
        assert not len(made.push(cloud, stamp_ns=100 + k, frame_id="map"))
    after = made.skeleton()
    np.testing.assert_array_equal(after.nodes, before.nodes)
    np.testing.assert_array_equal(after.node_ids, before.node_ids)


def test_a_rod_that_two_frames_bridge_becomes_one() -> None:
    """Pieces that turn out to be one are joined; the far ends stay."""
    made = run([frames.rod(0, 1), frames.rod(2, 3, seed=1)])
    assert made.skeleton().summary()["components"] == 2
    made.push(frames.rod(0.8, 2.2, seed=2), stamp_ns=10, frame_id="map")
    made.flush()
    summary = made.skeleton().summary()
    assert (summary["components"], summary["leaves"]) == (1, 2)


def test_a_speck_waits_for_more() -> None:
    made = run([frames.rod(0, 2)])
    before = len(made.skeleton())
    speck = np.random.default_rng(0).normal([1.0, 2.0, 0.0], 0.03, (40, 3))
    made.push(speck, stamp_ns=10, frame_id="map")
    made.flush()
    assert len(made.skeleton()) == before


def test_a_frame_looks_only_at_what_it_adds_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """What waits elsewhere was gone through in every frame: time grew with the scene."""
    made = stream(**{"scene.share": 0.9})
    for k in range(8):
        made.push(frames.rod(k, k + 1.3, seed=k), stamp_ns=k + 1)
    assert made.scene.world is not None
    asked: list[int] = []
    voxels = type(made.scene.world.voxels)
    nearest = voxels.nearest_owner

    def counted(self: Any, slots: np.ndarray, reach: int) -> np.ndarray:
        asked.append(len(slots))
        return nearest(self, slots, reach)

    monkeypatch.setattr(voxels, "nearest_owner", counted)
    assert sum(map(len, made.scene.waiting.values())) > 40
    made.push(frames.rod(7, 8.3, 60, seed=99), stamp_ns=99)
    assert sum(asked) <= 60


def test_large_updates_are_done_in_parts() -> None:
    made = stream(**{"scene.most": 300})
    change = made.push(frames.rod(0, 4, 12_000), stamp_ns=1)
    assert change.figures["waiting"] > 0
    assert change.figures["points"] <= 900
    made.flush()
    summary = made.skeleton().summary()
    assert (summary["components"], summary["leaves"]) == (1, 2)


# --- modes


def test_a_window_forgets() -> None:
    made = stream(**{"scene.mode": "window", "scene.window_frames": 3})
    sizes = []
    for k in range(12):
        made.push(frames.rod(0.5 * k, 0.5 * k + 1.2, seed=k), stamp_ns=k + 1)
        assert made.scene.world is not None
        sizes.append(len(made.scene.world.voxels))
    made.flush()
    assert max(sizes[6:]) < 1.2 * max(sizes[3:6])
    skeleton = made.skeleton()
    assert skeleton.nodes[:, 0].min() > 4.0
    assert skeleton.summary()["components"] == 1
    assert len(made.scene.hits) == 3


def test_a_window_by_seconds_goes_by_the_stamps() -> None:
    made = stream(**{"scene.mode": "window", "scene.window_seconds": 1.0})
    for k in range(6):
        made.push(frames.rod(k, k + 1.2, seed=k), stamp_ns=(k + 1) * 400_000_000)
    assert [number for number, _, _ in made.scene.hits] == [3, 4, 5]


def test_a_window_without_a_length_is_refused() -> None:
    with pytest.raises(ConfigError, match="window_frames or window_seconds"):
        stream(**{"scene.mode": "window"})


@pytest.mark.parametrize("most", [6000, 300])
def test_replacing_follows_what_moves(most: int) -> None:
    """However much one frame may update: in parts, a scene was made up of different moments."""
    made = stream(**{"scene.mode": "replace", "scene.most": most})
    survived = []
    for k in range(6):
        before = set(made.skeleton().node_ids.tolist())
        made.push(shapes.y(8000, k) + np.array([0.06 * k, 0, 0]), stamp_ns=k + 1)
        after = made.skeleton()
        survived.append(len(before & set(after.node_ids.tolist())) / max(len(before), 1))
    summary = after.summary()
    assert (summary["components"], summary["cycles"], summary["leaves"]) == (1, 0, 3)
    junction = after.nodes[np.argmax(np.bincount(after.edges.ravel()))]
    assert np.linalg.norm(junction - [0.3, 0, 0]) < 0.15
    assert np.mean(survived[2:]) > 0.5


# --- time, frames, poses, and frames that are none


def test_older_and_equal_stamps_are_dropped_and_counted(orbit: list[np.ndarray]) -> None:
    made = stream()
    made.push(orbit[0], stamp_ns=5)
    before = made.skeleton()
    late = made.push(orbit[1], stamp_ns=4)
    again = made.push(orbit[0], stamp_ns=5)
    assert "older" in late.figures["dropped"]
    assert "already" in again.figures["dropped"]
    assert not len(late) and not len(again)
    assert same(made.skeleton(), before)
    assert made.counts == {"received": 3, "used": 1, "dropped": 2}
    assert sum(made.dropped.values()) == 2


def test_older_frames_are_refused_where_that_is_set(orbit: list[np.ndarray]) -> None:
    made = stream(**{"scene.older": "refuse"})
    made.push(orbit[0], stamp_ns=5)
    with pytest.raises(InputError, match="older than the last") as caught:
        made.push(orbit[1], stamp_ns=4)
    assert caught.value.remedy
    assert made.push(orbit[1], stamp_ns=6).scene == 0
    assert made.counts == {"received": 3, "used": 2, "dropped": 1}


def test_another_frame_id_begins_a_new_scene(orbit: list[np.ndarray]) -> None:
    made = stream()
    made.push(orbit[0], stamp_ns=5, frame_id="map")
    change = made.push(orbit[1], stamp_ns=1, frame_id="odom")
    assert change.scene == 1
    assert not len(change.removed)
    alone = stream()
    alone.push(orbit[1], stamp_ns=1, frame_id="odom")
    assert same(made.skeleton(), alone.skeleton())


def test_a_reset_begins_a_new_scene(orbit: list[np.ndarray]) -> None:
    made = run(orbit[:3])
    made.reset()
    assert not len(made.skeleton())
    made.push(orbit[3], stamp_ns=1)
    assert made.scene.number == 1
    assert made.skeleton().node_ids.min() == 0


@pytest.mark.parametrize(
    ("bad", "what"),
    [
        (np.empty((0, 3)), "empty"),
        (np.full((9, 3), np.nan), "empty"),
        (np.zeros((4, 2)), "shape"),
        (np.array([["a"]]), "real numbers"),
        (np.full((5, 3), 1e9), "beyond the reach"),
    ],
)
def test_frames_that_are_none_leave_the_scene_alone(
    bad: np.ndarray, what: str, orbit: list[np.ndarray]
) -> None:
    made = run(orbit[:2])
    before = made.skeleton()
    with pytest.raises(InputError, match=what):
        made.push(bad, stamp_ns=50, frame_id="map")
    lenient = Stream(made.graph, unusable="drop")
    lenient.push(orbit[0], stamp_ns=1)
    change = lenient.push(bad, stamp_ns=2)
    assert what in change.figures["dropped"]
    assert lenient.counts == {"received": 2, "used": 1, "dropped": 1}
    assert same(made.skeleton(), before)
    made.push(orbit[2], stamp_ns=50, frame_id="map")
    assert made.counts == {"received": 4, "used": 3, "dropped": 1}


def test_points_with_nan_among_them_are_used(orbit: list[np.ndarray]) -> None:
    holed = np.concatenate([orbit[0], np.full((50, 3), np.nan)])
    kept = holed.copy()
    one, other = stream(), stream()
    one.push(holed, stamp_ns=1)
    other.push(orbit[0], stamp_ns=1)
    assert same(one.skeleton(), other.skeleton())
    np.testing.assert_array_equal(holed, kept)


def test_poses_take_points_into_the_scene(orbit: list[np.ndarray]) -> None:
    """Round-off aside, a posed frame is the frame."""
    turn = shapes.turned(2)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, [3.0, -2.0, 1.0]
    made, plain = stream(), stream()
    for k, cloud in enumerate(orbit[:3]):
        seen = (cloud - pose[:3, 3]) @ turn
        made.push(seen, stamp_ns=k + 1, pose=pose)
        plain.push(cloud, stamp_ns=k + 1)
    assert made.skeleton().summary() == plain.skeleton().summary()
    np.testing.assert_allclose(made.skeleton().nodes, plain.skeleton().nodes, atol=1e-6)


@pytest.mark.parametrize("fault", ["scaled", "mirrored", "shape", "nan", "row"])
def test_poses_that_are_none_are_refused(fault: str, orbit: list[np.ndarray]) -> None:
    pose: Any = np.eye(4)
    if fault == "scaled":
        pose[0, 0] = 1.1
    elif fault == "mirrored":
        pose[0, 0] = -1.0
    elif fault == "shape":
        pose = np.eye(3)
    elif fault == "nan":
        pose[0, 3] = np.nan
    else:
        pose[3, 0] = 0.5
    made = stream()
    with pytest.raises(InputError, match="pose"):
        made.push(orbit[0], stamp_ns=1, pose=pose)
    assert made.scene.world is None


def test_a_configuration_without_a_scene_is_refused() -> None:
    with pytest.raises(ConfigError, match="keeps no scene") as caught:
        Stream(build_graph(load_spec("default", {})))
    assert "streaming" in str(caught.value.remedy)


def test_a_stage_that_fails_loses_no_frame(
    orbit: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The map has the frame; what it changed is worked on with the next."""
    made = stream()
    made.push(orbit[0], stamp_ns=1)
    stage = type(made.graph.stages["link"])
    whole = stage.__call__

    def broken(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(stage, "__call__", broken)
    with pytest.raises(StageError):
        made.push(orbit[4], stamp_ns=2)
    monkeypatch.setattr(stage, "__call__", whole)
    made.push(orbit[5], stamp_ns=3)
    made.flush()
    whole_y = made.skeleton().summary()
    assert (whole_y["components"], whole_y["cycles"], whole_y["leaves"]) == (1, 0, 3)


# --- checkpoints


@pytest.mark.parametrize("mode", ["accumulate", "window"])
def test_a_resumed_run_ends_alike(orbit: list[np.ndarray], tmp_path: Path, mode: str) -> None:
    extra = {"scene.mode": mode, "scene.window_frames": 4}
    whole = run(orbit, **extra)
    for stop in (1, 4, 7):
        first = stream(**extra)
        for k in range(stop):
            first.push(orbit[k], stamp_ns=k + 1, frame_id="map")
        first.save(tmp_path / "scene.ckpt", {"place": stop})
        second = stream(**extra)
        assert second.restore(tmp_path / "scene.ckpt") == {"place": stop}
        for k in range(stop, len(orbit)):
            second.push(orbit[k], stamp_ns=k + 1, frame_id="map")
        second.flush()
        assert same(second.skeleton(), whole.skeleton())
        assert second.counts == whole.counts


def test_an_empty_stream_can_be_saved(tmp_path: Path, orbit: list[np.ndarray]) -> None:
    stream().save(tmp_path / "scene.ckpt")
    made = stream()
    made.restore(tmp_path / "scene.ckpt")
    made.push(orbit[0], stamp_ns=1)
    other = stream()
    other.push(orbit[0], stamp_ns=1)
    assert same(made.skeleton(), other.skeleton())


def test_damaged_checkpoints_are_refused(tmp_path: Path, orbit: list[np.ndarray]) -> None:
    path = tmp_path / "scene.ckpt"
    made = run(orbit[:2])
    made.save(path)
    whole = path.read_bytes()
    before = made.skeleton()
    rng = np.random.default_rng(0)
    for _ in range(30):
        data = bytearray(whole)
        at = int(rng.integers(len(data)))
        data[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(data))
        with pytest.raises(InputError) as caught:
            made.restore(path)
        assert caught.value.remedy
        assert str(path) in str(caught.value)
    for size in (0, 5, 11, 12, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError):
            made.restore(path)
    assert same(made.skeleton(), before)


def test_foreign_checkpoints_are_refused(tmp_path: Path, orbit: list[np.ndarray]) -> None:
    path = tmp_path / "scene.ckpt"
    run(orbit[:2]).save(path)
    with pytest.raises(InputError, match="another pipeline or other settings"):
        stream(**{"merge.spacing": 1.1}).restore(path)
    np.save(tmp_path / "cloud.npy", orbit[0])
    with pytest.raises(InputError, match="no checkpoint"):
        stream().restore(tmp_path / "cloud.npy")
    with pytest.raises(InputError, match="cannot be read"):
        stream().restore(tmp_path / "none.ckpt")
