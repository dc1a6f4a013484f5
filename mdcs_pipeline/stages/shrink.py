"""Rough skeletons with several nodes made one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from mdcs_pipeline.arrays import IntArray
from mdcs_pipeline.kernels.links import unique_pairs
from mdcs_pipeline.messages import RoughSkeleton


def gathered(rough: RoughSkeleton, into: IntArray) -> RoughSkeleton:
    """Return the skeleton with nodes made one: masses and plan add, at their centre of mass.

    It is as thick as the thickest of them. One that is fixed stays where and as thick as it is.

    Parameters
    ----------
    rough : RoughSkeleton
    into : (m,) int64
        Which node each one becomes, the first of those that become one.

    Returns
    -------
    RoughSkeleton
    """
    if np.array_equal(into, np.arange(len(into))):
        return rough
    nodes, plan = rough.nodes, rough.plan
    kept, group = np.unique(into, return_inverse=True)
    count = len(kept)
    ones = np.ones(len(into))
    member = sparse.csr_array((ones, (np.arange(len(into)), group)), shape=(len(into), count))
    mass = np.bincount(group, nodes.mass, minlength=count).astype(np.float64)
    # Nodes that carry nothing still meet somewhere.
    weight = np.where(mass[group] > 0, nodes.mass, 1.0)
    total = np.bincount(group, weight, minlength=count)
    moments = [np.bincount(group, weight * x, minlength=count) for x in nodes.positions.T]
    scale = np.zeros(count)
    np.maximum.at(scale, group, nodes.scale)
    fixed = nodes.fixed[kept]
    positions = np.stack(moments, axis=1) / total[:, None]
    positions[fixed] = nodes.positions[kept][fixed]
    scale[fixed] = nodes.scale[kept][fixed]
    one = replace(
        nodes,
        positions=positions,
        mass=mass,
        potentials=nodes.potentials[kept],
        ids=nodes.ids[kept],
        links=unique_pairs(group[nodes.links]),
        settled=nodes.settled[kept],
        fixed=fixed,
        beyond=nodes.beyond[kept],
        scale=scale,
    )
    served = replace(plan, nodes=one, plan=sparse.csr_array(plan.plan @ member))
    return RoughSkeleton(served, unique_pairs(group[rough.edges]), rough.skeletal[kept])
