"""The YAML format: what is read, and that every fault is a `ConfigError` with its place."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from toy import LOOPS, TOYS, graph_of

from mdcs_pipeline import config, document
from mdcs_pipeline.config import (
    config_names,
    load_spec,
    override_spec,
    parse_override,
    parse_spec,
)
from mdcs_pipeline.errors import ConfigError
from mdcs_pipeline.schema import json_schema

GOOD = """# a comment
name: small
description: two stages
sources:
  cloud: {nonfinite: refuse}
  other:
stages:
  size:
    inputs: {cloud: sources.cloud}
  again:
    stage: add
    inputs:
      number: size.number
      other: [size.number, sources.other]
    feedback:
      number:
        - from: again.number
          max_rounds: 3
      other: {from: size.number, max_rounds: 1}
    settings:
      by: 1e-3
      text: "1e-3"
      list: [1, two, {three: 3.0, no: null}]
results:
  total: again.number
"""


def fault(text: str | bytes, **environment: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_spec(text, "f.yaml", environment)
    return str(caught.value)


def test_everything_of_the_format_is_read_with_its_line() -> None:
    spec = parse_spec(GOOD, "f.yaml", {})
    assert (spec.name, spec.description, spec.file) == ("small", "two stages", "f.yaml")
    assert {k: s.nonfinite for k, s in spec.sources.items()} == {"cloud": "refuse", "other": "drop"}
    assert str(spec.sources["other"].place) == "f.yaml:6"
    assert list(spec.stages) == ["size", "again"]
    size, again = spec.stages.values()
    assert (size.stage, again.stage, str(again.place)) == ("size", "add", "f.yaml:10")
    assert [str(ref) for ref in again.inputs["other"]] == ["size.number", "sources.other"]
    assert str(again.inputs["number"][0].place) == "f.yaml:13"
    (back,) = again.feedback["number"]
    assert (str(back.origin), back.max_rounds, str(back.place)) == ("again.number", 3, "f.yaml:17")
    assert again.feedback["other"][0].max_rounds == 1
    assert again.settings == {
        "by": 0.001,
        "text": "1e-3",
        "list": [1, "two", {"three": 3.0, "no": None}],
    }
    assert str(again.setting_places["text"]) == "f.yaml:22"
    assert str(spec.results["total"]) == "again.number"


def test_parts_may_be_left_empty_and_the_name_is_the_files() -> None:
    spec = parse_spec("stages: {a: , b: {inputs: , settings: }}\nsources:\nresults:", "x/y.yaml")
    assert (spec.name, spec.description) == ("y", "")
    assert spec.sources == spec.results == spec.stages["b"].inputs == {}


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("", ["f.yaml", "empty"]),
        ("# only a comment", ["empty"]),
        ("- a", ["f.yaml:1", "the pipeline must be a mapping"]),
        ("text", ["must be a mapping", "received: text"]),
        ("name: x", ["no stages", "add 'stages:'"]),
        ("stages: [a]", ["f.yaml:1", "stages must be a mapping"]),
        ("stages: {a: [b]}", ["stage 'a' must be a mapping"]),
        ("stages: {a: {inputs: b}}", ["inputs of stage 'a' must be a mapping"]),
        ("nmae: x\nstages: {a: }", ["f.yaml:1", "no key 'nmae'", "did you mean 'name'"]),
        ("stages:\n  a:\n    input: {}", ["f.yaml:3", "no key 'input'", "mean 'inputs'"]),
        ("sources: {c: {nonfinit: drop}}\nstages: {}", ["no key 'nonfinit'", "'nonfinite'"]),
        ("sources: {c: {nonfinite: drp}}\nstages: {}", ["received: drp", "did you mean 'drop'"]),
        ("name: 3\nstages: {}", ["name must be text", "received: 3"]),
        ("name: ''\nstages: {}", ["name must be text"]),
        ("stages: {a: {stage: [b]}}", ["'stage' of stage 'a' must be text"]),
        ("stages: {sources: }", ["cannot be called 'sources'", "choose another"]),
        ("stages: {results: }", ["cannot be called 'results'"]),
        ("stages: {a.b: }", ["'a.b' cannot be a name in stages"]),
        ("results: {'1': a.b}\nstages: {}", ["'1' cannot be a name in results"]),
        ("stages:\n a: {}\n b: {}\n a: {}", ["f.yaml:4", "'a' stands twice", "line 2"]),
        ("stages: {a: {inputs: {x: b}}}", ["input 'x' of stage 'a'", "stage.port", "received: b"]),
        ("stages: {a: {inputs: {x: b.c.d}}}", ["stage.port"]),
        ("stages: {a: {inputs: {x: [b.c, 3]}}}", ["stage.port", "received: 3"]),
        ("stages: {}\nresults: {x: }", ["result 'x' must be written stage.port"]),
        ("stages: {a: {feedback: {x: b.c}}}", ["feedback 'x' of stage 'a' must be a mapping"]),
        ("stages: {a: {feedback: {x: {max_rounds: 1}}}}", ["has no 'from'"]),
        ("stages: {a: {feedback: {x: {from: b.c, max_round: 1}}}}", ["mean 'max_rounds'"]),
        ("stages: {a: {feedback: {x: {from: b.c, max_rounds: 1.5}}}}", ["integer", "1.5"]),
        ("stages: {a: {feedback: {x: {from: b.c, max_rounds: true}}}}", ["integer", "True"]),
        ("a: !!python/object:os.system x", ["f.yaml:1", "tags", "python/object"]),
        ("a: !!python/object/apply:os.system [ls]", ["tags", "python/object/apply"]),
        ("a: !mine {b: c}", ["tags", "received: !mine"]),
        ("a: !!binary aGk=", ["tags", "binary"]),
        ("a: !!set {b}", ["tags", "set"]),
        ("a: !!int x", ["does not fit its type", "received: 'x'"]),
        ("a: !!bool x", ["does not fit its type"]),
        ("[a]: b", ["a key must be plain text"]),
        ("? !x a\n: b", ["a key must be plain text"]),
        ("a: b: c", ["f.yaml:1", "not valid YAML"]),
        ("a: [", ["not valid YAML"]),
        ("a: *b", ["not valid YAML", "undefined alias"]),
        ("a: 1\n---\nb: 2", ["not valid YAML", "single document"]),
        ("a: \x00", ["not valid YAML"]),
        ('a: "\\UFFFFFFFF"', ["not valid YAML"]),
        ('a: "\\ud800"', ["does not fit"]),
        (b"a: \xff", ["not UTF-8"]),
        ("a: \ud800", ["not UTF-8"]),
        ("[" * 100, ["nested deeper than 20 levels"]),
        ("a: &x [*x]", ["f.yaml:1", "too large or endless"]),
        ("#" * (1 << 18) + "\n", ["larger than", "bytes"]),
    ],
)
def test_faults_are_named_with_their_place(text: str | bytes, messages: list[str]) -> None:
    said = fault(text)
    assert "f.yaml" in said
    for message in messages:
        assert message in said


def test_few_lines_of_aliases_cannot_grow_without_bound() -> None:
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    for k in range(1, 9):
        rows.append(f"a{k}: &a{k} [" + ", ".join([f"*a{k - 1}"] * 10) + "]")
    assert "too large or endless" in fault("\n".join(rows))


def test_aliases_that_are_few_are_read() -> None:
    text = "stages: {a: {settings: &s {x: 1}}, b: {settings: *s}}"
    assert parse_spec(text).stages["b"].settings == {"x": 1}


def test_no_tag_runs_code(tmp_path: Path) -> None:
    target = tmp_path / "made"
    fault(f"a: !!python/object/apply:pathlib.Path.touch [{target}]")
    fault(f'a: !!python/object/new:os.system ["touch {target}"]')
    assert not target.exists()


# --- environment


def settings_of(value: str, **environment: str) -> Any:
    text = f"stages:\n  a:\n    settings:\n      x: {value}\n"
    return parse_spec(text, "f.yaml", environment).stages["a"].settings["x"]


@pytest.mark.parametrize(
    ("value", "environment", "result"),
    [
        ("${N}", {"N": "3"}, 3),
        ("${N}", {"N": "1e-3"}, 0.001),
        ("${N}", {"N": "true"}, True),
        ("${N}", {"N": ""}, None),
        ("${N:-7}", {}, 7),
        ("${N:-7}", {"N": ""}, 7),
        ("${N:-7}", {"N": "8"}, 8),
        ("${N:-}", {}, None),
        ("'${N}'", {"N": "3"}, "3"),
        ("${A}/${B:-x}.ply", {"A": "/data"}, "/data/x.ply"),
        ("${N}", {"N": "[1, 2]"}, "[1, 2]"),
        ("${N}", {"N": "a: b\nc: d"}, "a: b\nc: d"),
        ("${N}", {"N": "!!python/none x"}, "!!python/none x"),
        ("${N}", {"N": "${M}", "M": "1"}, "${M}"),
        ("$${N}", {}, "${N}"),
        ("$5", {}, "$5"),
        ("2020-01-01", {}, "2020-01-01"),
    ],
)
def test_variables_are_replaced_after_parsing(
    value: str, environment: dict[str, str], result: Any
) -> None:
    held = settings_of(value, **environment)
    assert held == result
    assert type(held) is type(result)


def test_an_unset_variable_is_named() -> None:
    with pytest.raises(ConfigError, match="'NOWHERE' is not set") as caught:
        settings_of("a/${NOWHERE}")
    assert "f.yaml:4" in str(caught.value)
    assert "${NOWHERE:-value}" in str(caught.value)


def test_a_malformed_variable_is_an_error() -> None:
    with pytest.raises(ConfigError, match="names no variable"):
        settings_of("${1}")


def test_the_process_environment_is_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MDCS_TEST_NUMBER", "5")
    assert parse_spec("stages: {a: {settings: {x: '${MDCS_TEST_NUMBER}'}}}").stages["a"].settings


def test_a_replaced_number_that_cannot_be_read_is_an_error() -> None:
    with pytest.raises(ConfigError, match="does not fit its type"):
        settings_of("${N}", N="9" * 5000)


# --- files and names


def test_a_file_is_found_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("\ufeffstages: {a: }", encoding="utf-8")
    for given_as in (path, str(path)):
        spec = load_spec(given_as)
        assert (spec.name, spec.file) == ("mine", str(path))


def test_a_file_without_suffix_is_found_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plain").write_text("stages: {a: }")
    monkeypatch.chdir(tmp_path)
    assert load_spec("plain").name == "plain"


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "shipped"
    folder.mkdir()
    (folder / "default.yaml").write_text("stages: {a: }")
    (folder / "paper.yaml").write_text("stages: {a: }")
    (folder / "__init__.py").write_text("")
    monkeypatch.setattr(config, "files", lambda package: folder)


@pytest.mark.usefixtures("shipped")
def test_shipped_configurations_go_by_their_names() -> None:
    assert config_names() == ["default", "paper"]
    assert load_spec("default").file == "default.yaml"
    with pytest.raises(ConfigError, match="unknown configuration 'defualt'") as caught:
        load_spec("defualt")
    assert "did you mean 'default'" in str(caught.value)
    assert "default, paper" in str(caught.value)


@pytest.mark.parametrize("name", ["no/such.yaml", "gone.yaml", "a\0b.yaml"])
def test_a_file_that_cannot_be_read_is_named(name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_spec(name)


def test_a_folder_is_no_configuration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read") as caught:
        load_spec(tmp_path)
    assert str(tmp_path) in str(caught.value)


# --- overrides


@pytest.mark.parametrize(
    "overrides",
    [
        {"again.by": 5, "sources.cloud.nonfinite": "drop"},
        {"again": {"by": 5}, "sources": {"cloud": {"nonfinite": "drop"}}},
        {"again": {"by": 5}, "sources": {"cloud.nonfinite": "drop"}},
        {"again": {"by": 5}, "sources.cloud": {"nonfinite": "drop"}},
    ],
)
def test_overrides_change_settings_and_nothing_else(overrides: dict[str, Any]) -> None:
    before = parse_spec(GOOD)
    after = override_spec(before, overrides)
    assert before.stages["again"].settings["by"] == 0.001
    assert after.stages["again"].settings == {**before.stages["again"].settings, "by": 5}
    assert after.stages["size"] is before.stages["size"]
    assert after.sources["cloud"].nonfinite == "drop"
    assert str(after.stages["again"].setting_places["by"]) == "override 'again.by'"


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"agin.by": 5}, "did you mean 'again'"),
        ({"agin": {"by": 5}}, "did you mean 'again'"),
        ({"by": 5}, "'by' alone is no setting"),
        ({"again.": 5}, "alone is no setting"),
        ({"sources.clod.nonfinite": "drop"}, "did you mean 'sources.cloud.nonfinite'"),
        ({"sources.cloud.finite": "drop"}, "did you mean 'sources.cloud.nonfinite'"),
        ({"sources.cloud.nonfinite": 3}, "must be one of: drop, refuse"),
    ],
)
def test_wrong_overrides_are_refused(overrides: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        override_spec(parse_spec(GOOD), overrides)


@pytest.mark.parametrize(
    ("text", "value"),
    [("a.b=3", 3), ("a.b=1e-3", 0.001), (" a.b = true", True), ("a.b=x=y", "x=y"), ("a.b=", None)],
)
def test_an_override_is_read_as_a_scalar(text: str, value: Any) -> None:
    assert parse_override(text) == ("a.b", value)


@pytest.mark.parametrize("text", ["", "a", "a=3", "a.=3", ".b=3", "a.b"])
def test_a_malformed_override_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"stage\.setting=value"):
        parse_override(text)


def test_an_override_out_of_range_is_refused() -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        parse_override("a.b=" + "9" * 5000)


# --- fuzz


WORDS = "stages sources results name from max_rounds feedback inputs a.b 1e-3 0x_ ~ << = --- ..."
SIGNS = ": - { } [ ] &a *a !! !!int !t ' \" | > ? , ${ % # \\ @ `"
PIECES = st.sampled_from([*WORDS.split(), *SIGNS.split(), " ", "\n", "\n  ", "\t", ": ", "- "])


@settings(max_examples=300, deadline=None)
@given(st.lists(PIECES, max_size=25).map("".join))
@example("a: !!float .")
@example("a: 0x_")
@example("a: !!int")
@example("%YAML 9.9\n---\na: b")
@example('a: "\\x"')
@example("a: !<tag:yaml.org,2002:int> =")
def test_no_text_raises_anything_but_a_config_error(text: str) -> None:
    try:
        spec = parse_spec(text, "f.yaml", {})
    except ConfigError as error:
        assert "f.yaml" in str(error)
    else:
        assert isinstance(spec.stages, dict)


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=60))
def test_no_bytes_raise_anything_but_a_config_error(data: bytes) -> None:
    try:
        parse_spec(data, "f.yaml", {})
    except ConfigError as error:
        assert "f.yaml" in str(error)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, len(LOOPS) - 1), st.text(max_size=3), st.integers(0, 3))
def test_a_damaged_pipeline_builds_or_says_why_not(at: int, put: str, cut: int) -> None:
    try:
        graph_of(LOOPS[:at] + put + LOOPS[at + cut :])
    except ConfigError as error:
        assert "toy.yaml" in str(error)
    except KeyError:
        # The registry of the tests is a bare dict.
        pass


@settings(max_examples=200, deadline=None)
@given(st.text(st.characters(codec="utf-8"), max_size=12))
def test_a_variable_never_adds_structure(value: str) -> None:
    held = settings_of("${N}", N=value)
    assert not isinstance(held, dict | list)
    assert settings_of("'${N}'", N=value) == value


def test_scalars_are_those_of_yaml() -> None:
    for text in ("3", "-2", "0.5", "true", "null", "", "word", "0x10", ".inf"):
        assert document.scalar_of(text) == yaml.safe_load(text)


# --- schema


def errors_of(text: str) -> list[str]:
    jsonschema = pytest.importorskip("jsonschema")
    schema = json_schema(TOYS)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    return [error.message for error in validator.iter_errors(yaml.safe_load(text))]


VALID = """
name: x
description: y
sources: {cloud: , other: {nonfinite: drop}}
stages:
  size: {inputs: {cloud: sources.cloud}}
  one:
  two: {stage: one, settings: {value: "${VALUE}"}}
  join: {inputs: {numbers: [size.number, one.number, two.number]}}
  until:
    inputs: {number: [join.number]}
    feedback: {number: [{from: until.again, max_rounds: 3}]}
    settings: {least: 3}
results: {n: until.number, o: sources.other}
"""


@pytest.mark.parametrize("text", [VALID, LOOPS])
def test_the_schema_takes_what_the_package_takes(text: str) -> None:
    graph_of(text.replace("${VALUE}", "3"))
    assert errors_of(text) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("name: x", "nam: x"),
        ("nonfinite: drop", "nonfinite: maybe"),
        ("nonfinite: drop", "finite: drop"),
        ("size: {inputs", "size: {input"),
        ("{cloud: sources.cloud}", "{clod: sources.cloud}"),
        ("sources.cloud}", "sources}"),
        ("stage: one", "stage: won"),
        ("two: {stage: one, ", "two: {"),
        ('value: "${VALUE}"', "value: -1"),
        ('value: "${VALUE}"', "valu: 1"),
        ("max_rounds: 3", "max_rounds: 0"),
        (", max_rounds: 3", ""),
        ("from: until.again", "frm: until.again"),
        ("[join.number]", "[join.number, one.number]"),
        ("until.number,", "until,"),
        ("  one:\n", "  results: {stage: one}\n"),
        ("stages:", "stage:"),
    ],
)
def test_the_schema_refuses_what_the_package_refuses(old: str, new: str) -> None:
    text = VALID.replace(old, new, 1)
    assert text != VALID
    assert errors_of(text) != []
    with pytest.raises((ConfigError, KeyError)):
        graph_of(text.replace("${VALUE}", "3"))


def test_the_schema_documents_settings_and_ports() -> None:
    held = json_schema(TOYS)["$defs"]
    assert held["one.settings"]["properties"]["value"]["default"] == 1
    assert "number of at least 0" in held["one.settings"]["properties"]["value"]["description"]
    assert held["join.inputs"]["properties"]["numbers"]["description"] == "tuple[Number, ...]"
    assert held["stage"]["properties"]["stage"]["enum"] == list(TOYS)


def test_the_recursion_limit_is_never_met() -> None:
    deep = "a: " + "[" * 2 * sys.getrecursionlimit()
    assert "nested deeper" in fault(deep)
