"""The speed benchmark's own arithmetic: problems, passes, tables. No timing is asserted."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.speed import passes, problems, table, worker
from mdcs_pipeline.kernels.problem import Accuracy, Problem
from mdcs_pipeline.kernels.sinkhorn import couple


def small() -> Problem:
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (300, 3))
    return Problem(
        points, np.full(300, 1 / 300), points[:30], np.full(30, 1 / 30), 0.02,
        np.ones(300), np.ones(30),
    )  # fmt: skip


def test_copies_of_an_object_stand_apart():
    points = np.random.default_rng(0).uniform(0, 1, (50, 3))
    scene = problems.repeated(points, 5)
    assert scene.shape == (250, 3)
    np.testing.assert_array_equal(scene[:50], points)
    boxes = [(part.min(axis=0), part.max(axis=0)) for part in scene.reshape(5, 50, 3)]
    for k, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:k]:
            assert (low > other_high).any() or (high < other_low).any()


def test_plain_passes_are_those_of_sinkhorn_by_the_book():
    problem = small()
    cost = np.square(problem.points[:, None] - problem.nodes).sum(axis=2)
    kernel, z, wanted = np.exp(-cost / problem.epsilon), np.zeros(30), {}
    for count in range(1, 2000):
        rows = kernel * np.exp(z)
        received = (rows * (problem.mass / rows.sum(axis=1))[:, None]).sum(axis=0)
        error = np.abs(received - problem.target).sum()
        for tolerance in (1e-3, 1e-6):
            if error <= tolerance:
                wanted.setdefault(tolerance, count)
        z += np.log(problem.target / received)
    found = passes.plain_passes(problem, (1e-3, 1e-6), 2000)
    np.testing.assert_allclose(found, [wanted[1e-3], wanted[1e-6]], atol=1)
    ours = couple(problem, np.zeros(30), Accuracy(1e-6, 1e-9))
    assert ours.converged
    assert ours.passes < found[1]


def test_a_bound_ends_plain_passes():
    assert passes.plain_passes(small(), (1e-12,), 5) == [5]


def test_memory_is_that_of_the_work():
    found = worker.timed(lambda: {"held": np.ones(20_000_000).sum()}, warm=False)
    assert found["held"] == 20_000_000
    assert 120 < found["peak_mb"] < 200


FIGURES = {"cpu": 2.0, "wall": 3.0, "peak_mb": 10.0, "process_cpu": 4.0}


def test_tables_show_ratios_and_what_is_absent():
    text = table.report(
        {
            "about": {"processor": "a"},
            "skeleton": {"mdcs": FIGURES, "peer": {**FIGURES, "cpu": 50.0}, "no": {"missing": "x"}},
            "growth": {"1e+04": FIGURES, "1e+05": {**FIGURES, "cpu": 3.0}},
            "scene": {"1": FIGURES, "exponent": 1.05},
            "start": {"mdcs --help": FIGURES},
        }
    )
    for words in ("25 x", "absent: x", "1.5 x", "exponent 1.05", "| mdcs --help | 2.00 | 3.00 |"):
        assert words in text


def test_the_readme_keeps_what_is_around_the_tables(tmp_path, monkeypatch):
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{table.BEGIN}\nold\n{table.END}\nafter\n")
    monkeypatch.setattr(table, "README", readme)
    table.write_readme("new")
    assert readme.read_text() == f"before\n{table.BEGIN}\n\nnew\n{table.END}\nafter\n"


@pytest.mark.parametrize("name", sorted(worker.WORK))
def test_every_measurement_can_be_called(name):
    assert callable(worker.WORK[name])
