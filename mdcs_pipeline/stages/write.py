"""Stage: a skeleton into a file."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator

from mdcs_pipeline.ingest import given_cloud
from mdcs_pipeline.io.write import SKELETON_SUFFIXES, write_skeleton
from mdcs_pipeline.messages import PointCloud, Skeleton
from mdcs_pipeline.stage import Settings, Stage


class WriteSettings(Settings):
    """Settings of `Write`."""

    path: Path = Field(
        description="File to write; its suffix names the format: .json, .ply, .graphml, .npz, "
        ".swc (only without loops), .png or .html. A relative path counts from the working "
        "directory; the folder must exist. Coordinates in the unit of the input."
    )

    @field_validator("path")
    @classmethod
    def _known(cls, path: Path) -> Path:
        # Found here, a wrong suffix costs no run.
        if path.suffix.lower() not in SKELETON_SUFFIXES:
            raise ValueError("the suffix must be one of " + ", ".join(SKELETON_SUFFIXES))
        return path


class Write(Stage[WriteSettings]):
    """Write the skeleton in the format that the suffix of the path names."""

    Settings = WriteSettings

    def __call__(self, skeleton: Skeleton, cloud: PointCloud | None = None) -> None:
        """Write the file; pictures and pages show the cloud behind the skeleton.

        Raises
        ------
        OutputError
            If it cannot be written; then no file is left, and an older one is kept.
        MissingExtraError
            If a picture or page is asked for without the extra ``draw``.
        """
        positions = None if cloud is None else given_cloud(cloud).positions
        write_skeleton(skeleton, self.settings.path, cloud=positions)
