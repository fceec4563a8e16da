"""Texts of the panel as HTML; sentences of users and policies are escaped."""

from collections.abc import Sequence
from html import escape

from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.subtask import Primitive
from lemma.viewer.episode.explanation import Explanation
from lemma.viewer.episode.status import ENDS, Phase, Status, say_goal
from lemma.viz.recording import Line, describe_subtask

FRAME = '<div style="padding:0 1em 0.5em;font-size:0.9em;line-height:1.45">{}</div>'
GOOD, BAD, _FAINT = "#1f9d55", "#d64545", "#8a8f98"
_LEAST_SHARE = 0.01
_COLOR = {
    Phase.SOLVED: GOOD,
    Phase.FAILED: BAD,
    Phase.BROKEN: BAD,
}


def status_html(status: Status) -> str:
    """Return the sentence, its reading, and the status."""
    color = _COLOR.get(status.phase, "inherit")
    dots = "" if status.phase in (*ENDS, Phase.READY) else " …"
    title = escape(status.phase.value)
    if status.note and status.phase is not Phase.BROKEN:
        colon = ":" if status.phase is Phase.FOLLOWED else ""
        title += f"{colon} {escape(status.note)}"
    parts = [
        f'<div data-phase="{escape(status.phase.name)}" style="font-weight:600;'
        f'color:{color}">{title}{dots}</div>'
    ]
    if status.note and status.phase is Phase.BROKEN:
        parts.append(f'<div style="color:{color}">{escape(status.note)}</div>')
    if status.said:
        parts.append(f"<div><i>“{escape(status.said)}”</i></div>")
    if status.reading is not None:
        goal = say_goal(status.reading.pairs) if status.reading.pairs else ""
        told = ", ".join(part for part in (goal, status.reading.note) if part)
        label = "Understood: " if goal else ""
        parts.append(f'<div class="understood">{label}{escape(told)}</div>')
    return FRAME.format("".join(parts))


def complaint_html(text: str) -> str:
    """Return the reason why something cannot be done."""
    return FRAME.format(f'<div style="color:{BAD}">{escape(text)}</div>')


def table_html(own: bool, problems: Sequence[str]) -> str:
    """Return whether the table is an own one, and its problems.

    Args:
        own: Whether it was changed; else it is of a list.
        problems: Of it, in sentences.
    """
    if not own:
        return FRAME.format(f'<div style="color:{_FAINT}">Of the task\'s list.</div>')
    parts = ["<div>Your own table.</div>"]
    parts += [
        f'<div class="problem" style="color:{BAD}">{escape(told)}</div>'
        for told in problems
    ]
    return FRAME.format("".join(parts))


def why_html(explanation: Explanation, instance: Instance) -> str:
    """Return why a policy decided as it did: its options, and who reaches what.

    Args:
        explanation: Of one decision; the result is empty where the policy said nothing.
        instance: Of the robots and objects.
    """
    insight = explanation.insight
    if insight is None:
        return ""
    parts = ["<div style='font-weight:600'>Why</div>"]
    for subtask, share in insight.options:
        if share < _LEAST_SHARE and subtask is not insight.options[0][0]:
            continue
        words = "stop: the goal is reached"
        if subtask.primitive is not Primitive.STOP:
            words = describe_subtask(subtask, instance)
        parts.append(f'<div class="option">{share:.0%} {escape(words)}</div>')
    named = {name for pair in insight.goal for name in pair}
    phrases = robot_phrases(instance.scene.robots)
    rows = []
    for thing in insight.objects:
        if thing.name in named:
            cells = "".join(
                f"<td>{_margin(robot.margin_m(thing.at))}</td>"
                for robot in insight.robots
            )
            what = escape(entity_named(thing.name).phrase)
            rows.append(f"<tr><td>{what}</td>{cells}</tr>")
    seen = {thing.name for thing in insight.objects}
    covers = {lower: upper for lower, upper in explanation.covers if lower in named}
    hidden = {name: top for name, top in covers.items() if name not in seen}
    unseen = sorted(named - seen - set(hidden))
    head = "".join(f"<td>{escape(phrase)}</td>" for phrase in phrases)
    parts.append(
        f'<table style="width:100%"><tr style="color:{_FAINT}"><td>reaches</td>{head}'
        f"</tr>{''.join(rows)}</table>"
    )
    for name, top in sorted(hidden.items()):
        words = f"The {entity_named(top).phrase} hides the {entity_named(name).phrase}."
        parts.append(f"<div>{escape(words)}</div>")
    if unseen:
        words = " and no ".join(entity_named(name).phrase for name in unseen)
        parts.append(f"<div>It sees no {escape(words)}.</div>")
    return FRAME.format("".join(parts))


def _margin(margin_m: float) -> str:
    """Return the distance inside of a reach, or beyond it, in words."""
    if margin_m < 0.0:
        return f'<span style="color:{BAD}">{-100 * margin_m:.0f} cm too far</span>'
    return f'<span style="color:{GOOD}">{100 * margin_m:.0f} cm inside</span>'


def timeline_html(lines: Sequence[Line], cursor_s: float) -> str:
    """Return the sub-tasks in words, the one at the cursor in bold.

    Args:
        lines: In order.
        cursor_s: Simulated time of the cursor [s].
    """
    if not lines:
        text = f'<div style="color:{_FAINT}">No sub-task yet.</div>'
        return FRAME.format(text)
    return FRAME.format(
        "".join(_row(i, line, cursor_s) for i, line in enumerate(lines))
    )


def _row(number: int, line: Line, cursor_s: float) -> str:
    over = line.end_s is not None and cursor_s >= line.end_s
    runs = line.start_s <= cursor_s and not over
    weight = "600" if runs else "400"
    shade = "" if over or runs else "opacity:0.45;"
    if line.end_s is None or not over:
        mark = f'<span style="color:{_FAINT}">{line.start_s:.1f} s</span>'
    else:
        color = GOOD if line.ok else BAD
        outcome = escape(line.outcome.replace("_", " "))
        took = line.end_s - line.start_s
        mark = f'<span style="color:{color}">{outcome}</span>, {took:.1f} s'
        if not line.ok and line.explanation:
            mark += f'<div style="color:{BAD}">{escape(line.explanation)}</div>'
    return (
        f'<div class="subtask" style="{shade}margin-bottom:0.3em">'
        f'<span style="font-weight:{weight}">{number + 1}. {escape(line.words)}</span> '
        f"{mark}</div>"
    )
