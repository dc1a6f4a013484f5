"""Messages: the frozen, validated values that travel between stages.

`PointCloud` and `Skeleton` are in the user's units and frame. What lies between
them (`MassCloud`, `Nodes`, `TransportPlan`, `RoughSkeleton`) is in the unit frame
of the cloud, where the method's ε has its meaning; `MassCloud.unit` leads back.
"""

from __future__ import annotations

from mdcs_pipeline.clouds import Known, MassCloud, PointCloud, Surface, Thickness, UnitFrame
from mdcs_pipeline.header import Header
from mdcs_pipeline.plans import Nodes, RoughSkeleton, TransportPlan
from mdcs_pipeline.skeleton import Skeleton

__all__ = [
    "Header",
    "Known",
    "MassCloud",
    "Nodes",
    "PointCloud",
    "RoughSkeleton",
    "Skeleton",
    "Surface",
    "Thickness",
    "TransportPlan",
    "UnitFrame",
]
