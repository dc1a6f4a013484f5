"""Local thickness: where a growing patch of the surface closes into a tube.

The middle eigenvalue λ2 of the covariance of a geodesic ball of radius s is s²/4 on a sheet.
Once the ball reaches around a tube of radius r, at s = π r, it stays near r²/2, which is
0.05 s² and falling. So λ2 ≤ γ s² with γ a little above that tells a tube from a sheet, and
√(2 λ2) is the tube's radius, whatever the sampling density.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.kernels.coarsening import coarsened
from mdcs_pipeline.kernels.compiled.grid import grid_of, scattered
from mdcs_pipeline.kernels.compiled.patches import WIDER, closing_patches
from mdcs_pipeline.kernels.compiled.spreading import spread_minimum
from mdcs_pipeline.kernels.compiled.tangent import ANY, medians_alike
from mdcs_pipeline.kernels.seeding import spread_points

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# How much farther apart the points of a coarser graph are.
_COARSER = 2.0
# Links that a patch in it must be wide to be believed, and those of the smallest that is tried.
_LINKS, _LEAST = 6.0, 4.0
# Points up to which there is no need for one; and points times patches: it has to pay for
# being made.
_FEW, _LITTLE = 1500, 600_000


class LocalRadius(NamedTuple):
    """Thickness of a shape at its points.

    Parameters
    ----------
    radius : (n,) float64
    confidence : (n,) float64
        Falls from 1 with the distance, in radii, to the landmark that the value came from.
    centre : (n, 3) float64
        Centre of mass of the closed patch that the value came from: near the axis.
    """

    radius: FloatArray
    confidence: FloatArray
    centre: FloatArray


def local_radius(
    points: FloatArray,
    mass: FloatArray,
    graph: sparse.csr_array,
    landmarks: int,
    closed: float,
    slope: float,
    seed: int,
    known: tuple[BoolArray, FloatArray] | None = None,
) -> LocalRadius:
    """Return half the local width of the shape at every point.

    Parameters
    ----------
    points : (n, 3) float64
    mass : (n,) float64
    graph : csr_array, (n, n)
        Distances between neighbours.
    landmarks : int
        Points, far from each other, at which patches are grown.
    closed : float
        γ.
    slope : float
        The radius grows at most by this for every unit of geodesic distance.
    seed : int
        Chooses the first landmark.
    known : pair of (n,) bool and (n,) float64, optional
        Points that the radius is asked for, and the radius of the others: landmarks are only
        spread over the first, as many of them as these are of all points.

    Returns
    -------
    LocalRadius
    """
    asked = np.ones(len(points), dtype=bool) if known is None else known[0]
    if known is not None and not asked.any():
        return LocalRadius(known[1].copy(), np.ones(len(points)), points.copy())
    places = np.flatnonzero(asked)
    most = min(-(-landmarks * len(places) // len(points)), len(places))
    sources = places[spread_points(points[places], most, seed)]
    spacing = float(np.median(graph.data))
    radii = np.geomspace(4.0 * spacing, max(1.5, 8.0 * spacing), 40)
    scale, _, centre = _closed(points, mass, graph, sources, radii, closed)
    # A cloud thinner than its sampling (a line of points) still needs a length to measure by.
    scale = np.maximum(scale, spacing)
    values = np.full(len(points), np.inf)
    values[sources] = _median_within(points[sources], scale)
    radius, carried, origin = spread_minimum(graph.indptr, graph.indices, graph.data, values, slope)
    # Parts of the graph without a landmark.
    lost = ~np.isfinite(radius)
    radius[lost] = np.median(scale)
    confidence = np.where(lost, 0.0, 1.0 / (1.0 + carried / radius))
    middle = points.copy()
    middle[sources] = centre
    middle = np.where(lost[:, None], points, middle[origin])
    # The middle of a patch that closed around more than this limb is inside none.
    far = np.linalg.norm(middle - points, axis=1) > 2.0 * radius
    middle[far] = points[far]
    if known is not None:
        radius = np.where(asked, radius, known[1])
    return LocalRadius(radius, confidence, middle)


def _closed(
    points: FloatArray,
    mass: FloatArray,
    graph: sparse.csr_array,
    sources: IntArray,
    radii: FloatArray,
    closed: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return √(2 λ2), radius and centre of the patch around each source that first closes.

    Patches are grown in a coarser graph first, and in this one where they are few links wide
    there: what they cost is bounded by the shape, not by how densely it is sampled.
    """
    where = graph.indptr, graph.indices, graph.data, points, mass
    spacing = float(np.median(graph.data)) if graph.nnz else np.inf
    few = len(points) <= _FEW or len(points) * len(sources) <= _LITTLE
    if few or radii[-1] < 2.0 * _LINKS * _COARSER * spacing:
        return closing_patches(*where, sources, radii, closed)
    coarse = coarsened(points, mass, graph, _COARSER * spacing)
    apart = float(np.median(coarse.graph.data)) if coarse.graph.nnz else np.inf
    # The smallest patches would be of a few points there.
    wide = radii[radii >= _LEAST * apart]
    if not len(wide):
        return closing_patches(*where, sources, radii, closed)
    rough = coarse.points, coarse.mass, coarse.graph, coarse.into[sources]
    scale, reach, centre = _closed(*rough, wide, closed)
    # Nor does a part that is a few links wide as a whole close there.
    thin = np.flatnonzero((reach <= _LINKS * apart) | np.isinf(reach))
    near = radii[radii <= _LINKS * apart]
    found = closing_patches(*where, sources[thin], near, closed, False)
    known = found[1] != WIDER
    for held, better in zip((scale, reach, centre), found, strict=True):
        held[thin[known]] = better[known]
    return scale, reach, centre


def _median_within(places: FloatArray, scale: FloatArray) -> FloatArray:
    """Return, at every landmark, the median of the values within its own radius."""
    grid = grid_of(places, float(np.median(scale)))
    values = scale[grid.order]
    facing = np.zeros((len(values), 3))
    return scattered(grid, medians_alike(grid, facing, values, values, ANY))
