"""Stage: a point cloud from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

from pydantic import Field

from mdcs_pipeline.arrays import finite_points
from mdcs_pipeline.errors import InputError
from mdcs_pipeline.io.clouds import read_points
from mdcs_pipeline.messages import Header, PointCloud
from mdcs_pipeline.stage import Settings, Stage


class ReadSettings(Settings):
    """Settings of `Read`."""

    path: Path = Field(
        description="Cloud file: .ply, .pcd, .xyz, .xyzn, .pts, .npy or .npz; a relative path "
        "counts from the working directory. Coordinates in any one unit of length."
    )
    nonfinite: Literal["drop", "refuse"] = Field(
        "drop",
        description="What to do with points that hold NaN or infinity: drop counts them in the "
        "cloud's 'dropped', refuse is an error. Depth cameras mark missing depth by NaN, "
        "hence the default.",
    )
    frame_id: str = Field(
        "",
        description="Name of the coordinate frame of the points, any text; copied to the "
        "skeleton. A cloud file names none, so it is empty by default.",
    )


class ReadResult(NamedTuple):
    """Output of `Read`."""

    cloud: PointCloud


class Read(Stage[ReadSettings]):
    """Read one cloud file."""

    Settings = ReadSettings

    def __call__(self) -> ReadResult:
        """Return the cloud of the file.

        Raises
        ------
        InputError
            If the file cannot be read or holds no finite point.
        MissingExtraError
            If the format needs Open3D, and that is not installed.
        """
        path = self.settings.path
        read = read_points(path)
        try:
            points, dropped = finite_points(read, self.settings.nonfinite)
        except InputError as error:
            raise error.located(str(path)) from error
        if not len(points):
            raise InputError("all points hold NaN or infinity", where=str(path), received=dropped)
        header = Header(frame_id=self.settings.frame_id)
        return ReadResult(PointCloud(points, header=header, dropped=dropped))
