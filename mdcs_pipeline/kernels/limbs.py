"""Mass that pieces of limbs explain: transport from points to blurred tubes.

Of a piece of limb with axis a, radius r and noise σ in all directions, points lie at a distance d
from the axis and at z along it with the density

    k(d, z) = exp(−(d² + r²)/2σ²) I₀(d r/σ²)/σ² · exp(−z²/2ℓ²)/ℓ,

a cylinder's that a Gaussian has blurred, up to a factor. Entropic transport of the points' mass m_j
to pieces i at the cost −log k_ji, with free masses π_i (as `transport` has them, ε = 1), turns

    π_i ← Σ_j m_j π_i k_ji / Σ_h π_h k_jh,

and ends with the π of greatest likelihood. It is sparse: a piece between two limbs, whose points
their own limbs explain better, loses its mass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree
from scipy.special import i0e

__all__ = ["BLUR", "Pieces", "blurred_tubes", "explained_mass"]

FloatArray = NDArray[np.float64]

#: Noise that pieces are taken to have, in their radius, where a cloud is noisy.
BLUR = 0.42
# Standard deviations beyond which a piece explains nothing.
_FARTHEST = 2.5


class Pieces(NamedTuple):
    """Short pieces of limbs.

    Parameters
    ----------
    places : (m, 3) float64
        Their centres.
    axes : (m, 3) float64
        Of length 1; the sign means nothing.
    radius : (m,) float64
    """

    places: FloatArray
    axes: FloatArray
    radius: FloatArray


def blurred_tubes(
    points: FloatArray, pieces: Pieces, blur: float, length: float
) -> sparse.csr_array:
    """Return the density k of each piece at the points near it, (n, m).

    Parameters
    ----------
    points : (n, 3) float64
    pieces : Pieces
    blur : float
        σ, in the radius.
    length : float
        ℓ, in the radius.
    """
    reach = pieces.radius * (1.0 + _FARTHEST * blur)
    around = cKDTree(points).query_ball_point(pieces.places, reach)
    i = np.repeat(np.arange(len(reach)), [len(near) for near in around])
    j = np.concatenate([np.empty(0, np.int64), *(np.asarray(near, np.int64) for near in around)])
    gap, radius = points[j] - pieces.places[i], pieces.radius[i]
    along = (gap * pieces.axes[i]).sum(axis=1)
    away = np.sqrt(np.maximum((gap * gap).sum(axis=1) - along * along, 0.0))
    sigma, half = blur * radius, length * radius
    # I₀ scaled by its own growth, which the square completes.
    ring = np.exp(-0.5 * ((away - radius) / sigma) ** 2) * i0e(away * radius / sigma**2)
    density = ring / sigma**2 * np.exp(-0.5 * (along / half) ** 2) / half
    near = np.abs(along) <= _FARTHEST * half
    shape = len(points), len(reach)
    return sparse.csr_array((density[near], (j[near], i[near])), shape=shape)


def explained_mass(
    density: sparse.csr_array, mass: FloatArray, turns: int, held: FloatArray | None = None
) -> FloatArray:
    """Return π, the mass that each piece explains.

    Parameters
    ----------
    density : csr_array, (n, m)
    mass : (n,) float64
        Of the points; what no piece is near to goes nowhere.
    turns : int
    held : (m,) float64, optional
        Masses to start from; equal ones without. A piece of none stays at none.

    Returns
    -------
    (m,) float64
    """
    back = sparse.csr_array(density.T)
    if held is None:
        held = np.full(density.shape[1], mass.sum() / max(density.shape[1], 1))
    for _ in range(turns):
        whole = density @ held
        part = np.divide(mass, whole, out=np.zeros_like(whole), where=whole > 0)
        held = held * (back @ part)
    return np.asarray(held, dtype=np.float64)
