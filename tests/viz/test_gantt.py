"""The Gantt chart: its spans are what the lines say, and it is safe on a page."""

from dataclasses import replace
from itertools import groupby, pairwise
from typing import Any
from xml.etree import ElementTree

import pytest
from recorded_episodes import INDEX, acted_together
from tiers import slow_but

from lemma.core.seeding import ordered_sum
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.suite import load_instance
from lemma.viz.gantt import Cause, Span, gantt_svg, spans_of
from lemma.viz.recording import Line, Recording, record, record_together

INSTANCE = load_instance("carousel", "test", INDEX)
ROBOTS = INSTANCE.scene.robot_names
EVIL = "<script>&\"'"


def line(
    robot: int,
    start_s: float,
    end_s: float | None,
    pick: str,
    place: str,
    **more: Any,
) -> Line:
    subtask = SubTask(ROBOTS[robot], Primitive.MOVE, pick, place)
    made = Line(EVIL, start_s, end_s, "success", subtask=subtask)
    return replace(made, **more)


def row(spans: tuple[Span, ...], robot: int) -> list[tuple[str, float, float]]:
    return [
        (str(span.cause), span.start_s, span.end_s)
        for span in spans
        if span.robot == ROBOTS[robot]
    ]


@pytest.fixture(scope="module")
def together() -> Recording:
    return record_together(INSTANCE)


@pytest.fixture(scope="module")
def turns() -> Recording:
    return record(load_instance("stack", "test", 0))


def test_gaps_are_named_by_what_was_missing() -> None:
    lines = (
        line(0, 0.0, 8.0, "red_cube", "shared_01", effect_s=6.0),
        line(1, 7.0, 15.0, "red_cube", "red_pad", waits=((8.0, 9.0), (11.0, 12.0))),
        line(2, 2.0, 5.0, "blue_cube", "shared_12"),
    )
    spans = spans_of(INSTANCE, lines, 16.0)
    assert row(spans, 0) == [("at work", 0.0, 8.0), ("no work", 8.0, 16.0)]
    assert row(spans, 1) == [
        ("predecessor", 0.0, 6.0),
        ("thinking", 6.0, 7.0),
        ("at work", 7.0, 8.0),
        ("region held", 8.0, 9.0),
        ("at work", 9.0, 11.0),
        ("region held", 11.0, 12.0),
        ("at work", 12.0, 15.0),
        ("no work", 15.0, 16.0),
    ]
    assert row(spans, 2)[0] == ("thinking", 0.0, 2.0)
    assert row(spans, 3) == [("no work", 0.0, 16.0)]
    assert {span.number for span in spans if span.robot == ROBOTS[1]} == {0, 2}


def test_where_robots_take_turns_gaps_are_the_turns_of_others() -> None:
    lines = (
        line(0, 0.0, 3.0, "red_cube", "shared_01"),
        line(2, 3.0, 5.0, "blue_cube", "shared_12"),
        line(1, 6.0, 9.0, "green_cube", "green_pad"),
    )
    spans = spans_of(INSTANCE, lines, 9.0)
    assert row(spans, 1) == [
        ("turn of another", 0.0, 5.0),
        ("thinking", 5.0, 6.0),
        ("at work", 6.0, 9.0),
    ]


def test_present_says_no_more_than_is_known() -> None:
    lines = (line(0, 1.0, None, "red_cube", "shared_01", waits=((2.0, 3.0),)),)
    todo = (
        SubTask(ROBOTS[1], Primitive.MOVE, "red_cube", "red_pad"),
        SubTask(ROBOTS[2], Primitive.MOVE, "blue_cube", "shared_12"),
    )
    assert row(spans_of(INSTANCE, lines, 4.0, todo=None), 0) == [
        ("thinking", 0.0, 1.0),
        ("at work", 1.0, 2.0),
        ("region held", 2.0, 3.0),
        ("at work", 3.0, 4.0),
    ]
    assert not row(spans_of(INSTANCE, lines, 4.0, todo=None), 3)
    known = spans_of(INSTANCE, lines, 4.0, todo=todo)
    assert row(known, 1) == [("predecessor", 0.0, 4.0)]
    assert row(known, 3) == [("no work", 0.0, 4.0)]


@pytest.mark.parametrize("way", slow_but(["together", "turns"], "turns"))
def test_spans_of_an_episode_are_its_lines(
    way: str, request: pytest.FixtureRequest
) -> None:
    done: Recording = request.getfixturevalue(way)
    spans = spans_of(done.instance, done.lines, done.elapsed_s)
    for robot, mine in groupby(spans, key=lambda span: span.robot):
        parts = [*mine]
        assert parts[0].start_s == 0.0
        assert parts[-1].end_s == done.elapsed_s
        assert all(a.end_s == b.start_s for a, b in pairwise(parts))
        at_work = [s for s in parts if s.cause in (Cause.BUSY, Cause.REGION)]
        for number, step in enumerate(done.lines, 1):
            assert step.subtask is not None
            pieces = [span for span in at_work if span.number == number]
            assert bool(pieces) == (step.subtask.robot == robot)
            if pieces:
                assert pieces[0].start_s == step.start_s
                assert pieces[-1].end_s == step.end_s
    causes = {span.cause for span in spans}
    assert (Cause.TURN in causes) == (way == "turns")


@pytest.mark.slow
def test_waits_are_those_that_the_reservations_count(together: Recording) -> None:
    done = acted_together("carousel")
    assert sorted(step.start_s for step in done.steps) == [
        line.start_s for line in together.lines
    ]
    spans = spans_of(INSTANCE, together.lines, together.elapsed_s)
    for robot in ROBOTS:
        held = [s for s in spans if s.robot == robot and s.cause is Cause.REGION]
        waited_s = ordered_sum(span.duration_s for span in held)
        assert waited_s == pytest.approx(
            done.waited_s.get(robot, 0.0), abs=0.011 * len(held)
        )
    for step in together.lines:
        assert step.effect_s is not None
        assert step.end_s is not None
        assert step.start_s < step.effect_s < step.end_s


@pytest.mark.slow
def test_chart_has_a_bar_for_each_span_and_no_markup_of_others(
    together: Recording,
) -> None:
    lines = [replace(one, words=EVIL) for one in together.lines]
    lines[0] = replace(lines[0], ok=False)
    root = ElementTree.fromstring(
        gantt_svg(INSTANCE, lines, together.elapsed_s, now_s=0.5 * together.elapsed_s)
    )
    bars = root.findall(".//rect[@class='span']")
    spans = spans_of(INSTANCE, lines, together.elapsed_s)
    assert [(b.get("data-robot"), b.get("data-cause")) for b in bars] == [
        (span.robot, str(span.cause)) for span in spans
    ]
    for bar, span in zip(bars, spans, strict=True):
        assert float(bar.get("data-start", "")) == pytest.approx(span.start_s, abs=1e-3)
        share = 100.0 * span.start_s / together.elapsed_s
        assert float(bar.get("x", "").rstrip("%")) == pytest.approx(share, abs=0.01)
    texts = [text.text for text in root.iter("text")]
    assert {"red", "white", "blue", "green", "region held"} <= set(texts)
    assert any("✗" in (text or "") for text in texts)
    cursor = root.find(".//line[@class='cursor']")
    assert cursor is not None
    assert cursor.get("x1") == "50.00%"
    titles = [title.text or "" for title in root.iter("title")]
    assert any(EVIL in title for title in titles)


def test_there_is_no_chart_of_what_is_no_sub_task() -> None:
    assert gantt_svg(INSTANCE, [Line("Led by hand", 0.0, 5.0)], 5.0) == ""
    assert gantt_svg(INSTANCE, [], 5.0) == ""
