"""The graph: what it refuses, its order, and its pictures."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import model_validator
from toy import LOOPS, TOYS, Number, Out, SmallNumber, graph_of, toys

from mdcs_pipeline.config import config_names, load_spec, parse_spec
from mdcs_pipeline.errors import ConfigError, MissingExtraError, OutputError
from mdcs_pipeline.graph import build_graph, draw_graph, mermaid
from mdcs_pipeline.io.diagram import Arrow, Box, draw_diagram
from mdcs_pipeline.stage import Settings, Stage, stage_class


def fault(text: str, **more: type[Stage[Any]]) -> str:
    with pytest.raises(ConfigError) as caught:
        graph_of(text, **more)
    return str(caught.value)


def stages(*lines: str, results: str = "n: last.number") -> str:
    return "stages:\n" + "".join(f"  {line}\n" for line in lines) + f"results: {{{results}}}\n"


LINE = ("one:", "last: {stage: add, inputs: {number: one.number}}")


def test_the_graph_holds_its_parts() -> None:
    graph = graph_of(LOOPS)
    assert graph.order == ("start", "step", "inner", "outer", "end")
    assert list(graph.stages) == list(graph.network) == list(graph.order)
    assert type(graph.stages["step"]) is TOYS["add"]
    assert graph.stages["inner"].settings.multiple == 4
    back = graph.network.get_edge_data("outer", "step")
    assert back == {
        0: {
            "output": "again",
            "input": "number",
            "type": Number,
            "feedback": True,
            "max_rounds": 10,
        }
    }
    assert graph.network.nodes["step"] == {"kind": "stage"}


def test_a_source_is_a_node() -> None:
    graph = graph_of(
        "sources: {cloud: }\n" + stages("last: {stage: size, inputs: {cloud: sources.cloud}}")
    )
    assert graph.network.nodes["sources.cloud"] == {"kind": "source"}
    assert graph.order == ("last",)


def test_a_subtype_fits_and_its_base_does_not() -> None:
    class Narrow(Stage[Settings]):
        def __call__(self, number: SmallNumber) -> Out: ...

    graph_of(stages("one:", "last: {stage: narrow, inputs: {number: one.number}}"), narrow=Narrow)
    said = fault(
        stages(*LINE, "worse: {stage: narrow, inputs: {number: last.number}}"), narrow=Narrow
    )
    assert "last.number -> worse.number: types do not fit" in said
    assert "toy.yaml:4, stage 'worse', port 'number'" in said
    assert "last gives 'number: Number', worse takes 'number: SmallNumber'" in said


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("stages: {}", ["toy.yaml", "no stages"]),
        (
            stages("one:", "last: {stage: add, settings: {bye: 1}}"),
            ["toy.yaml:3, stage 'last'", "no setting 'bye'", "did you mean 'by'"],
        ),
        (
            stages("last:", "  stage: one", "  settings:", "    value: -3"),
            ["toy.yaml:5, stage 'last'", "'value'", "received: -3", "at least 0"],
        ),
        (
            stages("one:", "last: {stage: add, inputs: {nubmer: one.number}}"),
            ["toy.yaml:3, stage 'last'", "no input port 'nubmer'", "did you mean 'number'"],
        ),
        (
            stages("one:", "last: {stage: add, inputs: {number: one.numbr}}"),
            ["toy.yaml:3, stage 'last', port 'number'", "output port 'numbr'", "mean 'number'"],
        ),
        (
            stages("one:", "last: {stage: add, inputs: {number: on.number}}"),
            ["there is no stage 'on'", "received: on.number", "did you mean 'one'"],
        ),
        (
            "sources: {cloud: }\n" + stages("last: {stage: size, inputs: {cloud: sources.clod}}"),
            ["toy.yaml:3", "there is no source 'clod'", "did you mean 'cloud'"],
        ),
        (
            "sources: {cloud: }\n" + stages("last: {stage: size, inputs: {cloud: source.cloud}}"),
            ["there is no stage 'source'", "did you mean 'sources'"],
        ),
        (
            stages(*LINE, results="n: lost.number"),
            ["toy.yaml:4, result 'n'", "there is no stage 'lost'", "did you mean 'last'"],
        ),
        (
            stages(*LINE, results="n: last.numbers"),
            ["result 'n'", "no output port 'numbers'", "did you mean 'number'"],
        ),
        (
            stages("last: {stage: add}"),
            ["toy.yaml:2, stage 'last', port 'number'", "'number: Number' is not fed"],
        ),
        (
            stages("last: {stage: join, inputs: {numbers: []}}"),
            ["'numbers: tuple[Number, ...]' is not fed"],
        ),
        (
            stages(
                "one:",
                "two: {stage: one}",
                "last: {stage: add, inputs: {number: [one.number, two.number]}}",
            ),
            ["toy.yaml:4", "fed 2 times and takes one", "received: one.number, two.number"],
        ),
        (
            stages("one:", "last: {stage: size, inputs: {cloud: one.number}}"),
            ["one.number -> last.cloud: types do not fit", "'cloud: PointCloud'"],
        ),
        (
            stages(
                "one:",
                "a: {stage: add, inputs: {number: one.number, other: last.number}}",
                "b: {stage: add, inputs: {number: a.number}}",
                "last: {stage: add, inputs: {number: b.number}}",
            ),
            ["a -> b -> last -> a form a cycle", "'feedback'", "'max_rounds'", "toy.yaml:3"],
        ),
        (
            stages("last: {stage: add, inputs: {number: last.number}}"),
            ["last -> last form a cycle"],
        ),
        (
            stages(
                "one:",
                "last: {stage: add, inputs: {number: one.number}, "
                "feedback: {number: {from: last.number}}}",
            ),
            ["feedback from last.number has no bound", "'max_rounds'"],
        ),
        (
            stages(
                "one:",
                "last: {stage: add, inputs: {number: one.number}, "
                "feedback: {number: {from: last.number, max_rounds: 0}}}",
            ),
            ["must carry at least one", "received: 0"],
        ),
        (
            stages(
                "one:",
                "last: {stage: add, inputs: {number: one.number}, "
                "feedback: {other: {from: one.number, max_rounds: 1}}}",
            ),
            ["one.number -> last.other closes no loop", "stage 'last', port 'other'"],
        ),
        (
            stages(
                "one:",
                "last: {stage: add, inputs: {number: one.number}, "
                "feedback: {nubmer: {from: last.number, max_rounds: 1}}}",
            ),
            ["no input port 'nubmer'", "did you mean 'number'"],
        ),
        (
            stages(
                "one:",
                "last: {stage: add, inputs: {number: one.number}, feedback: {number: "
                "[{from: last.number, max_rounds: 1}, {from: last.number, max_rounds: 2}]}}",
            ),
            ["a feedback edge stands twice", "last.number, last.number"],
        ),
        (
            stages(
                "one:",
                "last: {stage: join, inputs: {numbers: one.number}, "
                "feedback: {numbers: {from: last.number, max_rounds: 1}}}",
            ),
            ["'numbers' collects, so nothing can be fed back"],
        ),
        (
            stages("last: {stage: add, feedback: {number: {from: last.number, max_rounds: 1}}}"),
            ["is not fed", "feedback from last.number comes too late"],
        ),
        (stages("last: {stage: maybe}"), ["nothing reaches this stage", "number"]),
        (
            stages("last: {stage: maybe, feedback: {number: {from: last.number, max_rounds: 1}}}"),
            ["nothing reaches this stage"],
        ),
        (
            stages(*LINE, "spare: {stage: add, inputs: {number: one.number}}"),
            ["toy.yaml:4, stage 'spare'", "leads to no result", "outputs number"],
        ),
        ("sources: {cloud: }\n" + stages(*LINE), ["toy.yaml:1", "'cloud' leads nowhere"]),
        ("stages:\n  one:\n", ["toy.yaml", "nothing leaves the pipeline", "'results'"]),
    ],
)
def test_what_does_not_fit_is_named_with_its_place(text: str, messages: list[str]) -> None:
    said = fault(text)
    for message in messages:
        assert message in said


def test_an_unknown_stage_is_named_with_the_nearest() -> None:
    with pytest.raises(ConfigError) as caught:
        build_graph(parse_spec("stages:\n  raed: {}", "f.yaml"), stage_class)
    assert "f.yaml:2, stage 'raed': unknown stage 'raed'" in str(caught.value)
    assert "did you mean 'read'" in str(caught.value)


def test_a_setting_that_was_overridden_is_blamed_on_the_override() -> None:
    from mdcs_pipeline.config import override_spec

    spec = override_spec(parse_spec(LOOPS, "f.yaml"), {"start.value": -1})
    with pytest.raises(ConfigError, match=r"override 'start\.value', stage 'start'"):
        build_graph(spec, toys)


def test_a_stage_without_outputs_is_an_end() -> None:
    graph = graph_of("stages: {one: , sink: {inputs: {number: one.number}}}")
    assert graph.order == ("one", "sink")


def test_a_stage_that_only_feeds_back_has_its_part() -> None:
    text = stages(
        "one:",
        "last: {stage: add, inputs: {number: one.number}, "
        "feedback: {other: {from: judge.again, max_rounds: 2}}}",
        "judge: {stage: until, inputs: {number: last.number}, settings: {least: 9}}",
    )
    assert graph_of(text).order == ("one", "last", "judge")


# --- stages whose ports cannot be read


class NoCall(Stage[Settings]):
    """Has no call."""


class NoType(Stage[Settings]):
    def __call__(self, number) -> Out: ...  # type: ignore[no-untyped-def]


class NoName(Stage[Settings]):
    def __call__(self, number: Nowhere) -> Out: ...  # type: ignore[name-defined]  # noqa: F821


class NoTuple(Stage[Settings]):
    def __call__(self) -> Number: ...


@pytest.mark.parametrize("bad", [NoCall, NoType, NoName, NoTuple])
def test_a_stage_whose_ports_cannot_be_read_is_named(bad: type[Any]) -> None:
    said = fault("stages:\n  x: {stage: bad}", bad=bad)
    assert "toy.yaml:2, stage 'x': the ports of stage 'bad' cannot be read" in said
    assert bad.__name__ in said


class Ordered(Settings):
    low: int = 0
    high: int = 1

    @model_validator(mode="after")
    def _in_order(self) -> Ordered:
        if self.low > self.high:
            raise ValueError("low must not be above high")
        return self


class NeedsOrder(Stage[Ordered]):
    Settings = Ordered

    def __call__(self) -> Out: ...


class Unwilling(Stage[Settings]):
    def __init__(self, settings: Settings | None = None, **values: Any) -> None:
        raise ConfigError("not on this machine")


def test_settings_that_do_not_go_together_are_blamed_on_the_stage() -> None:
    said = fault("stages:\n  x: {stage: order, settings: {low: 3}}", order=NeedsOrder)
    assert said.startswith("toy.yaml:2, stage 'x': ")
    assert "low must not be above high" in said


def test_a_stage_that_refuses_to_be_made_is_named() -> None:
    said = fault("stages:\n  x: {stage: unwilling}", unwilling=Unwilling)
    assert said == "toy.yaml:2, stage 'x': not on this machine"


class ManyOut(NamedTuple):
    numbers: tuple[Number, ...]


class Gives(Stage[Settings]):
    def __call__(self) -> ManyOut: ...


class ListOut(NamedTuple):
    numbers: list[int]


class GivesList(Stage[Settings]):
    def __call__(self) -> ListOut: ...


class TakesList(Stage[Settings]):
    def __call__(self, numbers: list[int]) -> Out: ...


def test_an_output_of_many_fits_no_input() -> None:
    text = stages("gives:", "last: {stage: add, inputs: {number: gives.numbers}}")
    assert "gives 'numbers: tuple[Number, ...]'" in fault(text, gives=Gives)


def test_parametrised_types_are_compared_by_their_origin() -> None:
    text = stages("gives:", "last: {stage: takes, inputs: {numbers: gives.numbers}}")
    graph = graph_of(text, gives=GivesList, takes=TakesList)
    assert "list" in mermaid(graph)


# --- order


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 7), st.data())
def test_a_loop_stands_in_one_piece(count: int, data: st.DataObject) -> None:
    """A chain with one loop and a sink at each stage, written in any order."""
    first = data.draw(st.integers(0, count - 1))
    last = data.draw(st.integers(first, count - 1))
    lines = ["  one:"]
    for k in range(count):
        back = (
            f", feedback: {{number: {{from: s{last}.number, max_rounds: 2}}}}" if k == first else ""
        )
        before = f"s{k - 1}" if k else "one"
        lines.append(f"  s{k}: {{stage: add, inputs: {{number: {before}.number}}{back}}}")
        lines.append(f"  t{k}: {{stage: sink, inputs: {{number: s{k}.number}}}}")
    graph = graph_of("stages:\n" + "\n".join(data.draw(st.permutations(lines))))
    at = {name: k for k, name in enumerate(graph.order)}
    assert sorted(at) == sorted(graph.stages)
    body = [at[f"s{k}"] for k in range(first, last + 1)]
    assert body == list(range(body[0], body[0] + len(body)))


# --- pictures


def test_mermaid_shows_stages_edges_and_bounds() -> None:
    text = "sources: {cloud: }\n" + stages(
        "count: {stage: size, inputs: {cloud: sources.cloud}}",
        "add: {inputs: {number: count.number}, "
        "feedback: {other: {from: until.again, max_rounds: 4}}}",
        "until: {inputs: {number: add.number}}",
        results="total: until.number",
    )
    assert mermaid(graph_of(text)).splitlines() == [
        "flowchart TD",
        '  n0(["cloud"])',
        '  n1["count<br/><i>size</i>"]',
        '  n2["add"]',
        '  n3["until"]',
        '  r0(["total"])',
        '  n0 -- "cloud: PointCloud" --> n1',
        '  n1 -- "number: Number" --> n2',
        '  n3 -. "again → other: Number, at most 4" .-> n2',
        '  n2 -- "number: Number" --> n3',
        '  n3 -- "number: Number" --> r0',
    ]


WITH_SOURCE = "sources: {cloud: }\n" + LOOPS.replace(
    "start: {stage: one, settings: {value: 0}}",
    "start: {stage: size, inputs: {cloud: sources.cloud}}",
)


def test_the_svg_holds_all_names_and_is_the_same_each_time(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    graph = graph_of(WITH_SOURCE)
    draw_graph(graph, tmp_path / "a.svg")
    draw_graph(graph, str(tmp_path / "b.SVG"))
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.SVG").read_bytes()
    root = ET.parse(tmp_path / "a.svg").getroot()
    texts = {"".join(node.itertext()).strip() for node in root.iter() if node.tag.endswith("text")}
    assert {"start", "size", "step", "inner", "outer", "end", "cloud"} <= texts
    assert {"again →", "number: Number", "at most 100", "at most 10"} <= texts


def test_the_png_is_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw_graph(graph_of(LOOPS), tmp_path / "a.png")
    from matplotlib.image import imread

    picture = imread(tmp_path / "a.png")
    assert picture.shape[0] > 500
    assert picture[..., :3].min() < 0.2
    # Nothing is cut off: the rim is white.
    rim = [picture[0], picture[-1], picture[:, 0], picture[:, -1]]
    assert all((side[..., :3] == 1).all() for side in rim)


@pytest.mark.parametrize("name", ["a.jpg", "a"])
def test_other_suffixes_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"known suffixes: \.svg, \.png"):
        draw_graph(graph_of(LOOPS), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(OutputError, match="cannot be written"):
        draw_graph(graph_of(LOOPS), tmp_path / "no" / "a.svg")


def test_without_matplotlib_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"mdcs-pipeline\[draw\]"):
        draw_graph(graph_of(LOOPS), tmp_path / "a.svg")


def test_lanes_of_one_side_do_not_run_into_each_other() -> None:
    from mdcs_pipeline.io.diagram import _lanes

    places = [(0.0, -float(k)) for k in range(6)]
    arrows = [Arrow(a, b, "", False) for a in range(6) for b in range(a + 2, 6)]
    lanes = _lanes(arrows, places)
    assert len(lanes) == len(arrows)
    for one in lanes:
        for other in lanes:
            if one is other or one.number != other.number:
                continue
            a, b = one.arrow, other.arrow
            assert a.end <= b.start or b.end <= a.start


def test_boxes_may_be_joined_twice(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    boxes = [Box("a", "", 0, "stage"), Box("b", "", 1, "stage")]
    arrows = [Arrow(0, 1, "first", False), Arrow(0, 1, "second", False), Arrow(0, 0, "own", True)]
    draw_diagram(boxes, arrows, tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    assert all(label in text for label in ("first", "second", "own"))


@pytest.mark.parametrize("name", config_names())
def test_shipped_configurations_build(name: str) -> None:
    graph = build_graph(load_spec(name))
    assert {"skeleton", "changes"} & set(graph.spec.results)
    assert any(edge.feedback for edge in graph.edges)
