"""Small charts as SVG, drawn with the colors of the page that they stand in.

The page's style gives the colors: `--ink`, `--faint`, `--line`, `--bar` and `--paper`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

WIDTH = 560
_LABEL = 118
_NUMBER = 58
_ROW = 26
_BAR = 16
_AXIS = 50
_COUNTS = 66
_BINS = 40
_PLOT = WIDTH - _LABEL - _NUMBER
_GOOD_STEPS = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class Part:
    """A piece of a stacked bar."""

    name: str
    value: float
    fill: str
    """A color of CSS."""


@dataclass(frozen=True, slots=True)
class Range:
    """A bar from the least to the most, with a dot at the mean."""

    label: str
    least: float
    mean: float
    most: float


def stacked(
    rows: Sequence[tuple[str, Sequence[Part], str]],
    title: str,
    even: int | None = None,
) -> str:
    """Return bars of equal length, divided into parts.

    Args:
        rows: Label, parts, and what to say at the end of each bar.
        title: What is shown, for those who cannot see it; the axis too.
        even: Number of parts that should be equal: the axis shows where they should
            end; None if they need not be.
    """
    height = len(rows) * _ROW
    ticks = [i / (even or 2) for i in range((even or 2) + 1)]
    shapes = [_grid(_LABEL + _PLOT * t, height, f"{t:.0%}") for t in ticks]
    for i, (label, parts, note) in enumerate(rows):
        y = i * _ROW
        total = sum(part.value for part in parts) or 1.0
        x = float(_LABEL)
        shapes.append(_text(_LABEL - 8, y + _ROW / 2, label, "end"))
        for part in parts:
            width = _PLOT * part.value / total
            shapes.append(
                f'<rect class="part" x="{x:.1f}" y="{y + 5}" width="{width:.1f}" '
                f'height="{_BAR}" style="fill:{part.fill}"><title>{escape(label)}: '
                f"{escape(part.name)} {part.value:g} ({part.value / total:.1%})"
                "</title></rect>"
            )
            x += width
        shapes.append(_text(WIDTH, y + _ROW / 2, note, "end", "faint"))
    shapes += [
        f'<line class="guide" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height}"/>'
        for x in (_LABEL + _PLOT * tick for tick in ticks[1:-1])
        if even is not None
    ]
    shapes.append(_axis_title(_LABEL + _PLOT / 2, height, title))
    return _svg(shapes, height + _AXIS, title)


def rates(rows: Sequence[tuple[str, float]], title: str) -> str:
    """Return bars from 0 to 100%.

    Args:
        rows: Label, and value from 0 to 1.
        title: What is shown: the axis.
    """
    height = len(rows) * _ROW
    shapes = [
        _grid(_LABEL + _PLOT * tick, height, f"{tick:.0%}")
        for tick in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    for i, (label, value) in enumerate(rows):
        y, note = i * _ROW, f"{value:.1%}"
        shapes.append(_text(_LABEL - 8, y + _ROW / 2, label, "end"))
        shapes.append(_bar(_LABEL, y + 5, _PLOT * value, _BAR, note))
        shapes.append(_text(WIDTH, y + _ROW / 2, note, "end", "faint"))
    shapes.append(_axis_title(_LABEL + _PLOT / 2, height, title))
    return _svg(shapes, height + _AXIS, title)


def ranges(rows: Sequence[Range], unit: str, title: str) -> str:
    """Return one line per row from the least to the most, with a dot at the mean.

    Args:
        rows: What to show, zero or more.
        unit: Unit of the numbers.
        title: What is shown: the axis, without the unit.
    """
    ticks = _ticks(0.0, max((row.most for row in rows), default=1.0))
    scale = _PLOT / (ticks[-1] or 1.0)
    height = len(rows) * _ROW
    shapes = [_grid(_LABEL + tick * scale, height, f"{tick:g}") for tick in ticks]
    for i, row in enumerate(rows):
        y = i * _ROW + _ROW / 2
        left, right = _LABEL + row.least * scale, _LABEL + row.most * scale
        words = f"{row.least:.1f} to {row.most:.1f} {unit}, mean {row.mean:.1f} {unit}"
        shapes.append(_text(_LABEL - 8, y, row.label, "end"))
        shapes.append(
            f'<g class="range"><title>{escape(row.label)}: {escape(words)}</title>'
            f'<line x1="{left:.1f}" x2="{right:.1f}" y1="{y}" y2="{y}"/>'
            f'<circle cx="{_LABEL + row.mean * scale:.1f}" cy="{y}" r="5"/></g>'
        )
        shapes.append(_text(WIDTH, y, f"{row.mean:.1f} {unit}", "end", "faint"))
    shapes.append(_axis_title(_LABEL + _PLOT / 2, height, f"{title} [{unit}]"))
    return _svg(shapes, height + _AXIS, title)


def histogram(values: Sequence[float], unit: str, title: str, counted: str) -> str:
    """Return how often values occur.

    Args:
        values: The values, at least one.
        unit: Unit of the values.
        title: What is shown: the axis, without the unit.
        counted: What there is one of per value: the axis of counts.
    """
    ticks = _ticks(min(values), max(values))
    low, high = ticks[0], max(ticks[-1], ticks[0] + 1e-9)
    counts = [0] * _BINS
    for value in values:
        place = int((value - low) / (high - low) * _BINS)
        counts[min(max(place, 0), _BINS - 1)] += 1
    height, top = 8 * _ROW, 10
    levels = [level for level in _ticks(0, max(counts)) if level == int(level)]
    left, right = _COUNTS, WIDTH - 16
    width = (right - left) / _BINS
    shapes = [
        _grid(left + (t - low) / (high - low) * (right - left), height, f"{t:g}")
        for t in ticks
    ]
    for level in levels:
        y = height - (height - top) * level / levels[-1]
        shapes.append(
            f'<line class="grid" x1="{left}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>'
            + _text(left - 6, y, f"{level:,.0f}", "end", "faint")
        )
    for i, count in enumerate(counts):
        start = low + i * (high - low) / _BINS
        words = f"{start:.3g} to {start + (high - low) / _BINS:.3g} {unit}: {count}"
        tall = (height - top) * count / levels[-1]
        shapes.append(_bar(left + i * width, height - tall, width - 1, tall, words))
    shapes.append(_axis_title((left + right) / 2, height, f"{title} [{unit}]"))
    shapes.append(
        f'<g transform="rotate(-90)">'
        f"{_text(-height / 2, 8, counted, 'middle', 'faint')}</g>"
    )
    return _svg(shapes, height + _AXIS, title)


def legend(parts: Sequence[Part]) -> str:
    """Return the names of parts beside their colors, as HTML."""
    entries = (
        f'<span><i style="background:{part.fill}"></i>{escape(part.name)}</span>'
        for part in parts
    )
    return f'<p class="legend">{"".join(entries)}</p>'


def _ticks(low: float, high: float) -> list[float]:
    """Return round numbers that cover a range."""
    span = max(high - low, 1e-9)
    power = 10.0 ** math.floor(math.log10(span / 4))
    step = next(power * s for s in _GOOD_STEPS if power * s * 5 >= span)
    first, last = math.floor(low / step), math.ceil(high / step)
    return [round(i * step, 9) for i in range(first, last + 1)]


def _grid(x: float, height: float, label: str) -> str:
    return (
        f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height}"/>'
        + _text(x, height + 16, label, "middle", "faint")
    )


def _axis_title(x: float, height: float, words: str) -> str:
    return _text(x, height + 38, words, "middle", "faint")


def _bar(x: float, y: float, width: float, height: float, words: str) -> str:
    return (
        f'<rect class="bar" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" '
        f'height="{height:.1f}"><title>{escape(words)}</title></rect>'
    )


def _text(x: float, y: float, words: str, anchor: str, style: str = "") -> str:
    kind = f' class="{style}"' if style else ""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{kind} '
        f'dominant-baseline="central">{escape(words)}</text>'
    )


def _svg(shapes: Sequence[str], height: float, title: str) -> str:
    return (
        f'<svg viewBox="0 0 {WIDTH} {height + 6:g}" role="img" '
        f'aria-label="{escape(title)}">{"".join(shapes)}</svg>'
    )
