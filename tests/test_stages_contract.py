"""One contract over every registered stage: settings, ports, and what a call may and may not do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import annotated_types
import numpy as np
import pytest
import shapes
from pydantic import ValidationError
from pydantic_core import PydanticUndefined
from scipy import sparse

from mdcs_pipeline.config import load_spec
from mdcs_pipeline.errors import ConfigError
from mdcs_pipeline.graph import build_graph
from mdcs_pipeline.messages import Header, MassCloud, Nodes, PointCloud, Skeleton, TransportPlan
from mdcs_pipeline.stage import Stage, input_ports, output_ports, stage_class, stage_names

HEADER = Header("map", 7_000_000_000, 3)
CONFIGS = ("default", "paper", "streaming")
#: For a map in which 600 points are a surface.
SETTINGS: dict[str, dict[str, Any]] = {
    "streaming": {"scene.voxel": 0.03, "scene.least_hits": 1, "scene.speck": 5}
}
#: Stages that only a scene has a use for.
SCENIC = {"scene", "recall", "newborn", "splice"}
#: Stages whose settings have no default, with the file that they are given.
FILES = {"read": "cloud.npy", "write": "skeleton.json"}

Messages = dict[type, Any]


def followed(config: str) -> Messages:
    """Return an example of every message that a small cloud gives on its way through a config."""
    graph = build_graph(load_spec(config, SETTINGS.get(config, {})))
    messages: Messages = {
        PointCloud: PointCloud(shapes.y(600, 1), np.linspace(0.5, 2, len(shapes.y(600, 1))), HEADER)
    }
    states = {stage.State: stage.State() for stage in graph.stages.values() if stage.State}
    for name in graph.order:
        stage = graph.stages[name]
        if stage.State:
            # A stage that remembers is shown what was remembered when its turn came.
            messages[type(stage)] = deepcopy(states[stage.State])
        state = {"state": states[stage.State]} if stage.State else {}
        returned = stage(**taken(stage, messages), **state)
        outputs = {} if returned is None else returned._asdict()
        messages.update((type(value), value) for value in outputs.values() if value is not None)
    return messages


def call(stage: Stage[Any], messages: Messages) -> dict[str, Any]:
    """Return what a stage gives for the example messages, by output port."""
    state = {"state": deepcopy(messages[type(stage)])} if stage.State else {}
    returned = stage(**taken(stage, messages), **state)
    return {} if returned is None else returned._asdict()


def taken(stage: Stage[Any], messages: Messages) -> dict[str, Any]:
    """Return the examples for a stage's input ports."""
    given: dict[str, Any] = {}
    for name, port in input_ports(type(stage)).items():
        if port.type not in messages and not port.optional:
            pytest.fail(f"no example of {port.type.__name__} for {type(stage).__name__}.{name}")
        example = messages.get(port.type)
        given[name] = (example, example) if port.many else example
    return given


@pytest.fixture(scope="module")
def examples() -> dict[str, Messages]:
    return {config: followed(config) for config in CONFIGS}


def cases() -> list[tuple[str, str]]:
    """Return (stage, whose settings): the stage's own defaults, and those of each config."""
    found = [(name, "own") for name in stage_names()]
    for config in CONFIGS:
        found += [(name, config) for name in load_spec(config, {}).stages]
    return found


@pytest.fixture
def case(
    request: pytest.FixtureRequest, examples: dict[str, Messages], tmp_path: Path
) -> tuple[Stage[Any], Messages]:
    name, whose = request.param
    if whose == "own":
        return made(name, tmp_path), examples["streaming" if name in SCENIC else "default"]
    spec = load_spec(whose, SETTINGS.get(whose, {})).stages[name]
    return stage_class(spec.stage)(**spec.settings), examples[whose]


def made(name: str, folder: Path) -> Stage[Any]:
    if name not in FILES:
        return stage_class(name)()
    path = folder / FILES[name]
    if name == "read":
        np.save(path, shapes.y(600, 1))
        return stage_class(name)(path=path, frame_id=HEADER.frame_id)
    return stage_class(name)(path=path)


each_stage = pytest.mark.parametrize("name", stage_names())
each_case = pytest.mark.parametrize(
    "case", cases(), indirect=True, ids=lambda case: f"{case[0]}-{case[1]}"
)


# --- what a message is made of


def parts(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the leaves of a message, arrays and plain values, with their place in it."""
    if isinstance(value, sparse.sparray):
        for name in ("data", "indices", "indptr"):
            yield f"{path}.{name}", getattr(value, name)
    elif is_dataclass(value):
        for item in fields(value):
            yield from parts(getattr(value, item.name), f"{path}.{item.name}")
    elif isinstance(value, Mapping):
        for name, held in value.items():
            yield from parts(held, f"{path}.{name}")
    elif isinstance(value, tuple):
        for index, held in enumerate(value):
            yield from parts(held, f"{path}[{index}]")
    else:
        yield path, value


def print_of(value: Any) -> dict[str, Any]:
    """Return a value that equals another's only if both are the same bit for bit."""
    return {
        path: (held.dtype.str, held.shape, held.tobytes()) if isinstance(held, np.ndarray) else held
        for path, held in parts(value)
    }


def arrays(value: Any) -> dict[str, np.ndarray]:
    return {path: held for path, held in parts(value) if isinstance(held, np.ndarray)}


# --- settings


def violations(field: Any) -> list[Any]:
    """Return values that the setting's own bounds and type rule out."""
    bad: list[Any] = []
    for rule in field.metadata:
        if isinstance(rule, annotated_types.Gt):
            bad += [rule.gt, rule.gt - 1]
        if isinstance(rule, annotated_types.Ge):
            bad.append(rule.ge - 1)
        if isinstance(rule, annotated_types.Lt):
            bad += [rule.lt, rule.lt + 1]
        if isinstance(rule, annotated_types.Le):
            bad.append(rule.le + 1)
    return [*bad, object()]


@each_stage
def test_every_setting_is_described_and_numbers_are_bounded(name: str) -> None:
    for setting, field in stage_class(name).Settings.model_fields.items():
        assert field.description, setting
        if field.annotation in (int, float, float | None, int | None):
            assert len(violations(field)) > 1, f"{setting} has no bound"


@each_stage
def test_defaults_are_valid_and_only_files_have_none(name: str, tmp_path: Path) -> None:
    kind = stage_class(name)
    required = [n for n, f in kind.Settings.model_fields.items() if f.default is PydanticUndefined]
    assert required == (["path"] if name in FILES else [])
    settings = made(name, tmp_path).settings
    assert kind.Settings.model_validate(settings.model_dump()) == settings
    assert kind(settings).settings == settings


@each_stage
def test_settings_are_frozen(name: str, tmp_path: Path) -> None:
    settings = made(name, tmp_path).settings
    for setting in type(settings).model_fields:
        with pytest.raises(ValidationError, match="frozen"):
            setattr(settings, setting, getattr(settings, setting))


@each_stage
def test_unknown_settings_are_refused_with_the_nearest_name(name: str, tmp_path: Path) -> None:
    stage = made(name, tmp_path)
    known = list(type(stage.settings).model_fields)
    with pytest.raises(ConfigError, match="has no setting 'qqqq'") as caught:
        type(stage)(stage.settings, qqqq=1)
    assert caught.value.remedy == "known names: " + (", ".join(sorted(known)) or "none")
    for setting in known:
        with pytest.raises(ConfigError, match=f"has no setting '{setting}x'") as caught:
            type(stage)(stage.settings, **{f"{setting}x": 1})
        assert caught.value.remedy == f"did you mean '{setting}'?"


@each_stage
def test_settings_out_of_range_are_refused_with_their_description(
    name: str, tmp_path: Path
) -> None:
    stage = made(name, tmp_path)
    for setting, field in type(stage.settings).model_fields.items():
        for value in violations(field):
            with pytest.raises(ConfigError, match=f"setting '{setting}'") as caught:
                type(stage)(stage.settings, **{setting: value})
            assert caught.value.remedy == field.description
            assert caught.value.received


# --- ports and words


@each_stage
def test_ports_are_messages(name: str) -> None:
    kind = stage_class(name)
    ports = [*input_ports(kind).values(), *output_ports(kind).values()]
    assert ports
    for port in ports:
        assert is_dataclass(port.type), port
        assert port.type.__dataclass_params__.frozen, port
        assert callable(getattr(port.type, "summary", None)), port


@each_stage
def test_class_call_settings_and_result_are_documented(name: str) -> None:
    kind = stage_class(name)
    # The class's own text: one that is inherited says nothing about this stage.
    for owner in (kind, kind.__call__, kind.Settings):
        assert owner.__dict__.get("__doc__") if isinstance(owner, type) else owner.__doc__
    assert kind.Settings is not Stage.Settings


# --- calls


@each_case
def test_a_call_gives_valid_messages_for_its_ports(case: tuple[Stage[Any], Messages]) -> None:
    stage, messages = case
    outputs = call(stage, messages)
    ports = output_ports(type(stage))
    assert list(outputs) == list(ports)
    for name, value in outputs.items():
        if value is None:
            assert ports[name].optional, name
            continue
        assert isinstance(value, ports[name].type)
        # Making it again runs every check of the message.
        assert print_of(replace(value)) == print_of(value)
        assert value.summary()


@each_case
def test_two_calls_give_the_same_bits(case: tuple[Stage[Any], Messages]) -> None:
    stage, messages = case
    first = print_of(call(stage, messages))
    assert print_of(call(stage, messages)) == first
    assert print_of(call(type(stage)(stage.settings), messages)) == first


@each_case
def test_inputs_are_not_changed(case: tuple[Stage[Any], Messages]) -> None:
    stage, messages = case
    taken = {port.type for port in input_ports(type(stage)).values()} & set(messages)
    before = {kind: print_of(messages[kind]) for kind in taken}
    settings = stage.settings.model_copy()
    call(stage, messages)
    assert {kind: print_of(messages[kind]) for kind in taken} == before
    assert stage.settings == settings


@each_case
def test_every_array_is_a_read_only_view(case: tuple[Stage[Any], Messages]) -> None:
    stage, messages = case
    outputs = call(stage, messages)
    held = [message for kind, message in messages.items() if not issubclass(kind, Stage)]
    for message in (*held, *outputs.values()):
        writable = [path for path, array in arrays(message).items() if array.flags.writeable]
        assert not writable, type(message)


@each_case
def test_the_header_is_carried_along(case: tuple[Stage[Any], Messages]) -> None:
    stage, messages = case
    wanted = HEADER if input_ports(type(stage)) else Header(HEADER.frame_id)
    for name, value in call(stage, messages).items():
        found = list(headers(value))
        assert all(header == wanted for header in found), name
        if isinstance(value, PointCloud | MassCloud | Nodes | TransportPlan | Skeleton):
            assert found, name


def headers(value: Any) -> Iterator[Header]:
    if isinstance(value, Header):
        yield value
    elif is_dataclass(value):
        for item in fields(value):
            yield from headers(getattr(value, item.name))


@each_case
def test_mass_is_conserved(case: tuple[Stage[Any], Messages]) -> None:
    stage, messages = case
    for name, value in call(stage, messages).items():
        for path, array in arrays(value).items():
            if path.endswith(".mass"):
                assert abs(array.sum() - 1) <= 1e-9, f"{name}{path}"
            if path.endswith(".plan.data"):
                assert abs(array.sum() - 1) <= 1e-9, f"{name}{path}"


@each_case
def test_plans_empty_every_point(case: tuple[Stage[Any], Messages]) -> None:
    """The point marginal of a plan is the cloud's mass: what a point has, it sends."""
    stage, messages = case
    for value in call(stage, messages).values():
        plan = value if isinstance(value, TransportPlan) else getattr(value, "plan", None)
        if plan is not None:
            sent = np.asarray(plan.plan.sum(axis=1)).ravel()
            np.testing.assert_allclose(sent, messages[MassCloud].mass, rtol=1e-9, atol=1e-15)


def test_the_suite_knows_every_stage_of_the_configs() -> None:
    for config in CONFIGS:
        used = {spec.stage for spec in load_spec(config, {}).stages.values()}
        assert used <= set(stage_names())


# --- the order of the points


@pytest.mark.parametrize("name", ["downsample", "clean", "density"])
def test_the_order_of_the_points_does_not_matter(name: str) -> None:
    cloud = PointCloud(shapes.y(600, 2), np.linspace(0.5, 2, len(shapes.y(600, 2))), HEADER)
    shuffled = np.random.default_rng(0).permutation(len(cloud))
    assert cloud.weights is not None
    mixed = PointCloud(cloud.positions[shuffled], cloud.weights[shuffled], HEADER)
    stage = stage_class(name)()
    one, other = stage(cloud=cloud).cloud, stage(cloud=mixed).cloud
    if len(one) == len(cloud):
        # One point out for each point in: in the new order.
        place = np.argsort(shuffled)
    else:
        place = np.lexsort(other.positions.T)
        here = np.lexsort(one.positions.T)
        back = np.empty_like(here)
        back[here] = np.arange(len(here))
        place = place[back]
    np.testing.assert_allclose(other.positions[place], one.positions, atol=1e-12)
    held = "mass" if isinstance(one, MassCloud) else "weights"
    np.testing.assert_allclose(getattr(other, held)[place], getattr(one, held), atol=1e-12)
