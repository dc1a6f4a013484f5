"""The runner on toy stages: what fires, how often, and in which order."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy import LOOPS, TOYS, Number, Out, graph_of, runner_of

from mdcs_pipeline.errors import InputError, StageError
from mdcs_pipeline.hooks import Hook, StageEvent
from mdcs_pipeline.messages import PointCloud
from mdcs_pipeline.runner import Runner
from mdcs_pipeline.stage import Settings, Stage


class Trace(Hook):
    """Keeps all that it hears."""

    def __init__(self) -> None:
        self.heard: list[Any] = []

    def run_started(self, graph: Any) -> None:
        self.heard.append("run started")

    def stage_started(self, name: str, firing: int) -> None:
        self.heard.append(f"{name} {firing}")

    def stage_finished(self, event: StageEvent) -> None:
        self.heard.append(event)

    def run_finished(self, record: Any) -> None:
        self.heard.append("run finished")

    @property
    def fired(self) -> list[str]:
        return [event.name for event in self.heard if isinstance(event, StageEvent)]


def cloud(count: int) -> PointCloud:
    return PointCloud(np.arange(3.0 * count).reshape(count, 3))


def test_a_line_passes_the_value_on() -> None:
    record = runner_of(
        """
        stages:
          size: {inputs: {cloud: sources.cloud}}
          add: {inputs: {number: size.number}, settings: {by: 5}}
        sources: {cloud: }
        results: {sum: add.number, count: size.number}
        """
    ).run({"cloud": cloud(7)})
    assert {k: v.value for k, v in record.results.items()} == {"sum": 12, "count": 7}
    assert record.firings == {"size": 1, "add": 1}
    assert list(record.seconds) == ["size", "add"]
    assert all(value > 0 for value in record.seconds.values())
    assert record.rounds == {}
    assert record.exhausted == ()


def test_values_fan_out_and_are_collected_in_the_order_named() -> None:
    """Written against the order of the stages, so that neither order passes for the other."""
    text = """
        stages:
          one:
          a: {stage: add, inputs: {number: one.number}, settings: {by: 1}}
          b: {stage: add, inputs: {number: one.number}, settings: {by: 2}}
          c: {stage: add, inputs: {number: one.number}, settings: {by: 3}}
          join: {inputs: {numbers: [c.number, a.number, b.number, one.number]}}
        results: {digits: join.number}
        """
    record = runner_of(text).run()
    assert record.results["digits"].value == 4231
    assert set(record.firings.values()) == {1}


def test_several_sources_and_results() -> None:
    text = """
        sources: {left: , right: {nonfinite: refuse}}
        stages:
          l: {stage: size, inputs: {cloud: sources.left}}
          r: {stage: size, inputs: {cloud: sources.right}}
          add: {inputs: {number: l.number, other: r.number}, settings: {by: 0}}
        results: {left: l.number, both: add.number, cloud: sources.right}
        """
    right = cloud(5)
    record = runner_of(text).run({"right": right, "left": cloud(2)})
    assert record.results["left"].value == 2
    assert record.results["both"].value == 7
    assert record.results["cloud"] is right


def test_two_nested_loops_fire_like_algorithm_1() -> None:
    trace = Trace()
    record = runner_of(LOOPS, [trace]).run()
    assert record.results["number"].value == 112
    assert record.firings == {"start": 1, "step": 12, "inner": 12, "outer": 3, "end": 1}
    assert record.rounds == {
        "inner.again -> step.number": 9,
        "outer.again -> step.number": 2,
    }
    assert record.exhausted == ()
    once = ["step", "inner"] * 4 + ["outer"]
    assert trace.fired == ["start", *once * 3, "end"]


def test_what_hangs_on_a_loop_fires_once_however_it_is_written() -> None:
    """The side branch stands before the loop's end in the file, and must still wait."""
    text = """
        stages:
          one:
          step:
            stage: add
            inputs: {number: one.number}
            feedback: {number: {from: last.again, max_rounds: 9}}
          side: {stage: sink, inputs: {number: step.number}}
          late: {stage: one}
          middle: {stage: add, inputs: {number: step.number, other: late.number}}
          last: {stage: until, inputs: {number: middle.number}, settings: {least: 7}}
        """
    record = runner_of(text).run()
    # 1 -> 2 -> 4 (sent back) -> 5 -> 7 (suits)
    assert record.firings == {
        "one": 1,
        "step": 2,
        "side": 1,
        "late": 1,
        "middle": 2,
        "last": 2,
    }


def test_a_used_up_bound_is_recorded_and_the_run_goes_on() -> None:
    text = LOOPS.replace("max_rounds: 100", "max_rounds: 5")
    record = runner_of(text).run()
    # Steps 1-4 take 3 rounds, 5-7 two more; from there on, inner sends back in vain.
    assert record.exhausted == ("inner.again -> step.number",)
    assert record.rounds["inner.again -> step.number"] == 5
    assert record.results["number"].value == 112
    # 4 | 7 | 8 | 9 | 10 | 11 | 12 reach the outer loop.
    assert record.firings == {"start": 1, "step": 12, "inner": 12, "outer": 7, "end": 1}


def test_both_bounds_used_up_still_give_the_best_there_is() -> None:
    text = LOOPS.replace("max_rounds: 100", "max_rounds: 2").replace(": 10}", ": 1}")
    record = runner_of(text).run()
    assert record.exhausted == ("inner.again -> step.number", "outer.again -> step.number")
    assert record.results["number"].value == 104


def test_a_stage_that_feeds_itself() -> None:
    text = """
        stages:
          one:
          until:
            inputs: {number: one.number}
            feedback: {number: {from: until.again, max_rounds: 3}}
            settings: {least: 5}
        results: {number: until.number}
        """
    record = runner_of(text).run()
    assert record.firings["until"] == 4
    assert record.exhausted == ("until.again -> until.number",)


def test_an_output_of_none_puts_nothing_on_its_port() -> None:
    text = """
        stages:
          one:
          silent: {inputs: {number: one.number}}
          add: {inputs: {number: one.number, other: silent.number}}
          sink: {inputs: {number: silent.number}}
        results: {number: add.number}
        """
    record = runner_of(text).run()
    assert record.firings == {"one": 1, "silent": 1, "add": 1, "sink": 0}
    assert record.results["number"].value == 2


def test_an_optional_input_waits_for_its_value() -> None:
    text = """
        stages:
          add: {inputs: {number: one.number, other: slow.number}, settings: {by: 0}}
          slow: {stage: add, inputs: {number: one.number}, settings: {by: 10}}
          one:
        results: {number: add.number}
        """
    record = runner_of(text).run()
    assert record.results["number"].value == 12
    assert record.firings["add"] == 1


def test_a_result_that_does_not_come_about_says_what_never_fired() -> None:
    text = """
        stages:
          one:
          silent: {inputs: {number: one.number}}
          add: {inputs: {number: silent.number}}
        results: {total: add.number}
        """
    with pytest.raises(StageError, match="'total' did not come about") as caught:
        runner_of(text).run()
    assert "never fired: add" in str(caught.value)
    assert "toy.yaml:6" in str(caught.value)
    with pytest.raises(StageError, match="an output stayed empty"):
        runner_of(text.replace("total: add", "total: silent").replace("add: {", "#")).run()


def test_each_run_starts_afresh() -> None:
    runner = runner_of(LOOPS)
    first, second = runner.run(), runner.run()
    assert first.results == second.results
    assert first.firings == second.firings
    assert first.rounds == second.rounds


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "nothing was given for the source 'cloud'"),
        ({"cloud": None}, "nothing was given"),
        ({"clod": cloud(1)}, "did you mean 'cloud'"),
    ],
)
def test_sources_must_be_given_by_their_names(given: dict[str, Any], message: str) -> None:
    text = "{sources: {cloud: }, stages: {size: {inputs: {cloud: sources.cloud}}}, " + (
        "results: {n: size.number}}"
    )
    with pytest.raises(InputError, match=message):
        runner_of(text).run(given)


# --- failing stages


class Broken(Stage[Settings]):
    def __call__(self, number: Number) -> Out:
        raise ZeroDivisionError("by nought")


class Picky(Stage[Settings]):
    def __call__(self, number: Number) -> Out:
        raise InputError("too small", where="point 3", received=number.value)


class Liar(Stage[Settings]):
    def __call__(self, number: Number) -> Out:
        return Out("text")  # type: ignore[arg-type]


class Bare(Stage[Settings]):
    def __call__(self, number: Number) -> Out:
        return number  # type: ignore[return-value]


class Stopped(Stage[Settings]):
    def __call__(self, number: Number) -> Out:
        raise KeyboardInterrupt


ONE_STAGE = """stages:
  one:
  worker:
    stage: bad
    inputs: {number: one.number}
results: {number: worker.number}
"""


def test_an_error_of_the_package_keeps_its_kind_and_gains_the_place() -> None:
    with pytest.raises(InputError, match="too small") as caught:
        runner_of(ONE_STAGE, bad=Picky).run()
    assert caught.value.where == "stage 'worker' (toy.yaml:3), point 3"
    assert caught.value.received == "1"


def test_any_other_error_becomes_a_stage_error_with_its_cause() -> None:
    with pytest.raises(StageError, match="ZeroDivisionError") as caught:
        runner_of(ONE_STAGE, bad=Broken).run()
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert caught.value.where == "stage 'worker' (toy.yaml:3)"
    assert "by nought" in str(caught.value)


@pytest.mark.parametrize(
    ("bad", "message"),
    [(Liar, "'number: Number' has another type"), (Bare, "did not return its result")],
)
def test_a_stage_must_give_what_its_ports_declare(bad: type[Any], message: str) -> None:
    with pytest.raises(StageError, match=message) as caught:
        runner_of(ONE_STAGE, bad=bad).run()
    assert "stage 'worker'" in str(caught.value)


class Compiled(Stage[Settings]):
    """Ends as numba's dispatcher does where a signal meets it."""

    def __call__(self, number: Number) -> Out:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("returned a result with an exception set") from error


class Unsound(Stage[Settings]):
    def __call__(self, number: Number) -> Out:
        raise SystemError("returned a result with an exception set")


@pytest.mark.parametrize("bad", [Stopped, Compiled])
def test_ctrl_c_passes_through(bad: type[Any]) -> None:
    with pytest.raises(KeyboardInterrupt):
        runner_of(ONE_STAGE, bad=bad).run()


def test_a_system_error_without_ctrl_c_is_the_stage_s_fault() -> None:
    with pytest.raises(StageError, match="SystemError"):
        runner_of(ONE_STAGE, bad=Unsound).run()


# --- hooks


def test_hooks_hear_everything_in_order() -> None:
    trace = Trace()
    runner_of(ONE_STAGE, [trace], bad=TOYS["add"]).run()
    shown = [h if isinstance(h, str) else (h.name, h.firing, h.figures) for h in trace.heard]
    assert shown == [
        "run started",
        "one 1",
        ("one", 1, {"value": 1}),
        "worker 1",
        ("worker", 1, {"value": 2}),
        "run finished",
    ]
    assert all(h.seconds >= 0 for h in trace.heard if isinstance(h, StageEvent))


def test_the_base_hook_does_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert runner_of(LOOPS, [Hook()]).run().results["number"].value == 112


def test_a_failing_hook_warns_and_changes_nothing() -> None:
    class Bad(Hook):
        def stage_started(self, name: str, firing: int) -> None:
            raise RuntimeError("oops")

    trace = Trace()
    with pytest.warns(RuntimeWarning, match=r"Bad\.stage_started failed: RuntimeError: oops"):
        record = runner_of(LOOPS, [Bad(), trace]).run()
    assert record.results["number"].value == 112
    assert len(trace.fired) == sum(record.firings.values())


def test_a_hook_may_end_the_run_by_ctrl_c() -> None:
    class Stop(Hook):
        def stage_finished(self, event: StageEvent) -> None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runner_of(LOOPS, [Stop()]).run()


class BadSummary(Number):
    def summary(self) -> dict[str, Any]:
        raise RuntimeError("no figures")


class NoSummaryOut(NamedTuple):
    number: Number
    text: str


class Odd(Stage[Settings]):
    def __call__(self, number: Number) -> NoSummaryOut:
        return NoSummaryOut(BadSummary(3), "plain")


def test_a_failing_summary_warns_and_one_without_is_left_out() -> None:
    trace = Trace()
    with pytest.warns(RuntimeWarning, match="summary of 'number' failed"):
        record = runner_of(ONE_STAGE, [trace], bad=Odd).run()
    assert record.results["number"].value == 3
    assert trace.heard[-2].figures == {}


# --- random graphs


@st.composite
def dags(draw: st.DrawFn) -> str:
    """Stages `s0`, `s1`, … in shuffled order; each collects from some of smaller number."""
    count = draw(st.integers(1, 8))
    lines = []
    for k in range(count):
        above = [j for j in range(k) if draw(st.booleans())]
        if above:
            refs = ", ".join(f"s{j}.number" for j in above)
            lines.append(f"  s{k}: {{stage: join, inputs: {{numbers: [{refs}]}}}}")
        else:
            lines.append(f"  s{k}: {{stage: one}}")
    shuffled = draw(st.permutations(lines))
    results = "".join(f"  r{k}: s{k}.number\n" for k in range(count))
    return "stages:\n" + "\n".join(shuffled) + "\nresults:\n" + results


@settings(max_examples=60, deadline=None)
@given(dags())
def test_random_graphs_fire_each_stage_once_and_in_a_valid_order(text: str) -> None:
    graph = graph_of(text)
    trace = Trace()
    record = Runner(graph, [trace]).run()
    assert sorted(trace.fired) == sorted(graph.stages)
    assert set(record.firings.values()) == {1}
    at = {name: k for k, name in enumerate(trace.fired)}
    for edge in graph.edges:
        assert at[edge.origin] < at[edge.target]
    # A stage without inputs gives 1; one that joins has a digit for each path from such a stage.
    assert all(set(str(n.value)) == {"1"} for n in record.results.values())


@settings(max_examples=40, deadline=None)
@given(dags(), st.randoms(use_true_random=False))
def test_the_order_in_the_file_does_not_change_the_results(text: str, random: Any) -> None:
    head, tail = text.removeprefix("stages:\n").split("\nresults:\n")
    lines = head.split("\n")
    random.shuffle(lines)
    other = "stages:\n" + "\n".join(lines) + "\nresults:\n" + tail
    assert runner_of(text).run().results == runner_of(other).run().results


# --- state over frames


class Tally:
    """What `Count` remembers."""

    def __init__(self) -> None:
        self.total = 0


class CountSettings(Settings):
    by: int = 1


class Count(Stage[CountSettings]):
    """Give how often it was called, times a factor, over all frames."""

    Settings = CountSettings
    State = Tally

    def __call__(self, number: Number, state: Tally) -> Out:
        state.total += self.settings.by
        return Out(Number(state.total))


COUNTING = """
stages:
  start: {stage: one}
  first: {stage: count, inputs: {number: start.number}}
  second: {stage: count, inputs: {number: first.number}, settings: {by: 10}}
results: {number: second.number}
"""


def test_state_is_the_runners_and_shared_by_the_stages_that_name_it() -> None:
    runner = runner_of(COUNTING, count=Count)
    assert [runner.run().results["number"].value for _ in range(3)] == [11, 22, 33]
    assert runner.states[Tally].total == 33
    other = runner_of(COUNTING, count=Count)
    assert other.run().results["number"].value == 11


def test_a_reset_makes_the_state_anew() -> None:
    runner = runner_of(COUNTING, count=Count)
    runner.run()
    runner.reset()
    assert runner.states[Tally].total == 0
    assert runner.run().results["number"].value == 11


def test_state_is_no_port() -> None:
    runner = runner_of(COUNTING, count=Count)
    assert list(runner.graph.ports["first"].inputs) == ["number"]
