"""The node's own parameters; those of the stages are named ``stage.setting``."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator

from mdcs_pipeline.errors import ConfigError, suggestion
from mdcs_pipeline.io.write import SKELETON_SUFFIXES
from mdcs_pipeline.stage import Settings

# Known when the process starts, and not for remote hands afterwards.
OF_PROCESS = ("config", "host", "autostart", "save_folder")
# Read when the node is configured.
OF_CONFIGURED = (
    "qos_reliability",
    "qos_durability",
    "qos_depth",
    "pose_type",
    "pose_tolerance",
    "sync_tolerance",
    "diagnostics_period",
    "frame_timeout",
)


class NodeSettings(Settings):
    """Parameters of the node itself."""

    config: str = Field("default", description="Shipped configuration, or path of a YAML file.")
    host: str = Field(
        "", description="Run the stages of this host alone; empty for all of the graph."
    )
    frame_timeout: float = Field(
        60.0, gt=0, description="Seconds after which a frame between hosts counts as lost."
    )
    autostart: bool = Field(False, description="Configure and activate without a manager.")
    qos_reliability: Literal["auto", "reliable", "best_effort"] = Field(
        "auto",
        description="Of clouds and poses; auto asks for reliable and takes best_effort from "
        "publishers that offer no more.",
    )
    qos_durability: Literal["volatile", "transient_local"] = Field(
        "volatile", description="Of clouds and poses; transient_local for latched clouds."
    )
    qos_depth: int = Field(5, ge=1, le=1000, description="Clouds that wait in the middleware.")
    pose_type: Literal["none", "pose_stamped", "odometry"] = Field(
        "none", description="Message on the topic pose that leads clouds into its own frame."
    )
    pose_tolerance: float = Field(
        0.1, gt=0, description="Seconds that a pose may lie from the cloud's stamp."
    )
    pose_wait: float = Field(
        0.2, ge=0, le=10, description="Seconds to wait for the pose of a cloud."
    )
    sync_tolerance: float = Field(
        0.05, gt=0, description="Seconds that clouds of several sources may lie apart."
    )
    line_width: float = Field(
        0.0, ge=0, description="Of the edges in metres; 0 for a quarter of the median radius."
    )
    node_size: float = Field(
        1.0, gt=0, le=100, description="Diameter of a node of mean mass, in median radii."
    )
    save_folder: str = Field(".", description="Where the service save puts skeletons.")
    save_name: str = Field(
        "skeleton-{stamp}.json",
        description="File in save_folder; {stamp} is the cloud's in nanoseconds.",
    )
    diagnostics_period: float = Field(1.0, gt=0, description="Seconds between diagnostics.")
    stale_after: float = Field(
        5.0, gt=0, description="Seconds without a cloud after which the input counts as stale."
    )

    @field_validator("save_name")
    @classmethod
    def _file_name(cls, value: str) -> str:
        path = PurePath(value)
        if len(path.parts) != 1 or value in (".", "..") or "\\" in value:
            raise ValueError("must be a file name without a folder")
        if path.suffix.lower() not in SKELETON_SUFFIXES:
            raise ValueError(f"must end in one of {', '.join(SKELETON_SUFFIXES)}")
        return value


def own_settings(values: dict[str, Any]) -> NodeSettings:
    """Return the settings, or raise a `ConfigError` with the name of the parameter."""
    try:
        return NodeSettings.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        fields = NodeSettings.model_fields
        if first["type"] == "extra_forbidden":
            raise ConfigError(
                f"the node has no parameter '{name}'", remedy=suggestion(name, fields)
            ) from error
        raise ConfigError(
            f"parameter '{name}': {first['msg'].lower()}",
            received=first.get("input"),
            remedy=fields[name].description if name in fields else None,
        ) from error


def changed_settings(
    held: NodeSettings, changes: dict[str, Any], *, configured: bool
) -> NodeSettings:
    """Return the settings after a change at run time.

    Raises
    ------
    ConfigError
        If a value does not fit, or a parameter cannot be changed now.
    """
    fixed = [name for name in changes if name in OF_PROCESS]
    if fixed:
        raise ConfigError(
            f"parameter '{fixed[0]}' is fixed while the node runs",
            remedy=f"start the node with -p {fixed[0]}:=…",
        )
    bound = [name for name in changes if name in OF_CONFIGURED]
    if bound and configured:
        raise ConfigError(
            f"parameter '{bound[0]}' is in use since the node was configured",
            remedy="deactivate and clean up the node first",
        )
    return own_settings({**held.model_dump(), **changes})
