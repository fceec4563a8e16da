"""Small charts as SVG, drawn with the colours of the page that they stand in.

The page's style gives the colours: `--ink`, `--faint`, `--line`, `--bar` and `--paper`.
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
_AXIS = 30
_BINS = 40
_PLOT = WIDTH - _LABEL - _NUMBER
_GOOD_STEPS = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class Part:
    """A piece of a stacked bar."""

    name: str
    value: float
    fill: str
    """A colour of CSS."""


@dataclass(frozen=True, slots=True)
class Range:
    """A bar from the least to the most, with a dot at the mean."""

    label: str
    least: float
    mean: float
    most: float


def stacked(rows: Sequence[tuple[str, Sequence[Part], str]], title: str) -> str:
    """Return bars of equal length, divided into parts.

    Args:
        rows: Label, parts, and what to say at the end of each bar.
        title: What is shown, for those who cannot see it.
    """
    shapes = []
    for i, (label, parts, note) in enumerate(rows):
        y = i * _ROW
        total = sum(part.value for part in parts) or 1.0
        x = float(_LABEL)
        shapes.append(_text(_LABEL - 8, y + _ROW / 2, label, "end"))
        for part in parts:
            width = _PLOT * part.value / total
            shapes.append(
                f'<rect x="{x:.1f}" y="{y + 5}" width="{width:.1f}" height="{_BAR}" '
                f'fill="{part.fill}" stroke="var(--line)"><title>{escape(label)}: '
                f"{escape(part.name)} {part.value:g} ({part.value / total:.1%})"
                "</title></rect>"
            )
            x += width
        shapes.append(_text(WIDTH, y + _ROW / 2, note, "end", "faint"))
    return _svg(shapes, len(rows) * _ROW, title)


def bars(rows: Sequence[tuple[str, float, str]], title: str) -> str:
    """Return bars from zero.

    Args:
        rows: Label, value of zero or more, and the value in words.
        title: What is shown.
    """
    most = max((value for _, value, _ in rows), default=0.0) or 1.0
    shapes = []
    for i, (label, value, note) in enumerate(rows):
        y = i * _ROW
        shapes.append(_text(_LABEL - 8, y + _ROW / 2, label, "end"))
        shapes.append(_bar(_LABEL, y + 5, _PLOT * value / most, _BAR, note))
        shapes.append(_text(WIDTH, y + _ROW / 2, note, "end", "faint"))
    return _svg(shapes, len(rows) * _ROW, title)


def ranges(rows: Sequence[Range], unit: str, title: str) -> str:
    """Return one line per row from the least to the most, with a dot at the mean.

    Args:
        rows: What to show, zero or more.
        unit: Unit of the numbers.
        title: What is shown.
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
    return _svg(shapes, height + _AXIS, title)


def histogram(values: Sequence[float], unit: str, title: str) -> str:
    """Return how often values occur.

    Args:
        values: The values, at least one.
        unit: Unit of the values.
        title: What is shown.
    """
    ticks = _ticks(min(values), max(values))
    low, high = ticks[0], max(ticks[-1], ticks[0] + 1e-9)
    counts = [0] * _BINS
    for value in values:
        place = int((value - low) / (high - low) * _BINS)
        counts[min(max(place, 0), _BINS - 1)] += 1
    edge, height = 28, 150
    most, width = max(counts), (WIDTH - 2 * edge) / _BINS
    shapes = [
        _grid(edge + (t - low) / (high - low) * _BINS * width, height, f"{t:g} {unit}")
        for t in ticks
    ]
    for i, count in enumerate(counts):
        start = low + i * (high - low) / _BINS
        words = f"{start:.3g} to {start + (high - low) / _BINS:.3g} {unit}: {count}"
        tall = height * count / most
        shapes.append(_bar(edge + i * width, height - tall, width - 1, tall, words))
    return _svg(shapes, height + _AXIS, title)


def legend(parts: Sequence[Part]) -> str:
    """Return the names of parts beside their colours, as HTML."""
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


def _bar(x: float, y: float, width: float, height: float, words: str) -> str:
    return (
        f'<rect class="bar" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" '
        f'height="{height:.1f}"><title>{escape(words)}</title></rect>'
    )


def _text(x: float, y: float, words: str, anchor: str, style: str = "") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" class="{style}" '
        f'dominant-baseline="central">{escape(words)}</text>'
    )


def _svg(shapes: Sequence[str], height: float, title: str) -> str:
    return (
        f'<svg viewBox="0 0 {WIDTH} {height + 6:g}" role="img" '
        f'aria-label="{escape(title)}">{"".join(shapes)}</svg>'
    )
