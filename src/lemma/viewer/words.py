"""What the panel says, as HTML: whatever users or policies wrote is escaped."""

from collections.abc import Sequence
from html import escape

from lemma.viewer.reading import say_goal
from lemma.viewer.wish import ENDS, Line, Phase, Status

_FRAME = '<div style="padding:0 1em 0.5em;font-size:0.9em;line-height:1.45">{}</div>'
_GOOD, _BAD, _FAINT = "#1f9d55", "#d64545", "#8a8f98"
_COLOR = {
    Phase.SOLVED: _GOOD,
    Phase.FAILED: _BAD,
    Phase.BROKEN: _BAD,
}


def status_html(status: Status) -> str:
    """Return what is said, what was understood, and how it stands."""
    color = _COLOR.get(status.phase, "inherit")
    dots = "" if status.phase in (*ENDS, Phase.READY) else " …"
    title = escape(status.phase.value)
    if status.note and status.phase is not Phase.BROKEN:
        title += f" {escape(status.note)}"
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
    return _FRAME.format("".join(parts))


def complaint_html(text: str) -> str:
    """Return why what was asked for cannot be done."""
    return _FRAME.format(f'<div style="color:{_BAD}">{escape(text)}</div>')


def timeline_html(lines: Sequence[Line], cursor_s: float) -> str:
    """Return the sub-tasks in words, the one that is looked at in bold.

    Args:
        lines: In order.
        cursor_s: Simulated time that is looked at [s].
    """
    if not lines:
        text = f'<div style="color:{_FAINT}">No sub-task yet.</div>'
        return _FRAME.format(text)
    return _FRAME.format(
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
        color = _GOOD if line.ok else _BAD
        outcome = escape(line.outcome.replace("_", " "))
        took = line.end_s - line.start_s
        mark = f'<span style="color:{color}">{outcome}</span>, {took:.1f} s'
        if not line.ok and line.explanation:
            mark += f'<div style="color:{_BAD}">{escape(line.explanation)}</div>'
    return (
        f'<div class="subtask" style="{shade}margin-bottom:0.3em">'
        f'<span style="font-weight:{weight}">{number + 1}. {escape(line.words)}</span> '
        f"{mark}</div>"
    )
