"""ROS parameters of a node and of its stages: declared, checked, changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from mdcs_pipeline.errors import ConfigError, MdcsError, suggestion
from mdcs_pipeline.graph import Graph

from ..host import Host, describe, is_place
from .settings import OF_PROCESS, NodeSettings, changed_settings, own_settings

# Declared by rclpy itself.
_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class Parameters:
    """The parameters of one node.

    Parameters without a dot are the node's own, those with one are settings of stages. All
    are of dynamic type: 1 is as good as 1.0, and the settings themselves say what fits.

    Parameters
    ----------
    node : Node
        Made with ``automatically_declare_parameters_from_overrides``, so that what was
        given on the command line is known before it is declared.
    defaults : dict
        Of the node's own parameters, under what the command line says.
    configured : callable
        Whether the node is past its configuration.

    Attributes
    ----------
    on_change : callable, optional
        Hears of the graph after a change of its settings.

    Raises
    ------
    ConfigError
        If what was given on the command line is unknown or does not fit.
    """

    def __init__(
        self, node: Node, defaults: dict[str, Any], configured: Callable[[], bool]
    ) -> None:
        self._node = node
        self._configured = configured
        given = self._given()
        plain = {name: value for name, value in given.items() if "." not in name}
        dotted = {name: value for name, value in given.items() if "." in name}
        self.on_change: Callable[[Graph], None] | None = None
        self.own: NodeSettings = own_settings({**defaults, **plain})
        self.host = Host(self.own.config)
        self._check_known(dotted)
        self.host.start_with(dotted)
        self._declare()
        node.add_on_set_parameters_callback(self._checked)
        node.add_post_set_parameters_callback(self._apply)

    def _given(self) -> dict[str, Any]:
        held = self._node.get_parameters_by_prefix("")
        return {
            name: parameter.value
            for name, parameter in held.items()
            if not name.startswith(_OF_ROS)
        }

    def _check_known(self, dotted: Iterable[str]) -> None:
        known = self.host.settings()
        for name in dotted:
            if name not in known:
                raise ConfigError(
                    f"{self.host.spec.name} has no setting '{name}'",
                    where=f"parameter '{name}'",
                    remedy=suggestion(name, known),
                )

    def _declare(self) -> None:
        for name, field in NodeSettings.model_fields.items():
            fixed = name in OF_PROCESS
            self._declare_one(name, getattr(self.own, name), field.description or "", fixed)
        graph = self.host.graph
        for name, value in self.host.settings().items():
            self._declare_one(name, value, describe(name, graph), is_place(name, graph))

    def _declare_one(self, name: str, value: Any, description: str, fixed: bool) -> None:
        if self._node.has_parameter(name):
            self._node.undeclare_parameter(name)
        # Not read_only: the reason given by rclpy then says nothing about what to do.
        limits = "fixed while the node runs" if fixed else ""
        descriptor = ParameterDescriptor(
            description=description, additional_constraints=limits, dynamic_typing=True
        )
        self._node.declare_parameter(name, value, descriptor, ignore_override=True)

    def _checked(self, parameters: list[Parameter]) -> SetParametersResult:
        own, dotted = _split(parameters)
        try:
            if own:
                changed_settings(self.own, own, configured=self._configured())
            if dotted:
                self.host.check(dotted)
        except MdcsError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        own, dotted = _split(parameters)
        if own:
            self.own = own_settings({**self.own.model_dump(), **own})
        if dotted:
            self.host.change(dotted)
            if self.on_change is not None:
                self.on_change(self.host.graph)


def _split(parameters: list[Parameter]) -> tuple[dict[str, Any], dict[str, Any]]:
    ours = {p.name: p.value for p in parameters if not p.name.startswith(_OF_ROS)}
    own = {name: value for name, value in ours.items() if "." not in name}
    return own, {name: value for name, value in ours.items() if "." in name}
