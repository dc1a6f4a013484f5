"""One measurement in a process of its own: ``python -m benchmarks.speed.worker NAME [ARG]``.

Prints one line of JSON: CPU and wall seconds of the work itself (warm), those of the whole
process, and its peak memory over what it held when the work began.
"""

from __future__ import annotations

import json
import resource
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed import problems

Work = Callable[[], Any]


def resident() -> float:
    """Return the memory held now, in MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def peak() -> float:
    """Return the most memory held since `forget_peak`, in MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e3


def cpu_time() -> float:
    """Return the CPU seconds of this process and of those that it has waited for."""
    others = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + others.ru_utime + others.ru_stime


def forget_peak() -> None:
    """Make `peak` count from here."""
    Path("/proc/self/clear_refs").write_text("5")


def timed(work: Work, warm: bool = True) -> dict[str, Any]:
    """Run `work` once to compile and load, unless cold, then measure it."""
    if warm:
        work()
    before = resident()
    forget_peak()
    cpu, wall = cpu_time(), time.perf_counter()
    found = work()
    figures = {"cpu": cpu_time() - cpu, "wall": time.perf_counter() - wall}
    return {**figures, "peak_mb": peak() - before, **(found if isinstance(found, dict) else {})}


def solve_ours(tolerance: float = 1e-3, cut: float = 1e-5) -> dict[str, Any]:
    from mdcs_pipeline.kernels.problem import Accuracy
    from mdcs_pipeline.kernels.sinkhorn import couple

    problem = problems.transport_problem()
    accuracy = Accuracy(tolerance, cut)

    def work() -> dict[str, Any]:
        made = couple(problem, np.zeros(problems.NODES), accuracy)
        return {"passes": made.passes, "error": made.marginal_error}

    return timed(work)


def solve_pot(method: str, passes: int) -> dict[str, Any]:
    """POT for as many passes as plain Sinkhorn needs; the cost matrix is counted in."""
    import ot

    warnings.filterwarnings("ignore")
    problem = problems.transport_problem()

    def work() -> None:
        cost = ot.dist(problem.points, problem.nodes)
        options = {"numItermax": passes, "stopThr": 0.0}
        ot.sinkhorn(problem.mass, problem.target, cost, problem.epsilon, method, **options)

    return timed(work, warm=False)


def skeleton_ours(cloud: str = "vertices") -> dict[str, Any]:
    import mdcs_pipeline as mdcs

    points = problems.mesh()[0] if cloud == "vertices" else problems.sampled(int(cloud))
    mdcs.skeletonize(problems.sampled(3000))
    return timed(lambda: mdcs.skeletonize(points).summary(), warm=len(points) < 10**6)


def skeleton_scene(times: int) -> dict[str, Any]:
    """A scene of copies: voxels of the one object's size, whatever the scene's."""
    import mdcs_pipeline as mdcs

    one = problems.sampled(20_000)
    voxel = 0.02 * float(np.ptp(one, axis=0).max())
    settings = {"downsample": {"voxel_size": voxel}, "thin": {"voxel_size": 2.0 * voxel}}
    scene = problems.repeated(one, times)
    mdcs.skeletonize(one, **settings)
    return timed(lambda: mdcs.skeletonize(scene, **settings).summary(), warm=False)


def skeleton_peer(name: str) -> dict[str, Any]:
    from benchmarks.topology import peers

    points = np.asarray(problems.mesh()[0])
    return timed(lambda: {"nodes": len(getattr(peers, name)(points).nodes)}, warm=False)


def bandwidth() -> dict[str, Any]:
    """A Sinkhorn pass against a plain copy of the same kernel, in turn."""
    from mdcs_pipeline.kernels.blocks import BOX, filled, in_cells
    from mdcs_pipeline.kernels.compiled.balance import sinkhorn_pass

    problem = problems.transport_problem(6 * problems.POINTS)
    boxes = problem.boxes()
    sites = in_cells(problem.nodes, problem.node_scale, np.zeros(problems.NODES))
    blocks = filled(boxes, sites, problem.epsilon, 1e-5, np.float32)
    kernel, copy = blocks.kernel, np.empty_like(blocks.kernel)
    where = blocks.starts, blocks.indptr, blocks.indices, BOX, boxes.mass
    out = np.ones(problems.NODES), np.empty(problems.NODES), np.empty(len(boxes.mass))
    spent: dict[str, list[float]] = {"pass": [], "copy": []}
    for _ in range(41):
        start = time.process_time()
        sinkhorn_pass(kernel, *where, *out)
        middle = time.process_time()
        np.copyto(copy, kernel)
        spent["pass"].append(middle - start)
        spent["copy"].append(time.process_time() - middle)
    one, other = (float(np.median(spent[name][1:])) for name in ("pass", "copy"))
    # The pass reads the kernel once; the copy reads and writes it.
    return {
        "entries": len(kernel),
        "kernel_mb": kernel.nbytes / 1e6,
        "pass_gb_s": kernel.nbytes / one / 1e9,
        "copy_gb_s": 2 * kernel.nbytes / other / 1e9,
        "share": kernel.nbytes / one / (2 * kernel.nbytes / other),
        "cpu": one,
    }


WORK: dict[str, Callable[..., dict[str, Any]]] = {
    "ours": lambda: solve_ours(),
    "ours-tight": lambda: solve_ours(1e-5, 1e-9),
    "pot": lambda passes: solve_pot("sinkhorn", int(passes)),
    "pot-log": lambda passes: solve_pot("sinkhorn_log", int(passes)),
    "skeleton": skeleton_ours,
    "scene": lambda times: skeleton_scene(int(times)),
    "peer": skeleton_peer,
    "bandwidth": bandwidth,
}


def main(name: str, *args: str) -> None:
    """Measure and print."""
    figures = WORK[name](*args)
    figures["process_cpu"] = cpu_time()
    print(json.dumps({k: v for k, v in figures.items() if isinstance(v, int | float)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
