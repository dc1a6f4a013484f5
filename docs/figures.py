"""Draws the figures of the documentation from runs of the project itself.

``python docs/figures.py [FOLDER]`` writes them; the documentation's build does so when a
source of theirs has changed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

import mdcs_pipeline as mdcs
from mdcs_pipeline.config import load_spec
from mdcs_pipeline.demo import demo_cloud
from mdcs_pipeline.graph import build_graph, draw_graph
from mdcs_pipeline.messages import RoughSkeleton

CLOUD, LINE, NODE = "#b9bec4", "#c8102e", "#1f3a93"
Points = NDArray[np.float64]


def draw_all(folder: Path) -> None:
    """Write every figure into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    points = demo_cloud(5000)
    draw_steps(points, folder / "steps.png")
    draw_epsilon(points, folder / "epsilon.png")
    draw_graph(build_graph(load_spec("default")), folder / "default.svg")


def draw_steps(points: Points, path: Path) -> None:
    """Draw what each part of the default pipeline makes of the demo's cloud."""
    stages: Any = build_graph(load_spec("default")).stages
    clean = stages["clean"](stages["downsample"](points).cloud).cloud
    cloud = stages["density"](stages["thin"](clean).cloud).cloud
    surface = stages["surface"](cloud).surface
    thickness = stages["thickness"](cloud, surface).thickness
    thickness, surface = stages["medial"](cloud, surface, thickness)
    thickness, surface = stages["ridge"](cloud, surface, thickness)
    nodes = stages["seed"](cloud, thickness).nodes
    rounds = []
    while nodes is not None:
        plan = stages["transport"](cloud, nodes, thickness).plan
        rounds.append(plan)
        nodes, plan = stages["merge"](plan)
    rough = stages["check"](
        cloud, stages["link"](cloud, plan, surface).rough, surface=surface, thickness=thickness
    ).accepted
    skeleton = stages["smooth"](cloud, rough, thickness=thickness).skeleton

    figure = Figure(figsize=(12, 5.6), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    place = cloud.unit.from_unit
    on = place(cloud.positions)
    _cloud(panels[0], on, "mass of the points (density)", cloud.mass)
    _cloud(panels[1], on, "local thickness (thickness, medial, ridge)", thickness.radius)
    _cloud(panels[2], on, f"first plan: {len(rounds[0].nodes)} nodes (transport)")
    _nodes(panels[2], place(rounds[0].nodes.positions), rounds[0].nodes.mass)
    late = rounds[len(rounds) // 3]
    _cloud(panels[3], on, f"after merging: {len(late.nodes)} nodes (merge)")
    _nodes(panels[3], place(late.nodes.positions), late.nodes.mass)
    _cloud(panels[4], on, f"nodes that share mass: {len(rough.plan.nodes)} (link, check)")
    _edges(panels[4], place(rough.plan.nodes.positions), rough)
    _nodes(panels[4], place(rough.plan.nodes.positions), rough.plan.nodes.mass)
    _cloud(panels[5], on, f"the skeleton: {len(skeleton)} nodes (smooth)")
    _edges(panels[5], skeleton.nodes, skeleton)
    _save(figure, path)


def draw_epsilon(points: Points, path: Path) -> None:
    """Draw the skeletons of three values of epsilon."""
    figure = Figure(figsize=(12, 2.8), layout="constrained")
    for panel, epsilon in zip(figure.subplots(1, 3), (0.5, 1.5, 6.0), strict=True):
        skeleton = mdcs.skeletonize(points, transport={"epsilon": epsilon})
        counts = skeleton.summary()
        _cloud(
            panel,
            points,
            f"ε = {epsilon}: {counts['leaves']} ends, {counts['cycles']} loops",
        )
        _edges(panel, skeleton.nodes, skeleton)
    _save(figure, path)


def _cloud(panel: Any, points: Points, title: str, value: Points | None = None) -> None:
    # Farthest first, seen from the side: x to the right, z up.
    order = np.argsort(-points[:, 1])
    colour = {"c": CLOUD} if value is None else {"c": value[order], "cmap": "viridis"}
    panel.scatter(*points[order][:, [0, 2]].T, s=2.5, linewidths=0, **colour)
    panel.set_title(title, fontsize=11)
    panel.set_aspect("equal")
    panel.set_axis_off()


def _nodes(panel: Any, places: Points, mass: Points) -> None:
    panel.scatter(*places[:, [0, 2]].T, s=14 * np.sqrt(mass * len(mass)), c=NODE, zorder=3)


def _edges(panel: Any, places: Points, graph: RoughSkeleton | mdcs.Skeleton) -> None:
    for i, j in graph.edges:
        panel.plot(*places[[i, j]][:, [0, 2]].T, c=LINE, lw=2.2, zorder=2, solid_capstyle="round")


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    # Without the version of matplotlib in it, the file is the same everywhere.
    figure.savefig(path, dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    draw_all(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/figures"))
