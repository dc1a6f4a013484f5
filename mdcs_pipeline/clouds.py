"""Messages about points: clouds, their unit frame, their surface and its thickness."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mdcs_pipeline.arrays import (
    FloatArray,
    finite_array,
    frozen_matrix,
    masses,
    points_array,
    set_fields,
)
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.header import Header


@dataclass(frozen=True, eq=False)
class PointCloud:
    """A point cloud in the user's units and frame.

    Parameters
    ----------
    positions : (N, 3) float32 or float64
        Coordinates; other numeric types become float64. Finite.
    weights : (N,) float64, optional
        How many measured points each point stands for; all 1 when absent.
    header : Header
    dropped : int
        Points left out on the way in because a coordinate was not finite.
    """

    positions: FloatArray
    weights: NDArray[np.float64] | None = None
    header: Header = field(default_factory=Header)
    dropped: int = 0

    def __post_init__(self) -> None:
        positions = points_array(self.positions, "positions")
        set_fields(self, positions=finite_array(positions, (None, 3), "positions", positions.dtype))
        if self.weights is not None:
            weights = finite_array(self.weights, (len(positions),), "weights")
            if len(weights) and weights.min() <= 0:
                raise InputError("weights must be positive", received=f"minimum {weights.min()}")
            set_fields(self, weights=weights)

    def __len__(self) -> int:
        return len(self.positions)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"points": len(self)}

    def to_open3d(self, tensor: bool = False) -> Any:
        """Return the points as a cloud of Open3D, in memory of its own.

        Parameters
        ----------
        tensor : bool
            For an `open3d.t.geometry.PointCloud`, which keeps float32; otherwise an
            `open3d.geometry.PointCloud`, which holds float64.

        Raises
        ------
        MissingExtraError
            Without the extra open3d or open3d-cpu.
        """
        from mdcs_pipeline.io.open3d_bridge import cloud_of

        return cloud_of(self.positions, tensor)


@dataclass(frozen=True, eq=False)
class UnitFrame:
    """The similarity that takes the user's frame to the cloud's unit frame.

    Parameters
    ----------
    centre : (3,) float64
        Origin of the unit frame, in input units.
    axes : (3, 3) float64
        Its axes as rows, a right-handed orthonormal basis.
    length : float
        Input units per unit length.
    """

    centre: NDArray[np.float64]
    axes: NDArray[np.float64]
    length: float

    def __post_init__(self) -> None:
        axes = finite_array(self.axes, (3, 3), "axes")
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-9) or np.linalg.det(axes) < 0:
            raise InputError("axes must be orthonormal, right-handed", received=axes.tolist())
        if not (np.isfinite(self.length) and self.length > 0):
            raise InputError("length must be positive", received=self.length)
        set_fields(self, centre=finite_array(self.centre, (3,), "centre"), axes=axes)

    def to_unit(self, points: FloatArray) -> NDArray[np.float64]:
        """Map (N, 3) points of the user's frame into the unit frame."""
        return np.ascontiguousarray(((points - self.centre) / self.length) @ self.axes.T)

    def from_unit(self, points: FloatArray) -> NDArray[np.float64]:
        """Map (N, 3) points of the unit frame back to the user's."""
        return np.ascontiguousarray((points @ self.axes) * self.length + self.centre)


@dataclass(frozen=True, eq=False)
class MassCloud:
    """The measure ν of section IV.A: points with mass, in the unit frame.

    Parameters
    ----------
    positions : (n, 3) float64
        y_j in the unit frame.
    mass : (n,) float64
        ϱ_j, positive, sum 1.
    unit : UnitFrame
        Leads back to input units.
    header : Header
    """

    positions: NDArray[np.float64]
    mass: NDArray[np.float64]
    unit: UnitFrame
    header: Header = field(default_factory=Header)

    def __post_init__(self) -> None:
        positions = finite_array(self.positions, (None, 3), "positions")
        set_fields(self, positions=positions, mass=masses(self.mass, len(positions)))

    def __len__(self) -> int:
        return len(self.positions)

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"points": len(self)}


@dataclass(frozen=True, eq=False)
class Surface:
    """Which points of a cloud are neighbours on the shape, and how far apart.

    Parameters
    ----------
    positions : (n, 3) float64
        The cloud's points, freed of some of their noise, in the unit frame.
    graph : scipy.sparse.csr_array, (n, n)
        Symmetric; distances between neighbours in unit lengths.
    """

    positions: NDArray[np.float64]
    graph: sparse.csr_array

    def __post_init__(self) -> None:
        positions = finite_array(self.positions, (None, 3), "positions")
        if self.graph.shape != (len(positions),) * 2:
            raise InputError(
                f"the graph must have one row for each of {len(positions)} points",
                received=f"shape {self.graph.shape}",
            )
        lengths = finite_array(self.graph.data, (None,), "graph")
        if len(lengths) and lengths.min() <= 0:
            raise InputError("distances must be positive", received=f"minimum {lengths.min()}")
        set_fields(self, positions=positions, graph=frozen_matrix(self.graph))

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"links": self.graph.nnz // 2}


@dataclass(frozen=True, eq=False)
class Thickness:
    """The local scale of a shape: half its width around each point.

    Parameters
    ----------
    radius : (n,) float64
        r_j in unit lengths, positive.
    confidence : (n,) float64
        In [0, 1]: 1 where the patch around a point was seen to close into a tube, less the
        farther the value was carried over the surface.
    centre : (n, 3) float64, optional
        Centre of the closed patch that r_j came from, near the axis, in the unit frame.
    trust : (n,) float64, optional
        In [0, 1]: how far the centre is believed to be a medial place.
    normal : (n, 3) float64, optional
        Where the outside is, of length 1.
    """

    radius: NDArray[np.float64]
    confidence: NDArray[np.float64]
    centre: NDArray[np.float64] | None = None
    trust: NDArray[np.float64] | None = None
    normal: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        radius = finite_array(self.radius, (None,), "radius")
        if len(radius) and radius.min() <= 0:
            raise InputError("radius must be positive", received=f"minimum {radius.min()}")
        confidence = finite_array(self.confidence, (len(radius),), "confidence")
        set_fields(self, radius=radius, confidence=confidence)
        if self.centre is not None:
            set_fields(self, centre=finite_array(self.centre, (len(radius), 3), "centre"))
        if self.trust is not None:
            set_fields(self, trust=finite_array(self.trust, (len(radius),), "trust"))
        if self.normal is not None:
            set_fields(self, normal=finite_array(self.normal, (len(radius), 3), "normal"))

    @cached_property
    def _typical(self) -> float:
        # Asked for with every stage that hands the thickness on.
        return float(np.median(self.radius)) if len(self.radius) else 0.0

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"radius": self._typical}


@dataclass(frozen=True, eq=False)
class Known:
    """What was measured of a cloud before, and which of its points are to be measured now.

    Parameters
    ----------
    asked : (n,) bool
        Points to measure. What is said of them here is of no meaning.
    radius : (n,) float64
        In unit lengths; positive where nothing is asked.
    middle : (n, 3) float64
        Medial places.
    trust : (n,) float64
        In [0, 1]: how far these were believed.
    normal : (n, 3) float64
        Where the outside is, of length 1.
    """

    asked: NDArray[np.bool_]
    radius: NDArray[np.float64]
    middle: NDArray[np.float64]
    trust: NDArray[np.float64]
    normal: NDArray[np.float64]

    def __post_init__(self) -> None:
        asked = finite_array(self.asked, (None,), "asked", np.bool_)
        count = len(asked)
        radius = finite_array(self.radius, (count,), "radius")
        if (radius[~asked] <= 0).any():
            raise InputError(
                "the radius of points that are not asked for must be positive",
                received=f"minimum {radius[~asked].min()}",
            )
        set_fields(
            self,
            asked=asked,
            radius=radius,
            middle=finite_array(self.middle, (count, 3), "middle"),
            trust=finite_array(self.trust, (count,), "trust"),
            normal=finite_array(self.normal, (count, 3), "normal"),
        )

    def summary(self) -> dict[str, Any]:
        """Return the figures that a progress line shows."""
        return {"measured": int(np.count_nonzero(self.asked))}
