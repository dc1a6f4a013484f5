"""Voxel means of a cloud."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import Field

from mdcs_pipeline.errors import InputError
from mdcs_pipeline.ingest import given_cloud
from mdcs_pipeline.kernels.canonical import CanonicalFrame, framed
from mdcs_pipeline.kernels.voxels import voxel_means
from mdcs_pipeline.messages import PointCloud, UnitFrame
from mdcs_pipeline.stage import Settings, Stage

# Squares of coordinates, and of their differences, must be numbers that a float64 can hold.
_SMALLEST, _LARGEST = 1e-140, 1e140


class DownsampleSettings(Settings):
    """Settings of `Downsample`."""

    voxel: float = Field(
        0.008,
        gt=0,
        le=0.5,
        description="Edge of a voxel in unit lengths (about the diagonal of the cloud); a "
        "quarter of √ε by default, so that a point stands for less than the kernel sees.",
    )
    voxel_size: float | None = Field(
        None, gt=0, description="Edge of a voxel in input units; replaces `voxel` when given."
    )


class Downsampled(NamedTuple):
    """Output of `Downsample`."""

    cloud: PointCloud


class Downsample(Stage[DownsampleSettings]):
    """Replace the points of each voxel by their centroid, weighted by their count."""

    Settings = DownsampleSettings

    def __call__(self, cloud: PointCloud) -> Downsampled:
        """Return the centroids in the order of the voxels; their weights keep the total.

        The grid lies along the cloud's own axes, so that the result moves with the cloud.

        Raises
        ------
        InputError
            If the cloud is empty, all its points coincide, or the voxels are too many to count.
        """
        cloud = given_cloud(cloud)
        unit = unit_frame(cloud)
        size = voxel_edge(self.settings.voxel, self.settings.voxel_size, unit)
        try:
            voxels = voxel_means(
                cloud.positions,
                cloud.weights,
                size,
                CanonicalFrame(unit.centre, unit.axes, unit.length),
            )
        except ValueError as error:
            raise InputError(
                str(error),
                received=f"voxel {size:.3g} unit lengths",
                remedy="take a larger voxel, or remove far outliers first",
            ) from error
        positions = unit.from_unit(voxels.centroids)
        return Downsampled(PointCloud(positions, voxels.weights, cloud.header, cloud.dropped))


def voxel_edge(voxel: float, voxel_size: float | None, unit: UnitFrame) -> float:
    """Return the edge of a voxel in unit lengths, from one in these or else in input units."""
    return voxel if voxel_size is None else voxel_size / unit.length


def unit_frame(cloud: PointCloud) -> UnitFrame:
    """Return the frame in which the cloud is centred, along its axes and of unit size.

    Raises
    ------
    InputError
        If the cloud is empty, all its points coincide, or it is too large or small to square.
    """
    if not len(cloud):
        raise InputError(
            "the cloud is empty",
            received=f"0 points, {cloud.dropped} dropped as not finite",
            remedy="check the source",
        )
    frame, size = framed(cloud.positions, cloud.weights)
    if size > _LARGEST:
        raise _out_of_range(size)
    # Where the spread is only the round-off of large coordinates there is no shape to measure.
    if frame.length <= 1e-12 * size or frame.length == 0.0:
        raise InputError(
            "all points coincide",
            received=f"{len(cloud)} points within {frame.length:.3g} of each other",
            remedy="a skeleton needs a shape with an extent",
        )
    if frame.length < _SMALLEST:
        raise _out_of_range(frame.length)
    return UnitFrame(*frame)


def _out_of_range(size: float) -> InputError:
    return InputError(
        f"the cloud's size must lie between {_SMALLEST:g} and {_LARGEST:g}",
        received=f"{size:.3g}",
        remedy="take another unit of length",
    )
