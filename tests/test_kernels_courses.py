"""How limbs go on past their ends: straight lines and circles have known courses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdcs_pipeline.kernels.courses import course_of, smooth_way


def circle(radius: float, *angles: float) -> np.ndarray:
    """Return the places at some angles, in degrees, of a circle around the origin."""
    turn = np.deg2rad(angles)
    return radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))])


@given(st.floats(0.01, 100.0), st.floats(5.0, 120.0))
def test_the_course_of_an_arc_is_its_circle(radius: float, arc: float) -> None:
    course = course_of(circle(radius, 0.0, 0.4 * arc, arc))
    np.testing.assert_allclose(course.tangent, [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(course.bend * radius, [-1, 0, 0], atol=1e-6)


def test_a_straight_limb_goes_straight_on_and_a_single_node_nowhere() -> None:
    line = np.linspace([1.0, 2, 3], [4, 2, 3], 4)
    for chain in (line, line[:2]):
        course = course_of(chain)
        np.testing.assert_allclose(course.tangent, [-1, 0, 0], atol=1e-12)
        assert not course.bend.any()
    assert not course_of(line[:1]).tangent.any()


@pytest.mark.parametrize("turn", [10.0, 90.0, 170.0])
def test_whatever_lies_on_the_circle_lies_on_the_course(turn: float) -> None:
    end, goal = circle(2.0, 0.0, -turn)
    course = course_of(circle(2.0, 0.0, 20.0, 40.0))
    assert course.cosine(goal - end) == pytest.approx(1.0, abs=1e-9)
    # Seen straight ahead, it is off by half of the turn.
    straight = float(course.tangent @ (goal - end) / np.linalg.norm(goal - end))
    assert straight == pytest.approx(np.cos(np.deg2rad(turn / 2)), abs=1e-9)
    assert course.cosine(np.zeros(3)) == 0.0


def test_the_smooth_way_between_ends_of_one_circle_is_that_circle() -> None:
    for turn, apart in ((30.0, 1e-5), (90.0, 1e-3), (180.0, 0.02)):
        start, goal = circle(3.0, 0.0, turn)
        angle = np.deg2rad(turn)
        way = smooth_way(
            start, np.array([0.0, 1, 0]), goal, np.array([np.sin(angle), -np.cos(angle), 0])
        )
        np.testing.assert_allclose(np.linalg.norm(way, axis=1), 3.0, rtol=apart)
        np.testing.assert_allclose(way[[0, -1]], [start, goal], atol=1e-12)


def test_the_way_between_ends_without_direction_is_straight() -> None:
    goal = np.array([1.0, 2, 2])
    way = smooth_way(np.zeros(3), np.zeros(3), goal, np.zeros(3))
    np.testing.assert_allclose(np.cross(way, goal), 0.0, atol=1e-12)
