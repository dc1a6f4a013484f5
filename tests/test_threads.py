"""Threads: how many, who says so, and that no result depends on them."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import shapes
from typer.testing import CliRunner

from mdcs_pipeline.cli.app import app
from mdcs_pipeline.config import load_spec, parse_spec
from mdcs_pipeline.errors import ConfigError
from mdcs_pipeline.kernels import workers
from mdcs_pipeline.kernels.nearest import nearest
from mdcs_pipeline.kernels.workers import allowed_threads, shared_out, thread_count, threads
from mdcs_pipeline.overrides import parse_override
from mdcs_pipeline.pipeline import Pipeline, skeletonize


@pytest.fixture(autouse=True)
def eight_processors(monkeypatch):
    """Let every test run on a machine of eight processors without limits."""
    monkeypatch.setattr(workers.os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    for name in workers.LIMITS:
        monkeypatch.delenv(name, raising=False)


def test_one_thread_works_unless_more_are_asked_for():
    assert thread_count() == 1
    with threads(3) as granted:
        assert granted == thread_count() == 3
        with threads(2):
            assert thread_count() == 2
        assert thread_count() == 3
    assert thread_count() == 1


@pytest.mark.parametrize(
    ("limits", "most"),
    [
        ({}, 8),
        ({"OMP_NUM_THREADS": "2"}, 2),
        ({"OMP_NUM_THREADS": "4,2", "NUMBA_NUM_THREADS": "3"}, 3),
        ({"NUMBA_NUM_THREADS": "64"}, 8),
        ({"OMP_NUM_THREADS": "no number", "NUMBA_NUM_THREADS": ""}, 8),
        ({"OMP_NUM_THREADS": "0"}, 1),
    ],
)
def test_no_more_threads_than_the_user_allows(monkeypatch, limits, most):
    for name, value in limits.items():
        monkeypatch.setenv(name, value)
    assert allowed_threads() == most
    with threads(100) as granted:
        assert granted == most


def test_work_is_shared_out_and_put_together_in_its_order(monkeypatch):
    monkeypatch.setattr(workers, "_LEAST", 10)
    meeting, who = threading.Barrier(3, timeout=10), set()

    def work(some):
        meeting.wait()
        who.add(threading.get_ident())
        return some, some**2.0

    with threads(3):
        names, squares = shared_out(work, np.arange(100))
    assert len(who) == 3
    np.testing.assert_array_equal(names, np.arange(100))
    np.testing.assert_array_equal(squares, np.arange(100) ** 2)


def test_little_work_stays_in_one_thread():
    with threads(8):
        (who,) = shared_out(lambda some: (some * 0 + threading.get_ident(),), np.arange(50))
    assert (who == threading.get_ident()).all()


def test_stages_run_with_the_threads_of_their_pipeline(monkeypatch):
    seen = []
    monkeypatch.setattr(
        "mdcs_pipeline.kernels.density.nearest",
        lambda *given: (seen.append(thread_count()), nearest(*given))[1],
    )
    for count in (1, 4):
        with Pipeline.from_config("default", threads=count) as pipe:
            pipe.push(shapes.y(600))
    assert seen == [1, 4]
    assert thread_count() == 1


def test_no_result_depends_on_the_number_of_threads(monkeypatch):
    monkeypatch.setattr(workers, "_LEAST", 50)
    points = shapes.y(4000)
    one, four = (skeletonize(points, threads=count) for count in (1, 4))
    np.testing.assert_array_equal(one.nodes, four.nodes)
    np.testing.assert_array_equal(one.edges, four.edges)
    np.testing.assert_array_equal(one.radius, four.radius)


def test_threads_are_a_setting_of_the_file_of_python_and_of_the_command_line(tmp_path):
    assert load_spec("default").threads == 1
    assert load_spec("default", {"threads": 2}).threads == 2
    assert parse_spec("threads: 3\nstages: {read: {}}").threads == 3
    assert parse_override("threads=4") == ("threads", 4)
    cloud = tmp_path / "y.xyz"
    np.savetxt(cloud, shapes.y(600))
    done = CliRunner().invoke(app, ["run", "-i", str(cloud), "-q", "--threads", "2"])
    assert done.exit_code == 0, done.output
    refused = CliRunner().invoke(app, ["run", "-i", str(cloud), "-q", "--threads", "0"])
    assert refused.exit_code != 0


@pytest.mark.parametrize("wrong", ["0", "-1", "1.5", "many", "true", "[1]"])
def test_what_is_no_number_of_threads_is_refused_with_its_line(wrong):
    with pytest.raises(ConfigError, match="threads must be a whole number") as error:
        parse_spec(f"name: a\nthreads: {wrong}\nstages: {{read: {{}}}}", "file.yaml")
    assert "file.yaml:2" in str(error.value)
