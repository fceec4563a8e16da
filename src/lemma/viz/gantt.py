"""A Gantt chart of an episode as SVG: one row per robot, gaps colored by their cause.

The SVG is embedded in HTML pages. Positions along the time axis are percentages, so a
chart is as wide as its page and its text keeps its size. Every span has its values as
``data-`` attributes; scripts of pages read them and move the cursor.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from html import escape
from itertools import count

from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.subtask import SubTask
from lemma.tasks.teams.dependencies import predecessors
from lemma.viz.annotate import ROBOT_INK
from lemma.viz.recording import Line, Recording


class Cause(StrEnum):
    """How a robot spends its time."""

    BUSY = "at work"
    REGION = "region held"
    """In a sub-task, waiting for a region of the table that another robot holds."""
    PREDECESSOR = "predecessor"
    """Free before a sub-task, until the sub-tasks that it depends on are done."""
    TURN = "turn of another"
    """Free while another robot is in a sub-task, if robots take turns."""
    THINKING = "thinking"
    """Free before a sub-task, although all that it depends on is done."""
    NO_WORK = "no work"
    """Free after its last sub-task."""


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a robot's row."""

    robot: str
    cause: Cause
    start_s: float
    """Simulated time at which it begins [s]."""
    end_s: float
    """Simulated time at which it ends [s]."""
    number: int = 0
    """Number of the sub-task that it belongs to or precedes, from 1; 0 for none."""
    ok: bool = True
    """Whether that sub-task did not fail."""

    @property
    def duration_s(self) -> float:
        """Its duration [s]."""
        return self.end_s - self.start_s


def spans_of(
    instance: Instance,
    lines: Sequence[Line],
    until_s: float,
    *,
    todo: Sequence[SubTask] | None = (),
) -> tuple[Span, ...]:
    """Return the spans of each robot of a team, which cover the whole episode.

    Args:
        instance: The problem.
        lines: The sub-tasks, in any order; lines without a sub-task are skipped.
        until_s: The end of the chart [s]: end of the episode, or the present.
        todo: Planned sub-tasks that have not begun, in order. None if they are unknown;
            then robots that are free now have no span at the end.

    Returns:
        The spans of the first robot in order of time, then those of the next one.
    """
    done = [(k, line, line.subtask) for k, line in enumerate(lines, 1) if line.subtask]
    done.sort(key=lambda one: one[1].start_s)
    begun = [line for _, line, _ in done]
    ready = _ready(instance, begun, todo or ())
    found: list[Span] = []
    for robot in instance.scene.robot_names:
        free_s = 0.0
        for at, (number, line, subtask) in enumerate(done):
            if subtask.robot != robot or line.start_s >= until_s:
                continue
            gap = Span(robot, Cause.THINKING, free_s, line.start_s, number)
            found += _gap(gap, ready[at])
            free_s = min(until_s, until_s if line.end_s is None else line.end_s)
            found += _work(robot, number, line, free_s)
        last = Span(robot, Cause.NO_WORK, free_s, until_s)
        mine = [len(done) + k for k, s in enumerate(todo or ()) if s.robot == robot]
        if mine:
            found += _gap(replace(last, cause=Cause.THINKING), ready[mine[0]])
        elif todo is not None:
            found.append(last)
    if _takes_turns(begun, until_s):
        found = [part for span in found for part in _turns(span, begun)]
    return tuple(span for span in found if span.duration_s > _LEAST_S)


def _ready(
    instance: Instance, lines: Sequence[Line], todo: Sequence[SubTask]
) -> list[float]:
    """Return the times at which each sub-task's predecessors were done [s].

    A time is infinite if they are not done yet.
    """
    steps = [line.subtask for line in lines if line.subtask is not None]
    needs = predecessors((*steps, *todo), tuple(instance.scene.regions))
    ends = [_effect_s(line) for line in lines] + [float("inf")] * len(todo)
    return [max((ends[k] for k in needed), default=0.0) for needed in needs]


def _effect_s(line: Line) -> float:
    if line.effect_s is not None:
        return line.effect_s
    return float("inf") if line.end_s is None else line.end_s


def _takes_turns(lines: Sequence[Line], until_s: float) -> bool:
    """Whether no two robots were in a sub-task at the same time."""
    latest_s = 0.0
    for line in lines:
        if line.start_s < latest_s - _LEAST_S:
            return False
        latest_s = until_s if line.end_s is None else line.end_s
    return True


def _gap(gap: Span, ready_s: float) -> Iterator[Span]:
    """Yield the parts of a gap before and after its sub-task could have begun."""
    ready_s = min(max(ready_s, gap.start_s), gap.end_s)
    yield replace(gap, cause=Cause.PREDECESSOR, end_s=ready_s)
    yield replace(gap, start_s=ready_s)


def _work(robot: str, number: int, line: Line, end_s: float) -> Iterator[Span]:
    """Yield the parts of a sub-task, at work and waiting for a region."""
    at_s = line.start_s
    part = Span(robot, Cause.BUSY, at_s, end_s, number, line.ok)
    for since_s, until_s in line.waits:
        if since_s >= end_s:
            break
        yield replace(part, start_s=at_s, end_s=since_s)
        at_s = min(until_s, end_s)
        yield replace(part, cause=Cause.REGION, start_s=since_s, end_s=at_s)
    yield replace(part, start_s=at_s)


def _turns(span: Span, lines: Sequence[Line]) -> Iterator[Span]:
    """Yield the parts of a gap: turns of other robots, and the rest."""
    if span.cause is not Cause.THINKING:
        yield span
        return
    at_s = span.start_s
    turn = replace(span, cause=Cause.TURN, end_s=span.start_s)
    for line in lines:
        since_s = max(line.start_s, at_s)
        end_s = span.end_s if line.end_s is None else min(line.end_s, span.end_s)
        if end_s <= since_s:
            continue
        if since_s - turn.end_s > _LEAST_S:
            yield turn
            yield replace(span, start_s=turn.end_s, end_s=since_s)
            turn = replace(turn, start_s=since_s)
        at_s, turn = end_s, replace(turn, end_s=end_s)
    yield turn
    yield replace(span, start_s=at_s)


def gantt_svg(
    instance: Instance,
    lines: Sequence[Line],
    until_s: float,
    *,
    now_s: float | None = None,
    axis_s: float = 0.0,
    todo: Sequence[SubTask] | None = (),
) -> str:
    """Return the chart as SVG; an empty string without sub-tasks.

    Args:
        instance: The problem.
        lines: The sub-tasks.
        until_s: As for :func:`spans_of` [s].
        now_s: Position of the cursor [s]; at the beginning if None.
        axis_s: Length of the axis [s], if it is longer than ``until_s``.
        todo: As for :func:`spans_of`.
    """
    if until_s <= 0.0 or not any(line.subtask for line in lines):
        return ""
    spans = spans_of(instance, lines, until_s, todo=todo)
    names, scene = instance.scene.robot_names, instance.scene
    phrases = [phrase.removesuffix(" robot") for phrase in robot_phrases(scene.robots)]
    inks = [_ink(robot.color) for robot in scene.robots]
    scale = _Scale(max(until_s, axis_s))
    labels, rows = [], []
    for number, (name, phrase) in enumerate(zip(names, phrases, strict=True)):
        y = _TOP_PX + number * _ROW_PX
        labels.append(_label(y, phrase, inks[number]))
        mine = [span for span in spans if span.robot == name]
        rows += [_bar(scale, span, y, inks[number], lines) for span in mine]
    low = _TOP_PX + len(names) * _ROW_PX
    seen = {s.cause for s in spans if scale.share(s.duration_s) >= _LEAST_EXPLAINED}
    shown = [cause for cause in Cause if cause in seen]
    legend, high = _legend(shown, low + _AXIS_PX)
    at = scale.at(min(max(now_s or 0.0, 0.0), until_s))
    cursor = (
        f'<line class="cursor" x1="{at}" x2="{at}" y1="0" y2="{low}" '
        f'stroke="currentColor" stroke-width="1.5"/>'
    )
    inner = "".join((*_axis(scale, low), *rows, cursor))
    return (
        f'<svg class="gantt" width="100%" '
        f'height="{high}" data-until="{scale.until_s:.3f}" font-size="11" '
        f'font-family="system-ui, sans-serif" fill="currentColor" role="img">'
        f"<title>Which robot did what, and when</title>"
        f'{"".join(labels)}<svg x="{_LABELS}%" width="{_PLOT}%" overflow="visible">'
        f"{inner}</svg>{legend}</svg>"
    )


def gantt_of(recording: Recording) -> str:
    """Return the chart of a whole episode; an empty string without sub-tasks."""
    return gantt_svg(recording.instance, recording.lines, recording.elapsed_s)


@dataclass(frozen=True, slots=True)
class _Scale:
    """Converts simulated time to a position along the chart."""

    until_s: float

    def share(self, seconds: float) -> float:
        return 100.0 * seconds / self.until_s

    def at(self, seconds: float) -> str:
        return f"{self.share(seconds):.2f}%"


def _ink(color: str) -> str:
    return "#{:02x}{:02x}{:02x}".format(*ROBOT_INK.get(color, (120, 120, 120)))


def _label(y: float, phrase: str, ink: str) -> str:
    middle = y + 0.5 * _BAR_PX
    return (
        f'<circle cx="6" cy="{middle}" r="4.5" fill="{ink}" stroke="{_EDGE}"/>'
        f'<text x="15" y="{middle + 4}">{escape(phrase)}</text>'
    )


def _bar(scale: _Scale, span: Span, y: float, ink: str, lines: Sequence[Line]) -> str:
    """Return a span as a bar, low where its robot is free, with its number in it."""
    in_subtask = span.cause in (Cause.BUSY, Cause.REGION)
    height = _BAR_PX if in_subtask else _GAP_PX
    top = y + 0.5 * (_BAR_PX - height)
    fill = ink if span.cause is Cause.BUSY else _FILLS[span.cause]
    edge = _EDGE if span.ok else _BAD
    words = str(span.cause)
    if span.number:
        joint = ", " if in_subtask else " before "
        words += f"{joint}{span.number}. {lines[span.number - 1].words}"
    attributes = (
        f'data-robot="{escape(span.robot)}" data-cause="{span.cause}" '
        f'data-number="{span.number}" data-start="{span.start_s:.3f}" '
        f'data-end="{span.end_s:.3f}"'
    )
    bar = (
        f'<rect class="span" {attributes} x="{scale.at(span.start_s)}" y="{top}" '
        f'width="{scale.at(span.duration_s)}" height="{height}" fill="{fill}" '
        f'stroke="{edge}" stroke-width="{0.8 if span.ok else 2}" rx="2">'
        f"<title>{escape(words)}: {span.start_s:.1f} to {span.end_s:.1f} s</title>"
        "</rect>"
    )
    if span.cause is not Cause.BUSY or scale.share(span.duration_s) < _LEAST_NUMBERED:
        return bar
    middle = scale.at(span.start_s + 0.5 * span.duration_s)
    number = f"{span.number}" if span.ok else f"{span.number} ✗"
    return bar + (
        f'<text x="{middle}" y="{y + 0.5 * _BAR_PX + 4}" text-anchor="middle" '
        f'fill="{_text_ink(ink)}" pointer-events="none">{number}</text>'
    )


def _text_ink(ink: str) -> str:
    """Return black or white, whichever is legible on a color."""
    red, green, blue = (int(ink[k : k + 2], 16) for k in (1, 3, 5))
    return "#181c22" if 0.3 * red + 0.59 * green + 0.11 * blue > 150.0 else "#ffffff"


def _axis(scale: _Scale, low: float) -> Iterator[str]:
    """Yield a line and a number at round times."""
    step = next(s for s in _STEPS_S if scale.until_s / s <= _MOST_TICKS)
    for k in count():
        seconds = k * step
        if seconds > scale.until_s:
            return
        at = scale.at(seconds)
        last = seconds + step > scale.until_s
        # Pages crop the chart at its edges.
        anchor = "end" if scale.share(seconds) > _NEAR_END else "middle"
        yield (
            f'<line x1="{at}" x2="{at}" y1="{_TOP_PX}" y2="{low}" '
            f'stroke="currentColor" stroke-opacity="0.15"/>'
            f'<text x="{at}" y="{low + 11}" text-anchor="{anchor}" '
            f'fill-opacity="0.65">{seconds:g}{" s" if last else ""}</text>'
        )


def _legend(causes: Sequence[Cause], y: float) -> tuple[str, float]:
    """Return the legend of the gaps' colors, in columns, and its lower end [px]."""
    gaps = [cause for cause in causes if cause is not Cause.BUSY]
    parts = []
    for number, cause in enumerate(gaps):
        row, column = divmod(number, _COLUMNS)
        at = y + row * _LEGEND_PX
        parts.append(
            f'<svg x="{100 * column / _COLUMNS:.2f}%" overflow="visible">'
            f'<rect class="key" x="1" y="{at + 2}" width="12" height="8" rx="2" '
            f'fill="{_FILLS[cause]}" stroke="{_EDGE}" stroke-width="0.8"/>'
            f'<text x="18" y="{at + 10}" fill-opacity="0.8">{cause}</text></svg>'
        )
    rows = -(-len(gaps) // _COLUMNS)
    return "".join(parts), y + rows * _LEGEND_PX


_FILLS = {
    Cause.REGION: "#8b4fc6",
    Cause.PREDECESSOR: "#eda52f",
    Cause.TURN: "#b6bcc4",
    Cause.THINKING: "#39a9b8",
    Cause.NO_WORK: "none",
}
_EDGE, _BAD = "#8a8f98", "#d64545"
_LEAST_S = 1e-6
"""Shorter spans are left out [s]."""
_TOP_PX, _ROW_PX, _BAR_PX, _GAP_PX, _AXIS_PX, _LEGEND_PX = 4, 22, 16, 6, 20, 16
_LABELS, _PLOT = 17, 82
"""Widths of the robots' names and of their rows [% of the chart]."""
_LEAST_NUMBERED = 4.5
"""Least width of a bar with a number [% of the rows]."""
_LEAST_EXPLAINED = 0.5
"""Least width of a gap whose color is in the legend [% of the rows]."""
_NEAR_END = 96.0
"""Position from which the number of a time is right-aligned [% of the rows]."""
_COLUMNS, _MOST_TICKS = 3, 6
_STEPS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 1000.0)
