"""Bends that the Dirichlet term counts: known curvatures, units that do not matter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import chain, rotation
from scipy import sparse

from mdcs_pipeline.kernels.bends import (
    bends_in_scatter,
    sideways_scatter,
    steps_in_radii,
    without,
)
from mdcs_pipeline.kernels.update import bending

SEEDS = st.integers(0, 10_000)


def arc(count: int, radius: float = 2.0) -> np.ndarray:
    """Nodes on half a circle."""
    angle = np.linspace(0.0, np.pi, count)
    return radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def energy(bends: sparse.csr_array, nodes: np.ndarray) -> float:
    return float(np.square(bends @ nodes).sum())


def of_arc(count: int, radius: float, thick: float, wide: float) -> float:
    """Return R of half a circle with w = `wide`, r = `thick` and mass spread evenly."""
    nodes, edges = arc(count, radius), chain(count)
    mass = np.full(count, 1.0 / count)
    bends = bends_in_scatter(nodes, edges, np.full(count, thick), mass, np.full(count, wide**2))
    return energy(bends, nodes)


@pytest.mark.parametrize("count", [20, 40, 160])
def test_an_arc_has_its_curvature_whatever_the_spacing(count):
    inner = (count - 2) / count  # ends have no bend
    wanted = inner * (0.3**2 / (2.0 * 0.5)) ** 2
    assert of_arc(count, 2.0, 0.5, 0.3) == pytest.approx(wanted, rel=0.01)


@given(factor=st.floats(0.01, 100.0))
@settings(max_examples=25, deadline=None)
def test_the_unit_of_length_does_not_matter(factor):
    assert of_arc(30, 2.0 * factor, 0.5 * factor, 0.3 * factor) == pytest.approx(
        of_arc(30, 2.0, 0.5, 0.3), rel=1e-9
    )


def test_what_lies_on_a_line_bends_for_nothing():
    assert of_arc(30, 2.0, 0.5, 0.0) == 0.0


def test_nodes_without_mass_are_smoothed_too():
    nodes, edges, ones = arc(9), chain(9), np.ones(9)
    mass = np.where(np.arange(9) == 4, 0.0, 1 / 8)
    found = bends_in_scatter(nodes, edges, ones, mass, ones).toarray()
    usual = bends_in_scatter(nodes, edges, ones, np.full(9, 1 / 8), ones).toarray()
    np.testing.assert_allclose(found[4], usual[4] * np.sqrt(0.1))
    np.testing.assert_allclose(np.delete(found, 4, 0), np.delete(usual, 4, 0))


@given(seed=SEEDS, count=st.integers(3, 12))
@settings(max_examples=25, deadline=None)
def test_rigid_motion_changes_no_bend(seed, count):
    rng = np.random.default_rng(seed)
    nodes, edges = rng.uniform(-1, 1, (count, 3)), chain(count)
    mass, scale, wide = rng.uniform(0.1, 1, (3, count))
    moved = nodes @ rotation(seed).T + 3.0
    here = bends_in_scatter(nodes, edges, scale, mass, wide)
    there = bends_in_scatter(moved, edges, scale, mass, wide)
    assert energy(here, nodes) == pytest.approx(energy(there, moved), rel=1e-9)


def plan_of(owner: np.ndarray, mass: np.ndarray, count: int) -> sparse.csr_array:
    """Return the plan that gives each point's mass to one node."""
    return sparse.csr_array((mass, owner, np.arange(len(owner) + 1)), shape=(len(owner), count))


def test_scatter_is_the_variance_across_the_curve():
    rng = np.random.default_rng(0)
    nodes = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=1)
    owner = np.repeat(np.arange(5), 20_000)
    spread = np.array([0.0, 0.1, 0.2, 0.3, 0.0])[owner]
    normal = rng.standard_normal((len(owner), 2))
    places = nodes[owner] + np.stack(
        [rng.uniform(-0.5, 0.5, len(owner)), spread * normal[:, 0], 0.5 * spread * normal[:, 1]],
        axis=1,
    )
    mass = np.full(len(owner), 1.0 / len(owner))
    for turn, shift in ((np.eye(3), 0.0), (rotation(3), 1e3)):
        found = sideways_scatter(
            plan_of(owner, mass, 5), places @ turn.T + shift, nodes @ turn.T + shift, chain(5)
        )
        wanted = 1.25 * np.array([0.0, 0.1, 0.2, 0.3, 0.0]) ** 2
        np.testing.assert_allclose(found, wanted, rtol=0.03, atol=1e-9)


def test_scatter_of_no_mass_is_zero_and_of_a_lone_node_all_around():
    places = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    plan = plan_of(np.zeros(4, np.int64), np.full(4, 0.25), 2)
    found = sideways_scatter(plan, places, np.zeros((2, 3)), np.empty((0, 2), np.int64))
    np.testing.assert_allclose(found, [1.0, 0.0], atol=1e-12)


def test_steps_are_in_radii_and_some_nodes_can_be_left_out():
    scale = np.array([1.0, 2.0, 4.0, 1.0])
    found = steps_in_radii(chain(4), scale)
    np.testing.assert_allclose(found.toarray(), bending(chain(4), 4).toarray() / scale[:, None])
    some = np.array([False, True, False, False])
    rows = np.abs(without(found, some).toarray()).sum(axis=1)
    np.testing.assert_array_equal(rows > 0, [False, False, True, False])
    assert without(found, np.zeros(4, dtype=bool)) is found
