"""Medial places: the centre of the limb, seen from each point of its surface.

A point of a tube lies on a ball around the axis that touches the surface all around. That ball
is known from the point, its normal, and whatever other points it meets: half a shell shows it
as well as a whole one, and two shells that no surface joins show the same one. So mass that is
carried from the balls' centres, y − r n, instead of from the points y themselves, meets on the
axis: E‖x − y‖² over a ring is ‖x − c‖² + r², and c is all of it that depends on x.

Neighbours on one limb have their places on one line, its axis: where the places scatter about
their line they say nothing, whatever the reason (noise, a patch that reaches around its limb or
across a gap), and points stay where they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.balls import limb_balls
from mdcs_pipeline.kernels.compiled.grid import standing_for
from mdcs_pipeline.kernels.compiled.linking import within_limbs
from mdcs_pipeline.kernels.places import Medial, MedialRule, Remembered

__all__ = ["Medial", "MedialRule", "Remembered", "medial_places", "without_gaps"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# A gap between places of different times, in that between places of one.
_STALE = 2.0


def medial_places(
    points: FloatArray,
    mass: FloatArray,
    graph: sparse.csr_array,
    radius: FloatArray,
    rule: MedialRule,
    known: Remembered | None = None,
) -> Medial:
    """Return each point's medial place, and its distance from the surface.

    Parameters
    ----------
    points : (n, 3) float64
    mass : (n,) float64
    graph : csr_array, (n, n)
        Neighbours along the surface; they agree on what is outside.
    radius : (n,) float64
        First estimate of the local radius, positive.
    rule : MedialRule
    known : Remembered, optional
        What need not be measured again; it stays, and is what its neighbours are judged by.

    Returns
    -------
    Medial
    """
    if known is None:
        known = _nothing_known(points)
    if not known.asked.any():
        return known.balls
    chosen, stands = standing_for(points, rule.coarse * radius)
    held = np.bincount(stands, mass).astype(np.float64)
    # What stands for a point that is asked for is measured.
    asked = np.bincount(stands, known.asked) > 0
    before = Remembered(asked, known.balls.rows(chosen))
    found = limb_balls(points[chosen], held, graph, stands, radius[chosen], rule, before)
    trust = found.trust[stands]
    new = known.asked
    return Medial(
        _where(new, points + trust[:, None] * (found.places[stands] - points), known.balls.places),
        _where(new, radius + trust * (found.radius[stands] - radius), known.balls.radius),
        _where(new, trust, known.balls.trust),
        _where(new, found.normals[stands], known.balls.normals),
    )


def _nothing_known(points: FloatArray) -> Remembered:
    n, none = len(points), np.zeros((len(points), 3))
    return Remembered(np.ones(n, dtype=bool), Medial(none, np.zeros(n), np.zeros(n), none))


def _where(asked: BoolArray, found: FloatArray, known: FloatArray) -> FloatArray:
    return np.where(asked[:, None] if found.ndim > 1 else asked, found, known)


def without_gaps(
    graph: sparse.csr_array,
    points: FloatArray,
    found: Medial,
    gap: float,
    known: Remembered | None = None,
) -> sparse.csr_array:
    """Return the graph without links through the air between two limbs.

    Along a limb two neighbours' medial places are as far apart as they are themselves; across a
    gap each has its own on the far side.

    Parameters
    ----------
    graph : csr_array, (n, n)
    points : (n, 3) float64
    found : Medial
    gap : float
        How much farther apart medial places may be than their points, in the smaller radius.
    known : Remembered, optional
        What was not measured now: places from different times lie about their line with less
        care, so it takes twice the gap.

    Returns
    -------
    csr_array, (n, n)
    """
    asked = True if known is None else known.asked
    gaps = np.where(asked, gap, _STALE * gap) * np.ones(len(points))
    kept, rows = within_limbs(
        graph.indptr, graph.indices, points, found.places, found.radius, found.trust, gaps
    )
    return sparse.csr_array((graph.data[kept], graph.indices[kept], rows), graph.shape)
