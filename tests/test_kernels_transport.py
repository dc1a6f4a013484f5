"""The entropic plan: closed forms, another solver's answers, marginals, warm starts, the cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from problems import (
    Transport,
    cost,
    independent,
    planted,
    random_mass,
    torus,
    two_by_two,
)
from scipy import sparse
from scipy.special import softmax

from mdcs_pipeline.kernels import sinkhorn
from mdcs_pipeline.kernels.anderson import AndersonMixer
from mdcs_pipeline.kernels.blocks import BOX, filled, in_cells, listed, plan_of, slack_of
from mdcs_pipeline.kernels.compiled.balance import sinkhorn_pass
from mdcs_pipeline.kernels.compiled.boxes import box_bounds, box_order
from mdcs_pipeline.kernels.compiled.exponential import vector_exp
from mdcs_pipeline.kernels.compiled.shares import top_shares
from mdcs_pipeline.kernels.energy import distances, mean_distance, transport_energy
from mdcs_pipeline.kernels.problem import Accuracy, Problem, Solution
from mdcs_pipeline.kernels.sinkhorn import couple, couple_free, solve, solve_free

TIGHT = Accuracy(tolerance=1e-8, cut=1e-12, max_passes=5000)


def problem_of(made: Transport) -> Problem:
    return Problem(*made[:7])


def cold(problem: Problem, accuracy: Accuracy = TIGHT) -> Solution:
    return solve(problem, np.zeros(len(problem.nodes)), accuracy)


def variation(one, other) -> float:
    dense = [p.toarray() if sparse.issparse(p) else p for p in (one, other)]
    return 0.5 * float(np.abs(dense[0] - dense[1]).sum())


def costs(problem: Problem) -> np.ndarray:
    return cost(problem.points, problem.nodes, problem.point_scale, problem.node_scale)


def balanced(seed: int, n: int, m: int, epsilon: float, scaled: bool) -> Problem:
    """Random points and masses, nodes among the points: no answer is planted."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (n, 3))
    nodes = points[rng.choice(n, m, replace=False)]
    scales = (
        (rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, m)) if scaled else (np.ones(n), np.ones(m))
    )
    return Problem(points, random_mass(rng, n), nodes, random_mass(rng, m), epsilon, *scales)


# ------------------------------------------------------------------ another solver's answers


@pytest.mark.parametrize("scaled", [False, True], ids=["plain", "thickness"])
@pytest.mark.parametrize("epsilon", [0.005, 0.02, 0.1, 1.0])
def test_the_plan_is_that_of_pot(epsilon, scaled):
    ot = pytest.importorskip("ot")
    problem = balanced(3, 150, 15, epsilon, scaled)
    other = ot.sinkhorn(
        problem.mass, problem.target, costs(problem), epsilon,
        method="sinkhorn_log", numItermax=20_000, stopThr=TIGHT.tolerance, warn=True,
    )  # fmt: skip
    plan = cold(problem)
    assert plan.converged
    assert variation(plan.plan, other) <= 1e-4
    # Warm: from the potentials of nodes that stood a little elsewhere.
    moved = problem._replace(nodes=problem.nodes + 0.01)
    warm = solve(problem, cold(moved).node_potentials, TIGHT)
    assert variation(warm.plan, other) <= 1e-4


def test_a_problem_with_a_starved_node_and_far_flow_is_that_of_pot():
    ot = pytest.importorskip("ot")
    problem = balanced(5, 80, 8, 0.05, False)
    nodes = problem.nodes.copy()
    nodes[0] += 3.0
    problem = problem._replace(nodes=nodes)
    other = ot.sinkhorn(
        problem.mass, problem.target, costs(problem), 0.05,
        method="sinkhorn_log", numItermax=50_000, stopThr=1e-8,
    )  # fmt: skip
    assert variation(cold(problem).plan, other) <= 1e-4


# ------------------------------------------------------------------------------ closed forms


@pytest.mark.parametrize("scaled", [False, True], ids=["plain", "thickness"])
@pytest.mark.parametrize("epsilon", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_planted_plan_is_found(seed, epsilon, scaled):
    made = planted(seed, 200, 20, epsilon, scaled)
    found = cold(problem_of(made))
    assert found.converged
    assert variation(found.plan, made.plan) <= 1e-6


@pytest.mark.parametrize(("mass", "target"), [(0.5, 0.5), (0.3, 0.6), (0.9, 0.2)])
@pytest.mark.parametrize("gap", [0.01, 0.1, 0.3])
def test_two_points_and_two_nodes_have_the_root_of_the_quadratic(gap, mass, target):
    made = two_by_two(gap, 0.01, mass, target)
    found = cold(problem_of(made), Accuracy(1e-12, 1e-16, 500))
    np.testing.assert_allclose(found.plan.toarray(), made.plan, atol=1e-10)
    if mass == target == 0.5:
        stays = 0.5 / (1.0 + np.exp(-(gap**2) / 0.01))
        assert found.plan[0, 0] == pytest.approx(stays, abs=1e-10)


@pytest.mark.parametrize("epsilon", [0.01, 1.0])
def test_where_the_cost_is_a_sum_the_plan_is_the_product_of_the_marginals(epsilon):
    made = independent(0, 60, 7, epsilon)
    found = cold(problem_of(made))
    assert variation(found.plan, made.plan) <= 1e-7


def test_a_single_node_takes_all():
    problem = balanced(0, 20, 1, 0.01, False)._replace(target=np.ones(1))
    found = cold(problem)
    assert found.passes == 1
    np.testing.assert_allclose(found.plan.toarray()[:, 0], problem.mass, rtol=1e-14)


def test_a_large_epsilon_gives_the_product_and_a_small_one_the_nearest_node():
    problem = balanced(1, 50, 6, 1e4, False)
    product = np.outer(problem.mass, problem.target)
    assert variation(cold(problem).plan, product) <= 1e-3
    # Every point on its own node: nothing needs to move.
    nodes, mass = problem.points[:6], problem.mass[:6] / problem.mass[:6].sum()
    still = Problem(nodes, mass, nodes, mass, 1e-4, np.ones(6), np.ones(6))
    assert variation(cold(still).plan, np.diag(mass)) <= 1e-8


@given(seed=st.integers(0, 10_000), factor=st.floats(1e-3, 1e3), shift=st.floats(-5, 5))
@settings(max_examples=20, deadline=None)
def test_the_plan_keeps_under_shift_and_scale(seed, factor, shift):
    problem = balanced(seed, 40, 6, 0.05, True)
    other = problem._replace(
        points=factor * (problem.points + shift),
        nodes=factor * (problem.nodes + shift),
        epsilon=factor**2 * problem.epsilon,
    )
    assert variation(cold(problem).plan, cold(other).plan) <= 1e-6


# ------------------------------------------------------------------- potentials and marginals


@given(seed=st.integers(0, 10_000), epsilon=st.floats(0.01, 2.0), scaled=st.booleans())
@settings(max_examples=25, deadline=None)
def test_the_plan_is_what_its_potentials_say_and_meets_both_marginals(seed, epsilon, scaled):
    """Entries have the digits of the numbers they are kept in: float32 at the default."""
    problem = balanced(seed, 60, 8, epsilon, scaled)
    for accuracy, digits in ((TIGHT, 1e-9), (Accuracy(), 2e-5)):
        found = cold(problem, accuracy)
        entries = sparse.coo_array(found.plan)
        f, g = found.node_potentials[entries.col], found.point_potentials[entries.row]
        exponent = (f + g - costs(problem)[entries.row, entries.col]) / epsilon
        np.testing.assert_allclose(entries.data, np.exp(exponent), rtol=digits)
        np.testing.assert_allclose(found.plan.sum(axis=1), problem.mass, rtol=1e-12)
        off = np.abs(found.plan.sum(axis=0) - problem.target).sum()
        assert found.converged
        assert off <= accuracy.tolerance * 1.001
        assert off == pytest.approx(found.marginal_error, abs=1e-12 if digits < 1e-8 else 1e-6)


def test_the_solver_leaves_its_input_alone():
    problem = balanced(0, 40, 5, 0.05, True)
    start = np.linspace(-0.1, 0.1, 5)
    for array in (*[a for a in problem if isinstance(a, np.ndarray)], start):
        array.flags.writeable = False
    for transport in (solve, solve_free):
        transport(problem, start, TIGHT)
    np.testing.assert_array_equal(start, np.linspace(-0.1, 0.1, 5))


# ------------------------------------------------------------------------------- warm starts


@pytest.mark.parametrize("epsilon", [0.01, 0.05])
def test_a_warm_start_gives_the_same_answer_in_fewer_passes(epsilon):
    problem = balanced(2, 300, 30, epsilon, False)
    first = cold(problem)
    again = solve(problem, first.node_potentials, TIGHT)
    assert again.passes == 1
    assert variation(first.plan, again.plan) <= 1e-12
    moved = problem._replace(nodes=problem.nodes + 1e-4)
    warm, fresh = solve(moved, first.node_potentials, TIGHT), cold(moved)
    assert warm.passes < fresh.passes
    assert variation(warm.plan, fresh.plan) <= 1e-5


@given(seed=st.integers(0, 10_000), spread=st.floats(0, 40))
@settings(max_examples=25, deadline=None)
def test_any_start_leads_to_the_same_plan(seed, spread):
    made = planted(seed, 80, 8, 0.05)
    start = spread * 0.05 * np.random.default_rng(seed).standard_normal(8)
    found = solve(problem_of(made), start, TIGHT)
    assert found.converged
    assert variation(found.plan, made.plan) <= 1e-5


# --------------------------------------------------------------------------------- hard cases


@pytest.mark.parametrize("cut", [1e-12, 1e-5, 1e-3])
@pytest.mark.parametrize("away", [1.5, 30.0])
def test_a_node_far_from_every_point_still_gets_its_mass(away, cut):
    problem = balanced(4, 200, 20, 0.01, False)
    nodes = problem.nodes.copy()
    nodes[7] += away
    found = cold(problem._replace(nodes=nodes), Accuracy(1e-6, cut, 3000))
    assert found.converged
    assert found.plan.sum(axis=0)[7] == pytest.approx(problem.target[7], abs=1e-6)


@pytest.mark.parametrize("cut", [1e-12, 1e-5, 1e-3])
@pytest.mark.parametrize("share", [1e-3, 1e-6, 1e-12])
def test_a_node_of_next_to_no_mass_does_not_hold_the_others_up(share, cut):
    """Such a node rightly competes for no point and looks starved at its own optimum.

    It was raised, brought back down and, as its potential had moved, raised again until the
    passes ran out. All other tests have nodes of like mass, whose slack is small once solved.
    """
    problem = balanced(6, 200, 20, 0.02, False)
    target = problem.target.copy()
    target[3] = share
    problem = problem._replace(target=target / target.sum())
    found = cold(problem, Accuracy(1e-6, cut, 2000))
    assert found.converged
    assert found.passes < 200
    without = problem._replace(
        nodes=np.delete(problem.nodes, 3, axis=0),
        target=np.delete(target, 3) / np.delete(target, 3).sum(),
        node_scale=np.ones(19),
    )
    rest = cold(without, Accuracy(1e-6, cut, 2000))
    others = np.delete(found.plan.toarray(), 3, axis=1)
    assert variation(others, rest.plan) <= 2 * share + 1e-3


@pytest.mark.parametrize("cut", [1e-12, 1e-5])
def test_mass_flows_between_far_clusters(cut):
    """No point of one cluster has a node of the other in its list when the solve begins."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 0.1, (200, 3))
    points[100:, 0] += 1.0
    nodes = np.concatenate([points[:5], points[100:105]])
    mass = np.concatenate([np.full(100, 0.007), np.full(100, 0.003)])
    problem = Problem(points, mass, nodes, np.full(10, 0.1), 0.005, np.ones(200), np.ones(10))
    found = cold(problem, Accuracy(1e-6, cut, 3000))
    assert found.converged
    plan = found.plan.toarray()
    assert plan[:100, 5:].sum() == pytest.approx(0.2, abs=1e-5)
    assert plan[100:, :5].sum() == pytest.approx(0.0, abs=1e-5)


def test_a_solve_that_ran_out_of_passes_says_so():
    problem = balanced(0, 100, 20, 0.005, False)
    found = cold(problem, Accuracy(1e-8, 1e-12, 1))
    assert found.passes == 1
    assert not found.converged
    assert found.marginal_error > 1e-8
    np.testing.assert_allclose(found.plan.sum(axis=1), problem.mass, rtol=1e-12)
    for bound in (2, 7, 30):
        assert cold(problem, Accuracy(1e-14, 1e-12, bound)).passes <= bound


def test_acceleration_saves_passes():
    problem = balanced(8, 200, 20, 0.005, False)
    fast = cold(problem, Accuracy(1e-6, 1e-12, 5000))
    z, kernel = np.zeros(20), np.exp(-costs(problem) / problem.epsilon)
    plain = 0
    while True:
        plain += 1
        rows = kernel * np.exp(z)
        received = (rows * (problem.mass / rows.sum(axis=1))[:, None]).sum(axis=0)
        if np.abs(received - problem.target).sum() <= 1e-6 or plain == 5000:
            break
        z = z + np.log(problem.target / received)
    assert fast.converged
    assert fast.passes < 0.5 * plain


# ------------------------------------------------------------------------------------ the cut


def test_the_error_of_the_cut_is_bounded_and_shrinks_with_it():
    """The bounds are those to quote for `Accuracy.cut`: total variation against no cut at all.

    A tenth of a torus' points as nodes, ε = 0.0015 of its squared size, as the pipeline poses
    it. Measured for ε from 0.001 to 0.02: 1e-3 at a cut of 1e-3, 1e-5 at 1e-5, 4e-8 at 1e-8.
    """
    shape = torus(2000)
    points = shape.points / np.ptp(shape.points, axis=0).max()
    rng = np.random.default_rng(1)
    nodes = points[rng.choice(2000, 200, replace=False)]
    problem = Problem(
        points, np.full(2000, 5e-4), nodes, np.full(200, 5e-3), 0.0015, np.ones(2000), np.ones(200)
    )
    exact = cold(problem, Accuracy(1e-6, 1e-12, 3000))
    errors = [
        variation(cold(problem, Accuracy(1e-6, cut, 3000)).plan, exact.plan)
        for cut in (1e-3, 1e-5, 1e-8)
    ]
    assert errors[0] <= 2e-3
    assert errors[1] <= 3e-5
    assert errors[2] <= 1e-6
    assert errors == sorted(errors, reverse=True)


# ------------------------------------------------------------------------------- free masses


@given(seed=st.integers(0, 10_000), epsilon=st.floats(0.01, 2.0), scaled=st.booleans())
@settings(max_examples=25, deadline=None)
def test_free_masses_are_a_softmax(seed, epsilon, scaled):
    problem = balanced(seed, 50, 7, epsilon, scaled)
    f = epsilon * np.random.default_rng(seed).standard_normal(7)
    found = solve_free(problem, f, Accuracy(cut=1e-14))
    wanted = softmax((f - costs(problem)) / epsilon, axis=1) * problem.mass[:, None]
    np.testing.assert_allclose(found.plan.toarray(), wanted, atol=1e-12)
    np.testing.assert_array_equal(found.node_potentials, f)
    assert (found.passes, found.converged, found.marginal_error) == (1, True, 0.0)


@pytest.mark.parametrize(("precision", "digits"), [("double", 1e-12), ("single", 1e-5)])
@pytest.mark.parametrize("count", [1, BOX - 1, BOX, 2 * BOX + 3])
def test_free_masses_carry_what_the_dense_plan_does(count, precision, digits):
    """Boxes are worked on whole: what fills up the last one must carry nothing.

    One node is listed for some boxes and needed by none; the sums over plans that were written
    out, which the tests before looked at, come from another kernel.
    """
    rng = np.random.default_rng(count)
    points, nodes = rng.uniform(0, 1, (count, 3)), rng.uniform(0, 1, (9, 3))
    nodes[4] = 3.0
    mass, r = random_mass(rng, count), rng.uniform(0.5, 2, count)
    problem = Problem(points, mass, nodes, np.full(9, 1 / 9), 0.05, r, rng.uniform(0.5, 2, 9))
    f = 0.02 * rng.standard_normal(9)
    found = couple_free(problem, f, Accuracy(cut=1e-7, precision=precision))
    above = (f - costs(problem)) / problem.epsilon
    entries = np.exp(above - above.max(axis=1, keepdims=True))
    entries[entries < 1e-7] = 0.0
    wanted = mass[:, None] * entries / entries.sum(axis=1, keepdims=True)
    carried = found.carried
    np.testing.assert_allclose(carried.received, wanted.sum(axis=0), atol=digits)
    np.testing.assert_allclose(carried.pull, (wanted / r[:, None]).sum(axis=0), atol=digits)
    np.testing.assert_allclose(carried.places, (wanted / r[:, None]).T @ points, atol=digits)
    np.testing.assert_allclose(carried.scale, wanted.T @ r, atol=digits)
    assert carried.received[4] == 0.0
    g = problem.epsilon * (np.log(mass / entries.sum(axis=1)) - above.max(axis=1))
    np.testing.assert_allclose(found.point_potentials, g, atol=digits)


def test_free_masses_let_a_far_node_starve():
    problem = balanced(0, 50, 5, 0.01, False)
    nodes = problem.nodes.copy()
    nodes[2] += 10.0
    found = solve_free(problem._replace(nodes=nodes), np.zeros(5), Accuracy())
    assert found.plan.sum(axis=0)[2] == 0.0
    assert found.plan.sum() == pytest.approx(1.0)


# ------------------------------------------------------------------------------------- energy


@given(seed=st.integers(0, 10_000), epsilon=st.floats(0.01, 2.0), scaled=st.booleans())
@settings(max_examples=20, deadline=None)
def test_the_energy_is_the_direct_sum(seed, epsilon, scaled):
    problem = balanced(seed, 40, 6, epsilon, scaled)
    start = epsilon * np.random.default_rng(seed).standard_normal(6)
    for found in (solve(problem, start, TIGHT), solve_free(problem, start, TIGHT)):
        entries = sparse.coo_array(found.plan)
        pi = entries.data
        paid = pi @ costs(problem)[entries.row, entries.col]
        entropy = -(pi @ np.log(pi))
        assert transport_energy(found) == pytest.approx(paid - epsilon * entropy, abs=1e-10)


def test_distances_follow_the_plans_entries():
    problem = balanced(0, 30, 4, 0.05, False)
    plan = cold(problem).plan
    dense = np.linalg.norm(problem.points[:, None] - problem.nodes, axis=2)
    entries = sparse.coo_array(plan)
    found = distances(plan, problem.points, problem.nodes)
    np.testing.assert_allclose(found, dense[entries.row, entries.col], atol=1e-15)
    mean = (plan.toarray() * dense).sum(axis=0) / plan.toarray().sum(axis=0)
    np.testing.assert_allclose(mean_distance(plan, problem.points, problem.nodes), mean)


def test_a_node_without_mass_has_no_mean_distance():
    plan = sparse.csr_array(np.array([[1.0, 0.0]]))
    points, nodes = np.zeros((1, 3)), np.ones((2, 3))
    np.testing.assert_allclose(mean_distance(plan, points, nodes), [np.sqrt(3), 0.0])


# ------------------------------------------------------------------------------ acceleration


def test_the_mixer_solves_a_linear_iteration_in_as_many_steps_as_it_has_unknowns():
    rng = np.random.default_rng(0)
    turn = rng.standard_normal((4, 4))
    turn *= 0.95 / np.abs(np.linalg.eigvals(turn)).max()
    goal = rng.standard_normal(4)
    mixer, z = AndersonMixer(np.ones(4), depth=10, clip=100.0), np.zeros(4)
    errors = []
    for _ in range(8):
        z = mixer.step(z, turn @ (z - goal) + goal - z)
        errors.append(np.abs(z - goal).max())
    assert errors[0] > 0.1
    assert errors[-1] < 1e-6


def test_the_mixer_clips_and_forgets():
    mixer = AndersonMixer(np.ones(1), depth=3, clip=0.5)
    assert mixer.step(np.zeros(1), np.ones(1)) == 1.0
    # Residuals 1 and 0.99 point to 100 steps further: the clip holds that back.
    assert mixer.step(np.ones(1), np.full(1, 0.99)) == pytest.approx(1.5)
    mixer.clear()
    assert mixer.step(np.zeros(1), np.ones(1)) == 1.0


# ------------------------------------------------------------------------------ compiled loops


def scene(n=300, m=70, epsilon=0.02):
    """A cloud in boxes, nodes in cells, f, and the exponents (f_i − c_ij)/ε in their orders."""
    problem = balanced(9, n, m, epsilon, True)
    f = epsilon * np.random.default_rng(9).standard_normal(m)
    boxes, sites = problem.boxes(), in_cells(problem.nodes, problem.node_scale, f)
    dense = ((f - costs(problem)) / epsilon)[boxes.order][:, sites.names]
    return problem, boxes, sites, dense


@given(seed=st.integers(0, 1000), n=st.integers(1, 200), size=st.sampled_from([1, 5, 32]))
@settings(max_examples=30, deadline=None)
def test_boxes_hold_every_point_once_and_little_else(seed, n, size):
    points = np.random.default_rng(seed).uniform(0, 1, (n, 3)).round(1)
    order = box_order(points, size)
    assert sorted(order.tolist()) == list(range(n))
    low, high, span = box_bounds(points[order], points[order, 0] + 1, size)
    assert len(low) == -(-n // size)
    for b in range(len(low)):
        mine = points[order[b * size : (b + 1) * size]]
        np.testing.assert_array_equal(low[b], mine.min(axis=0))
        np.testing.assert_array_equal(high[b], mine.max(axis=0))
        np.testing.assert_array_equal(span[b], [mine[:, 0].min() + 1, mine[:, 0].max() + 1])


def test_boxes_are_small():
    points = np.random.default_rng(0).uniform(0, 1, (4096, 3))
    low, high, _ = box_bounds(points[box_order(points, 32)], np.ones(4096), 32)
    # 128 boxes of a unit cube: 0.2 wide if they were cubes.
    assert np.mean(high - low) < 0.25


@pytest.mark.parametrize("reach", [0.0, 0.05, 100.0])
def test_lists_hold_all_nodes_within_reach_of_a_points_best(reach):
    _, boxes, sites, dense = scene()
    gap = -0.02 * dense
    wanted = gap <= gap.min(axis=1)[:, None] + reach
    indptr, indices, levels = listed(boxes, sites, reach)
    for b in range(len(indptr) - 1):
        mine = indices[indptr[b] : indptr[b + 1]]
        rows = slice(b * BOX, (b + 1) * BOX)
        assert (np.diff(mine) > 0).all()
        assert set(np.flatnonzero(wanted[rows].any(axis=0))) <= set(mine.tolist())
        assert levels[b] >= -gap[rows].min()


def test_lists_longer_than_expected_are_whole():
    problem = balanced(9, 500, 450, 0.02, False)
    sites = in_cells(problem.nodes, problem.node_scale, np.zeros(450))
    indptr, indices, _ = listed(problem.boxes(), sites, 1e6)
    np.testing.assert_array_equal(indptr, 450 * np.arange(17))
    np.testing.assert_array_equal(indices, np.tile(np.arange(450), 16))


def dense_blocks(blocks, n, m):
    """The kernel of blocks as (n, m)."""
    full = np.zeros((n, m))
    for b in range(len(blocks.starts) - 1):
        mine = blocks.indices[blocks.indptr[b] : blocks.indptr[b + 1]]
        rows = slice(b * BOX, min(n, (b + 1) * BOX))
        block = blocks.kernel[blocks.starts[b] : blocks.starts[b + 1]]
        # Padding names node 0 with zeros: it must add nothing.
        np.add.at(full[rows].T, mine, block.reshape(-1, len(mine)).T)
    return full


@pytest.mark.parametrize(("kind", "digits"), [(np.float32, 1e-5), (np.float64, 1e-13)])
@pytest.mark.parametrize("cut", [1e-2, 1e-6])
def test_blocks_hold_the_kernel_above_the_cut(cut, kind, digits):
    _, boxes, sites, dense = scene()
    blocks = filled(boxes, sites, 0.02, cut, kind)
    assert blocks.kernel.dtype == kind
    top = dense.max(axis=1)
    wanted = np.exp(dense - top[:, None])
    np.testing.assert_allclose(blocks.top, 0.02 * top, atol=1e-6 if kind is np.float32 else 1e-14)
    got = dense_blocks(blocks, *dense.shape)
    clear = np.abs(wanted / cut - 1) > 1e-4
    np.testing.assert_allclose(got[clear], np.where(wanted >= cut, wanted, 0)[clear], rtol=digits)
    slack = -0.02 * (dense - top[:, None]).max(axis=0)
    served = np.isfinite(blocks.slack)
    np.testing.assert_array_equal(served, got.any(axis=0))
    np.testing.assert_allclose(blocks.slack[served], slack[served], atol=1e-6)
    for i in np.flatnonzero(~served):
        assert slack_of(int(i), boxes, sites, blocks) == pytest.approx(slack[i], abs=1e-6)


def test_a_pass_is_the_dense_half_steps():
    _, boxes, sites, _ = scene()
    blocks = filled(boxes, sites, 0.02, 1e-9, np.float64)
    dense = dense_blocks(blocks, 300, 70)
    u = np.random.default_rng(0).uniform(0.5, 2, 70)
    received, sums = np.empty(70), np.empty(300)
    where = blocks.kernel, blocks.starts, blocks.indptr, blocks.indices, BOX
    sinkhorn_pass(*where, boxes.mass, u, received, sums)
    np.testing.assert_allclose(sums, dense @ u, rtol=1e-12)
    wanted = dense * u * (boxes.mass / (dense @ u))[:, None]
    np.testing.assert_allclose(received, wanted.sum(axis=0), rtol=1e-12)
    plan = plan_of(boxes, sites, blocks, u)
    assert plan.has_sorted_indices
    np.testing.assert_allclose(plan.toarray()[boxes.order][:, sites.names], wanted, rtol=1e-12)


@pytest.mark.parametrize("transport", [couple, couple_free])
@pytest.mark.parametrize("accuracy", [TIGHT, Accuracy()], ids=["double", "single"])
def test_what_a_plan_carries_is_known_without_the_plan(transport, accuracy):
    problem = balanced(3, 300, 40, 0.02, True)
    start = 0.02 * np.random.default_rng(3).standard_normal(40)
    found = transport(problem, start, accuracy)
    solution = found.solution(problem.epsilon, accuracy)
    plan = solution.plan.toarray()
    r = problem.point_scale
    digits = 1e-12 if accuracy is TIGHT else 1e-5
    np.testing.assert_allclose(found.carried.received, plan.sum(axis=0), rtol=digits)
    np.testing.assert_allclose(found.carried.pull, (plan / r[:, None]).sum(axis=0), rtol=digits)
    places = plan.T @ (problem.points / r[:, None])
    np.testing.assert_allclose(found.carried.places, places, rtol=10 * digits)
    np.testing.assert_allclose(found.carried.scale, plan.T @ r, rtol=digits)
    assert found.energy == pytest.approx(transport_energy(solution), abs=digits)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_the_order_of_points_and_nodes_does_not_matter(seed):
    problem = balanced(seed, 150, 40, 0.02, True)
    rng = np.random.default_rng(seed)
    p, q = rng.permutation(150), rng.permutation(40)
    turned = Problem(
        problem.points[p], problem.mass[p], problem.nodes[q], problem.target[q],
        problem.epsilon, problem.point_scale[p], problem.node_scale[q],
    )  # fmt: skip
    for transport in (cold, lambda one: solve_free(one, np.zeros(40), TIGHT)):
        assert variation(transport(problem).plan[p][:, q], transport(turned).plan) <= 1e-7


def test_the_exponential_is_that_of_the_library():
    for kind, digits in ((np.float32, 5e-7), (np.float64, 5e-15)):
        values = np.linspace(-87, 0, 2001).astype(kind)
        got = np.array([exponential(v, values) for v in values])
        np.testing.assert_allclose(got, np.exp(values.astype(np.float64)), rtol=digits)
        plain = [vector_exp.py_func(v, values) for v in values[::50]]
        np.testing.assert_allclose(plain, np.exp(values[::50].astype(np.float64)), rtol=digits)


@njit
def exponential(value, like):
    return vector_exp(value, like)


@pytest.mark.parametrize("plain", [True, False], ids=["python", "compiled"])
def test_top_shares_are_the_largest_of_each_row(plain):
    shares_of = top_shares.py_func if plain else top_shares
    rng = np.random.default_rng(0)
    dense = rng.uniform(0, 1, (50, 9)) * (rng.uniform(0, 1, (50, 9)) < 0.4)
    dense[0] = 0.0
    plan = sparse.csr_array(dense)
    nodes, shares = shares_of(plan.indptr, plan.indices, plan.data, 4)
    for row, at, share in zip(dense, nodes, shares, strict=True):
        order = [i for i in np.argsort(-row) if row[i] > 0][:4]
        assert at.tolist() == order + [-1] * (4 - len(order))
        wanted = row[order] / max(row.sum(), 1e-300)
        np.testing.assert_allclose(share[: len(order)], wanted)
        assert not share[len(order) :].any()


def test_the_kernel_is_made_again_when_potentials_have_moved_far(monkeypatch):
    made = []
    build = sinkhorn.filled
    monkeypatch.setattr(sinkhorn, "filled", lambda *args: made.append(1) or build(*args))
    cold(balanced(2, 200, 20, 0.005, False))
    assert len(made) > 1
