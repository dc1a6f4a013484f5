"""The demo's cloud: on the animal's skin, with its hole, the same every time."""

from __future__ import annotations

import numpy as np
import pytest

from mdcs_pipeline.demo import DEMO_LEAVES, bones, demo_cloud, skin_height
from mdcs_pipeline.pipeline import skeletonize


def test_the_cloud_is_the_same_every_time() -> None:
    np.testing.assert_array_equal(demo_cloud(), demo_cloud())
    assert not np.array_equal(demo_cloud(800), demo_cloud(800, seed=1))


def test_about_six_thousand_points_of_which_the_hole_took_some() -> None:
    points = demo_cloud()
    assert points.dtype == np.float64
    assert 5800 < len(points) < 6000
    assert np.isfinite(points).all()


def test_points_lie_on_the_skin_and_without_noise_exactly() -> None:
    # What lies within another bone is no skin: only there would the height be negative.
    assert np.abs(skin_height(demo_cloud(noise=0.0))).max() < 0.006
    noisy = skin_height(demo_cloud(noise=0.002))
    assert 0.0015 < np.std(noisy) < 0.003


def test_the_hole_is_in_the_left_flank_alone() -> None:
    points = demo_cloud()
    left = np.array([0.10, 0.17, 0.62])
    right = left * [1, -1, 1]
    assert np.linalg.norm(points - left, axis=1).min() > 0.09
    assert np.count_nonzero(np.linalg.norm(points - right, axis=1) < 0.09) > 20


def test_every_bone_is_covered() -> None:
    points = demo_cloud()
    ends, radii = bones()
    assert ends.shape == (20, 2, 3)
    assert radii.shape == (20, 2)
    for (start, stop), (first, last) in zip(ends, radii, strict=True):
        near = np.linalg.norm(points - (start + stop) / 2, axis=1)
        assert np.count_nonzero(near < 1.5 * max(first, last)) > 15


@pytest.mark.parametrize("seed", [0, 1])
def test_its_skeleton_has_the_animals_ends(seed: int) -> None:
    summary = skeletonize(demo_cloud(seed=seed)).summary()
    assert summary["leaves"] == DEMO_LEAVES
    assert (summary["components"], summary["cycles"]) == (1, 0)
