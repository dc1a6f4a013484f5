"""Stages and a pipeline in the midst of an Open3D script.

``python examples/open3d_script.py [SCAN] [-o FOLDER]`` takes an object off the table that it
stands on, and writes its skeleton as a line set. Without a scan, one is made.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import open3d as o3d

import mdcs_pipeline as mdcs
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.stages.clean import Clean
from mdcs_pipeline.stages.downsample import Downsample


def made_scan() -> o3d.geometry.PointCloud:
    """Return the demo's animal on a table."""
    animal = demo_cloud(5000)
    low, high = animal.min(axis=0), animal.max(axis=0)
    table = np.random.default_rng(0).uniform(low - 0.4, high + 0.4, (12_000, 3))
    table[:, 2] = low[2] - 0.02
    points = np.concatenate([animal, table])
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def object_on_table(scan: o3d.geometry.PointCloud) -> o3d.geometry.PointCloud:
    """Return what does not lie in the scan's largest plane."""
    reach = 0.005 * float(np.linalg.norm(scan.get_max_bound() - scan.get_min_bound()))
    o3d.utility.random.seed(0)
    _, table = scan.segment_plane(distance_threshold=reach, ransac_n=3, num_iterations=1000)
    return scan.select_by_index(table, invert=True)


def main() -> None:
    """Read, take the object, thin it by two stages, skeletonise, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scan", nargs="?", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/open3d"))
    given = parser.parse_args()
    scan = made_scan() if given.scan is None else o3d.io.read_point_cloud(str(given.scan))
    found = object_on_table(scan)

    # Stages take Open3D's clouds as they are, and give messages that become clouds again.
    thin = Downsample(voxel=0.015)(Clean()(found).cloud).cloud
    print(f"{len(scan.points)} points, {len(found.points)} on the table, {len(thin)} kept")

    # Outliers have gone already, so the pipeline need not look for any.
    skeleton = mdcs.skeletonize(thin, clean={"passes": 0})
    print(skeleton.summary())

    lines = skeleton.to_lineset()
    lines.paint_uniform_color([0.8, 0.1, 0.1])
    given.output.mkdir(parents=True, exist_ok=True)
    o3d.io.write_line_set(str(given.output / "skeleton.ply"), lines)
    o3d.io.write_point_cloud(str(given.output / "object.ply"), thin.to_open3d())
    print(f"written {given.output}/skeleton.ply and object.ply")


if __name__ == "__main__":
    main()
