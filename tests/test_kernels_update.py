"""Algorithm 2: gradients against differences, an energy that never rises, the Dirichlet term."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import chain, cost, random_mass, rotation
from scipy import sparse

from mdcs_pipeline.kernels.bends import steps_in_radii
from mdcs_pipeline.kernels.energy import bending_energy, transport_energy
from mdcs_pipeline.kernels.optimise import Descent, optimise
from mdcs_pipeline.kernels.problem import Accuracy, Problem
from mdcs_pipeline.kernels.sinkhorn import solve, solve_free
from mdcs_pipeline.kernels.update import Pull, bending, pull, relaxed_step

TIGHT = Accuracy(tolerance=1e-9, cut=1e-13, max_passes=20_000)
SEEDS = st.integers(0, 10_000)
THETAS = st.floats(0.05, 1.0)
LAMBDAS = st.sampled_from([0.0, 0.1, 0.3, 0.9])


def problem(
    seed: int, n: int = 40, m: int = 7, epsilon: float = 0.05, scaled: bool = True
) -> Problem:
    rng = np.random.default_rng(seed)
    scales = (
        (rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, m)) if scaled else (np.ones(n), np.ones(m))
    )
    return Problem(
        rng.uniform(0, 1, (n, 3)), random_mass(rng, n), rng.uniform(0, 1, (m, 3)),
        random_mass(rng, m), epsilon, *scales,
    )  # fmt: skip


def tree(m: int) -> np.ndarray:
    """A chain with one branch from its middle."""
    edges = chain(m - 1)
    return np.concatenate([edges, [[m // 2, m - 1]]])


def dense_plan(seed: int) -> tuple[Problem, sparse.csr_array]:
    made = problem(seed)
    return made, solve(made, np.zeros(len(made.nodes)), Accuracy()).plan


def numerical_gradient(function, nodes: np.ndarray, step: float = 1e-5) -> np.ndarray:
    gradient = np.zeros_like(nodes)
    for at in np.ndindex(nodes.shape):
        up, down = nodes.copy(), nodes.copy()
        up[at] += step
        down[at] -= step
        gradient[at] = (function(up) - function(down)) / (2 * step)
    return gradient


def objective(made: Problem, plan: sparse.csr_array, smoothing, weight: float, power: int):
    """(1 − λ) Σ π_ij c_ij + λ R(X) at a fixed plan, c the p-th power of ‖x − y‖/√(r_i r_j)."""
    dense = plan.toarray()

    def value(nodes: np.ndarray) -> float:
        square = cost(made.points, nodes, made.point_scale, made.node_scale)
        paid = float((dense * square ** (power / 2)).sum())
        return (1 - weight) * paid + weight * float(np.square(smoothing @ nodes).sum())

    return value


# ---------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("weight", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("seed", range(3))
def test_the_gradient_is_zero_where_a_full_step_leads(seed, weight):
    made, plan = dense_plan(seed)
    smoothing = bending(tree(7), 7)
    pulled = pull(plan, made.points, made.nodes, 2, (made.point_scale, made.node_scale))
    best = relaxed_step(made.nodes, pulled, smoothing, weight, 1.0)
    value = objective(made, plan, smoothing, weight, 2)
    np.testing.assert_allclose(numerical_gradient(value, best), 0.0, atol=1e-8)
    # And there only: a little beside it is not zero.
    assert np.abs(numerical_gradient(value, best + 0.01)).max() > 1e-5


@pytest.mark.parametrize("weight", [0.0, 0.3, 0.9])
def test_the_step_is_minus_half_the_inverse_matrix_times_the_gradient(weight):
    made, plan = dense_plan(1)
    smoothing = bending(tree(7), 7)
    pulled = pull(plan, made.points, made.nodes, 2, (made.point_scale, made.node_scale))
    matrix = (1 - weight) * np.diag(pulled.total) + weight * (smoothing.T @ smoothing).toarray()
    gradient = numerical_gradient(objective(made, plan, smoothing, weight, 2), made.nodes)
    for step in (1.0, 0.1):
        moved = relaxed_step(made.nodes, pulled, smoothing, weight, step)
        wanted = -0.5 * step * np.linalg.solve(matrix, gradient)
        np.testing.assert_allclose(moved - made.nodes, wanted, atol=1e-8)


@pytest.mark.parametrize("weight", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_equation_12_has_the_gradient_of_the_sum_of_distances(seed, weight):
    """For p = 1: Σ π (x − y)/‖x − y‖ and the Dirichlet term, in the form the update uses."""
    made, plan = dense_plan(seed)
    smoothing = bending(tree(7), 7)
    pulled = pull(plan, made.points, made.nodes, 1, (made.point_scale, made.node_scale))
    analytic = 2 * (1 - weight) * (pulled.total[:, None] * made.nodes - pulled.weighted)
    analytic += 2 * weight * (smoothing.T @ (smoothing @ made.nodes))
    value = objective(made, plan, smoothing, weight, 1)
    np.testing.assert_allclose(analytic, numerical_gradient(value, made.nodes, 1e-6), atol=1e-8)


@pytest.mark.parametrize("power", [1, 2])
def test_the_pull_is_the_weighted_sum_over_points(power):
    made, plan = dense_plan(2)
    pulled = pull(plan, made.points, made.nodes, power, (made.point_scale, made.node_scale))
    product = made.point_scale[:, None] * made.node_scale
    weights = plan.toarray() / product
    if power == 1:
        distance = np.linalg.norm(made.points[:, None] - made.nodes, axis=2)
        weights = 0.5 * plan.toarray() / (distance * np.sqrt(product))
    np.testing.assert_allclose(pulled.total, weights.sum(axis=0))
    np.testing.assert_allclose(pulled.weighted, weights.T @ made.points)


def test_a_node_on_top_of_a_point_is_not_held_there_for_ever():
    """The guard of the zero distance: the weight is large but finite, and the median is right."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [9, 0, 0]])
    plan = sparse.csr_array(np.full((5, 1), 0.2))
    nodes, ones = points[:1].copy(), (np.ones(5), np.ones(1))
    pulled = pull(plan, points, nodes, 1, ones)
    assert np.isfinite(pulled.total).all()
    # From beside it Weiszfeld's steps go to the median, 2, where the mean would be 3.
    nodes = nodes + 0.1
    for _ in range(300):
        nodes = relaxed_step(nodes, pull(plan, points, nodes, 1, ones), None, 0.0, 1.0)
    np.testing.assert_allclose(nodes, [[2.0, 0, 0]], atol=1e-3)


def test_a_node_that_nothing_pulls_stays():
    nodes = np.arange(6.0).reshape(2, 3)
    pulled = Pull(np.array([0.5, 0.0]), np.array([[1.0, 1.0, 1.0], [0, 0, 0]]))
    moved = relaxed_step(nodes, pulled, None, 0.0, 1.0)
    np.testing.assert_array_equal(moved, [[2.0, 2.0, 2.0], nodes[1]])
    np.testing.assert_array_equal(nodes, np.arange(6.0).reshape(2, 3))


def test_a_node_that_neither_mass_nor_an_edge_pulls_stays_with_smoothing_on():
    """The system has an empty row then; without smoothing such a node already stayed."""
    rng = np.random.default_rng(0)
    nodes = rng.uniform(0, 1, (4, 3))
    pulled = Pull(np.array([0.5, 0.3, 0.2, 0.0]), rng.uniform(0, 1, (4, 3)))
    pulled.weighted[3] = 0.0
    moved = relaxed_step(nodes, pulled, bending(chain(3), 4), 0.3, 1.0)
    np.testing.assert_allclose(moved[3], nodes[3])
    alone = relaxed_step(
        nodes[:3], Pull(pulled.total[:3], pulled.weighted[:3]), bending(chain(3), 3), 0.3, 1.0
    )
    np.testing.assert_allclose(moved[:3], alone)


# ------------------------------------------------------------------- energy that never rises


def rises(energy: tuple[float, ...]) -> float:
    return float(np.max(np.diff(energy), initial=-np.inf))


@given(seed=SEEDS, theta=THETAS, weight=LAMBDAS, scaled=st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_energy_of_algorithm_2_never_rises(seed, theta, weight, scaled):
    made = problem(seed, epsilon=0.08, scaled=scaled)
    descent = Descent(power=2, step=theta, max_steps=8, settle=-1.0, smoothing=weight)
    bends = steps_in_radii(tree(7), made.node_scale)
    found = optimise(made, np.zeros(7), TIGHT, descent, bends)
    assert len(found.energy) == 9
    assert rises(found.energy) <= 1e-8
    # The last one is the energy of what is returned.
    last = (1 - weight) * transport_energy(found.written())
    last += weight * bending_energy(bends, found.problem.nodes)
    assert found.energy[-1] == pytest.approx(last)


@given(seed=SEEDS, theta=THETAS)
@settings(max_examples=20, deadline=None)
def test_the_energy_never_rises_with_free_masses(seed, theta):
    descent = Descent(power=2, step=theta, max_steps=8, settle=-1.0, free=True)
    found = optimise(problem(seed), np.zeros(7), TIGHT, descent)
    assert rises(found.energy) <= 1e-9


@given(seed=SEEDS, theta=THETAS, weight=LAMBDAS, power=st.sampled_from([1, 2]))
@settings(max_examples=40, deadline=None)
def test_a_relaxed_step_never_raises_the_objective_at_the_fixed_plan(seed, theta, weight, power):
    made, plan = dense_plan(seed % 20)
    nodes = np.random.default_rng(seed).uniform(-0.2, 1.2, (7, 3))
    smoothing = bending(tree(7), 7)
    value = objective(made, plan, smoothing, weight, power)
    for _ in range(5):
        pulled = pull(plan, made.points, nodes, power, (made.point_scale, made.node_scale))
        moved = relaxed_step(nodes, pulled, smoothing, weight, theta)
        assert value(moved) <= value(nodes) + 1e-12
        nodes = moved


# --------------------------------------------------------------------------------- the loop


def test_the_loop_ends_when_the_energy_settles_or_the_steps_run_out():
    made = problem(0)
    found = optimise(made, np.zeros(7), TIGHT, Descent(step=0.5, max_steps=200, settle=1e-3))
    assert found.settled
    assert 2 < len(found.energy) < 201
    gains = -np.diff(found.energy)
    assert gains[-1] < 1e-3 * made.epsilon
    assert (gains[:-1] >= 1e-3 * made.epsilon).all()
    short = optimise(made, np.zeros(7), TIGHT, Descent(step=0.5, max_steps=1, settle=1e-3))
    assert not short.settled
    assert len(short.energy) == 2


def test_no_steps_only_solve_the_plan():
    made = problem(1)
    found = optimise(made, np.zeros(7), TIGHT, Descent(max_steps=0))
    alone = solve(made, np.zeros(7), TIGHT)
    np.testing.assert_array_equal(found.problem.nodes, made.nodes)
    np.testing.assert_array_equal(found.written().plan.data, alone.plan.data)
    assert found.coupling.passes == alone.passes
    assert not found.settled


@pytest.mark.parametrize("free", [False, True])
def test_the_plan_returned_is_that_of_the_nodes_returned(free):
    made = problem(2)
    found = optimise(made, np.zeros(7), TIGHT, Descent(step=0.3, max_steps=4, free=free))
    transport = solve_free if free else solve
    again = transport(found.problem, found.coupling.node_potentials, TIGHT)
    np.testing.assert_allclose(again.plan.toarray(), found.written().plan.toarray(), atol=1e-8)
    assert found.coupling.passes >= len(found.energy)


def test_the_fixed_point_of_full_steps_is_the_barycentre_of_each_nodes_mass():
    made = problem(3, scaled=False)
    found = optimise(made, np.zeros(7), TIGHT, Descent(step=1.0, max_steps=500, settle=1e-10))
    plan = found.written().plan.toarray()
    centres = plan.T @ made.points / plan.sum(axis=0)[:, None]
    np.testing.assert_allclose(found.problem.nodes, centres, atol=1e-3)


def test_smoothing_without_a_graph_changes_nothing():
    made = problem(4)
    plain = optimise(made, np.zeros(7), TIGHT, Descent(max_steps=2))
    without = optimise(made, np.zeros(7), TIGHT, Descent(max_steps=2, smoothing=0.5))
    np.testing.assert_array_equal(plain.problem.nodes, without.problem.nodes)


def test_smoothing_straightens_a_chain():
    rng = np.random.default_rng(0)
    line = np.linspace([0.0, 0, 0], [1, 0, 0], 9)
    points = np.repeat(line, 20, axis=0) + 0.05 * rng.standard_normal((180, 3))
    made = Problem(
        points, np.full(180, 1 / 180), line + 0.05 * rng.standard_normal((9, 3)),
        np.full(9, 1 / 9), 0.005, np.ones(180), np.ones(9),
    )  # fmt: skip
    bent = []
    for weight in (0.0, 0.3, 0.9):
        descent = Descent(step=1.0, max_steps=30, settle=1e-6, smoothing=weight)
        nodes = optimise(made, np.zeros(9), TIGHT, descent, bending(chain(9), 9)).problem.nodes
        bent.append(bending_energy(bending(chain(9), 9), nodes))
    assert bent[0] > bent[1] > bent[2]


# --------------------------------------------------------------------------------- bending


def test_bending_takes_each_inner_node_from_the_mean_of_its_neighbours():
    edges = tree(8)
    nodes = np.random.default_rng(0).uniform(0, 1, (8, 3))
    found = bending(edges, 8) @ nodes
    for i in range(8):
        near = [b if a == i else a for a, b in edges.tolist() if i in (a, b)]
        wanted = nodes[i] - nodes[near].mean(axis=0) if len(near) > 1 else np.zeros(3)
        np.testing.assert_allclose(found[i], wanted, atol=1e-15)


def test_rows_of_ends_and_of_lone_nodes_are_zero():
    rows = np.abs(bending(tree(7), 9).toarray()).sum(axis=1)
    np.testing.assert_array_equal(rows == 0, [True, *4 * [False], *4 * [True]])
    assert bending(np.empty((0, 2), np.int64), 3).nnz == 0


@given(seed=SEEDS, count=st.integers(3, 12))
@settings(max_examples=25, deadline=None)
def test_an_even_straight_chain_has_no_energy_and_rotation_changes_none(seed, count):
    rng = np.random.default_rng(seed)
    start, step = rng.uniform(-1, 1, (2, 3))
    straight = start + np.arange(count)[:, None] * step
    smoothing = bending(chain(count), count)
    assert bending_energy(smoothing, straight) <= 1e-24
    bent = straight + rng.standard_normal((count, 3))
    turned = bent @ rotation(seed).T + 3.0
    energy = bending_energy(smoothing, bent)
    assert energy > 1e-6
    assert bending_energy(smoothing, turned) == pytest.approx(energy, rel=1e-9)
