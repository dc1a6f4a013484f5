"""The stage medial, what the stages after it carry, and what the default pipeline makes of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

import mdcs_pipeline as mdcs
from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.messages import (
    Header,
    MassCloud,
    Nodes,
    PointCloud,
    RoughSkeleton,
    Surface,
    Thickness,
)
from mdcs_pipeline.stages.density import Density
from mdcs_pipeline.stages.medial import Medial
from mdcs_pipeline.stages.smooth import Smooth
from mdcs_pipeline.stages.surface import SurfaceGraph
from mdcs_pipeline.stages.thickness import LocalThickness
from mdcs_pipeline.stages.transport import Transport, carried_from

HEADER = Header("map", 5, 2)
R = 0.1


class Measured(NamedTuple):
    """A cloud on its way through the stages before `medial`."""

    cloud: MassCloud
    surface: Surface
    thickness: Thickness


def shell(count: int, seed: int, first: float = 0.0, last: float = 2 * np.pi) -> np.ndarray:
    """Return points on a cylinder of length 1 around x, open at both ends, between two angles."""
    rng = np.random.default_rng(seed)
    angle, x = rng.uniform(first, last, count), rng.uniform(0, 1, count)
    return np.stack([x, R * np.cos(angle), R * np.sin(angle)], axis=1)


def halves(seed: int) -> np.ndarray:
    """Return the upper and the lower part of a tube; the sides between them are missing."""
    parts = [shell(1500, seed + k, k * np.pi + 0.4, (k + 1) * np.pi - 0.4) for k in (0, 1)]
    return np.concatenate(parts)


def measured(points: np.ndarray) -> Measured:
    cloud = Density()(PointCloud(points, header=HEADER)).cloud
    surface = SurfaceGraph()(cloud).surface
    return Measured(cloud, surface, LocalThickness()(cloud, surface).thickness)


@pytest.fixture(scope="module")
def tube() -> Measured:
    return measured(shell(3000, 0))


def chain(cloud: MassCloud, places: np.ndarray) -> RoughSkeleton:
    """Return the nodes linked in the order in which they are given, where they are put."""
    stage = Transport(max_steps=0, marginals="free", epsilon=0.005)
    plan = stage(cloud, nodes_at(cloud, places)).plan
    count = np.arange(len(places))
    edges = np.stack([count[:-1], count[1:]], axis=1)
    return RoughSkeleton(plan, edges, np.ones(len(places), bool))


def nodes_at(cloud: MassCloud, places: np.ndarray) -> Nodes:
    return Nodes(places, mass=np.full(len(places), 1 / len(places)), header=cloud.header)


# --- the stage


def test_medial_gives_the_axis_and_the_radius_of_a_tube(tube: Measured) -> None:
    found = Medial()(*tube)
    centre = found.thickness.centre
    assert centre is not None
    points = tube.cloud.unit.from_unit(tube.cloud.positions)
    middle = np.abs(points[:, 0] - 0.5) < 0.3
    off = np.linalg.norm(tube.cloud.unit.from_unit(centre)[:, 1:], axis=1)[middle] / R
    assert np.quantile(off, 0.95) < 0.2
    radius = found.thickness.radius[middle] * tube.cloud.unit.length
    assert np.median(radius) == pytest.approx(R, rel=0.1)


def test_medial_leaves_confidence_and_places_of_the_surface_alone(tube: Measured) -> None:
    found = Medial()(*tube)
    np.testing.assert_array_equal(found.thickness.confidence, tube.thickness.confidence)
    np.testing.assert_array_equal(found.surface.positions, tube.surface.positions)
    # One tube has no gap to be cut.
    assert found.surface.graph.nnz > 0.99 * tube.surface.graph.nnz
    assert (found.surface.graph != found.surface.graph.T).nnz == 0


def test_medial_takes_links_off_and_adds_none(tube: Measured) -> None:
    cut = Medial(gap=1e-3)(*tube).surface.graph
    assert 0 < cut.nnz < tube.surface.graph.nnz
    assert (cut != cut.multiply(tube.surface.graph > 0)).nnz == 0


# --- what is carried


def test_the_surface_or_the_centres_are_carried(tube: Measured) -> None:
    thickness = Medial()(*tube).thickness
    assert carried_from(tube.cloud, thickness, "surface") is tube.cloud.positions
    assert carried_from(tube.cloud, None, "surface") is tube.cloud.positions
    assert carried_from(tube.cloud, thickness, "centre") is thickness.centre


def without_centre(thickness: Thickness) -> Thickness:
    return Thickness(thickness.radius, thickness.confidence)


@pytest.mark.parametrize("given", [True, False], ids=["without-centres", "none"])
def test_centres_that_are_not_there_are_asked_for(tube: Measured, given: bool) -> None:
    thickness = without_centre(tube.thickness) if given else None
    rough = chain(tube.cloud, tube.cloud.positions[:4])
    calls: list[Any] = [
        lambda: Transport(carried="centre")(tube.cloud, rough.plan.nodes, thickness),
        lambda: Smooth(carried="centre")(tube.cloud, rough, thickness),
    ]
    for call in calls:
        with pytest.raises(InputError, match="needs a thickness with centres") as caught:
            call()
        assert "medial" in caught.value.remedy
        assert "carried to surface" in caught.value.remedy


def test_a_node_goes_to_the_middle_of_what_is_carried(tube: Measured) -> None:
    """One node receives all mass, so that its place is the mean of where that comes from."""
    thickness = Medial()(*tube).thickness
    assert thickness.centre is not None
    start = nodes_at(tube.cloud, tube.cloud.positions[:1])
    even = Thickness(np.ones(len(tube.cloud)), thickness.confidence, thickness.centre + 3.0)
    stage = Transport(carried="centre", power=2, max_steps=200, settle=1e-9)
    found = stage(tube.cloud, start, even).plan.nodes.positions[0]
    np.testing.assert_allclose(found, tube.cloud.mass @ even.centre, atol=1e-4)


# --- the default pipeline


def shape_of(points: np.ndarray) -> tuple[int, int, int]:
    found = mdcs.skeletonize(points).summary()
    return found["components"], found["cycles"], found["leaves"]


@pytest.mark.parametrize("seed", range(2))
def test_two_half_shells_and_a_whole_tube_are_one_line(seed: int) -> None:
    assert shape_of(halves(seed)) == (1, 0, 2)
    assert shape_of(shell(3000, seed)) == (1, 0, 2)


def test_the_line_of_two_half_shells_is_their_common_axis() -> None:
    found = mdcs.skeletonize(halves(3))
    middle = np.abs(found.nodes[:, 0] - 0.5) < 0.3
    assert middle.sum() >= 3
    assert np.linalg.norm(found.nodes[middle, 1:], axis=1).max() < 0.25 * R


def test_the_default_pipeline_carries_from_the_stage_that_finds_centres() -> None:
    stages = load_spec("default", {}).stages
    for name in ("transport", "smooth"):
        assert stages[name].settings["carried"] == "centre"
    assert [ref.stage for ref in stages["transport"].inputs["thickness"]] == ["ridge"]


def test_belief_that_does_not_fade_is_refused():
    with pytest.raises(ValueError, match="unsure must be larger than sure"):
        Medial(sure=0.2, unsure=0.1)
