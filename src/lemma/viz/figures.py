"""Plots for papers: SVG that looks the same in a page, an editor and a PDF.

Series differ by color and by shape, parts of bars by color and by hatching, so that
nothing depends on colors. Colors are those of Okabe and Ito. Each is written as
``var(--name, #color)``: a page may set others for a dark background, and
:func:`standalone` leaves the plain color.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

WIDTH = 720
_LABEL = 128
_RIGHT = 22
_LANE = 13
_SIZE = 13
_PLOT = WIDTH - _LABEL - _RIGHT
_LETTER = 6.6
"""Mean width of a letter [px], good enough to place what stands beside text."""
_TALL = 280
_TICKS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
INK = "var(--ink, #181c22)"
FAINT = "var(--faint, #5d6672)"
_LINE = "var(--line, #d5d8dc)"
_PAPER = "var(--card, #ffffff)"
_HUES = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"),
    *("#5d6672", "#8c510a", "#762a83", "#35978f", "#bf812d", "#9970ab"),
)
_VARIABLE = re.compile(r"var\(--[\w-]+, ([^)]+)\)")


@dataclass(frozen=True, slots=True)
class Mark:
    """One value of a series, from 0 to 1."""

    value: float
    low: float
    """Where its whisker begins."""
    high: float
    """Where its whisker ends."""
    words: str
    """What it says to those who point at it."""
    reference: float | None = None
    """Another value to compare it with, if any."""


@dataclass(frozen=True, slots=True)
class Series:
    """Values of one policy, one for each category; None where there is none."""

    name: str
    marks: tuple[Mark | None, ...]


@dataclass(frozen=True, slots=True)
class Bar:
    """A bar that is divided into parts."""

    label: str
    note: str
    """At its end."""
    parts: tuple[float, ...]
    """Shares of the whole, from 0 to 1 in all."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot, ready to stand in a page or in a file."""

    name: str
    """Of its file."""
    title: str
    caption: str
    svg: str


def standalone(svg: str) -> str:
    """Return a plot as the content of a file: plain colors, no style sheet needed."""
    return _VARIABLE.sub(r"\1", svg) + "\n"


def dots(categories: Sequence[str], series: Sequence[Series], axis: str) -> str:
    """Return values with whiskers: categories from top to bottom, a lane per series.

    A thin line across a lane shows the value to compare with.

    Args:
        categories: Names of the rows.
        series: What to show, at least one.
        axis: What the values are.
    """
    shapes, top = _legend([_entry(i, one.name) for i, one in enumerate(series)])
    row = _LANE * max(len(series), 2) + 10
    bottom = top + row * len(categories)
    shapes += [_grid_x(tick, top, bottom) for tick in _TICKS]
    for j, category in enumerate(categories):
        y = top + j * row
        if j % 2:
            shapes.append(_band(_LABEL, y, _PLOT, row))
        shapes.append(_text(_LABEL - 10, y + row / 2, category, "end"))
        for i, one in enumerate(series):
            mark = one.marks[j]
            if mark is not None:
                lane = y + row / 2 + (i - (len(series) - 1) / 2) * _LANE
                shapes.append(_dot_in_lane(i, mark, lane, f"{one.name}, {category}"))
    shapes.append(_text(_LABEL + _PLOT / 2, bottom + 40, axis, "middle", FAINT))
    return _svg(shapes, bottom + 52, axis)


def lines(
    categories: Sequence[str], series: Sequence[Series], axes: tuple[str, str]
) -> str:
    """Return values with whiskers, joined by lines: categories from left to right.

    Args:
        categories: Names along the horizontal axis.
        series: What to show, at least one.
        axes: What the categories are, and what the values are.
    """
    shapes, top = _legend([_entry(i, one.name) for i, one in enumerate(series)])
    top += 6
    left, right, bottom = 72, WIDTH - _RIGHT, top + _TALL
    for tick in _TICKS:
        y = bottom - tick * _TALL
        shapes.append(_stroke(left, y, right, y, _LINE, 1))
        shapes.append(_text(left - 10, y, f"{100 * tick:.0f}", "end", FAINT))
    step = (right - left) / len(categories)
    apart = min(11.0, 0.7 * step / len(series))
    for j, category in enumerate(categories):
        shapes.append(_text(left + (j + 0.5) * step, bottom + 18, category, "middle"))
    for i, one in enumerate(series):
        shift = (i - (len(series) - 1) / 2) * apart
        points = [
            (left + (j + 0.5) * step + shift, bottom - mark.value * _TALL, mark, name)
            for j, (name, mark) in enumerate(zip(categories, one.marks, strict=True))
            if mark is not None
        ]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y, *_ in points)
        style = f"fill:none;stroke:{_hue(i)};stroke-width:1.5;opacity:0.55"
        shapes.append(f'<polyline points="{path}" style="{style}"/>')
        for x, y, mark, name in points:
            low, high = bottom - mark.low * _TALL, bottom - mark.high * _TALL
            shapes.append(
                f"<g>{_title(f'{one.name}, {name}: {mark.words}')}"
                f"{_stroke(x, low, x, high, _hue(i), 2)}{_shape(i, x, y)}</g>"
            )
    shapes.append(_text((left + right) / 2, bottom + 42, axes[0], "middle", FAINT))
    middle = (top + bottom) / 2
    turned = _text(0, 0, axes[1], "middle", FAINT)
    shapes.append(f'<g transform="translate(22 {middle:.1f}) rotate(-90)">{turned}</g>')
    return _svg(shapes, bottom + 54, f"{axes[1]} by {axes[0]}")


def stacks(name: str, parts: Sequence[str], bars: Sequence[Bar], axis: str) -> str:
    """Return bars divided into parts that differ by color and by hatching.

    Args:
        name: Of the figure: patterns of several in one page must differ.
        parts: Names of the parts.
        bars: From top to bottom.
        axis: What the length of a part is.
    """
    present = [k for k in range(len(parts)) if any(bar.parts[k] for bar in bars)]
    shapes = [f"<defs>{''.join(_pattern(name, k) for k in present)}</defs>"]
    entries = [(parts[k], _swatch(name, k)) for k in present]
    keys, top = _legend(entries)
    shapes += keys
    longest = max((len(bar.label) for bar in bars), default=0)
    left = min(270, max(_LABEL, round(_LETTER * longest) + 16))
    right = WIDTH - 92
    row = 30
    bottom = top + row * len(bars)
    most = max((sum(bar.parts) for bar in bars), default=0.0)
    limit = next(tick for tick in (0.05, 0.1, 0.25, 0.5, 1.0) if tick >= most - 1e-9)
    for i in range(6):
        x = left + (right - left) * i / 5
        shapes.append(_stroke(x, top, x, bottom, _LINE, 1))
        shapes.append(_text(x, bottom + 17, f"{20 * i * limit:g}", "middle", FAINT))
    for j, bar in enumerate(bars):
        y, x = top + j * row, float(left)
        shapes.append(_text(left - 10, y + row / 2, bar.label, "end"))
        for k in present:
            width = (right - left) * bar.parts[k] / limit
            if width > 0:
                words = f"{bar.label}: {parts[k]} {bar.parts[k]:.1%}"
                shapes.append(
                    f'<rect x="{x:.1f}" y="{y + 6:.1f}" width="{width:.1f}" '
                    f'height="{row - 12}" style="fill:url(#{name}-{k});stroke:{_PAPER};'
                    f'stroke-width:1">{_title(words)}</rect>'
                )
            x += width
        shapes.append(_text(right + 10, y + row / 2, bar.note, "start", FAINT))
    shapes.append(_text((left + right) / 2, bottom + 40, axis, "middle", FAINT))
    return _svg(shapes, bottom + 52, axis)


def _hue(number: int) -> str:
    return f"var(--hue-{number % len(_HUES)}, {_HUES[number % len(_HUES)]})"


def _entry(number: int, name: str) -> tuple[str, str]:
    return name, _shape(number, 7, 0)


def _legend(entries: Iterable[tuple[str, str]]) -> tuple[list[str], float]:
    """Return names beside their keys, in lines, and the height that they take."""
    shapes, x, y = [], 8.0, 12.0
    for name, key in entries:
        width = 26 + _LETTER * len(name) + 14
        if x + width > WIDTH and x > 8.0:
            x, y = 8.0, y + 20
        shapes.append(f'<g transform="translate({x:.1f} {y:.1f})">{key}</g>')
        shapes.append(_text(x + 22, y, name, "start"))
        x += width
    return shapes, y + 20


def _shape(number: int, x: float, y: float) -> str:
    """Return the mark of a series: filled, then hollow, then with thick edges."""
    r = 4.6
    wide, low = 1.5 * r, 0.6 * r
    points = {
        1: ((-r, -r), (r, -r), (r, r), (-r, r)),
        2: ((0, -1.25 * r), (1.2 * r, r), (-1.2 * r, r)),
        3: ((0, -1.35 * r), (1.35 * r, 0), (0, 1.35 * r), (-1.35 * r, 0)),
        4: ((0, 1.25 * r), (1.2 * r, -r), (-1.2 * r, -r)),
        5: ((-wide, -low), (wide, -low), (wide, low), (-wide, low)),
    }
    hue, kind = _hue(number), number % 6
    inside = _PAPER if number >= 6 else hue
    edge = 1.6 if number < 12 else 3.2
    style = f"fill:{inside};stroke:{hue};stroke-width:{edge}"
    if kind == 0:
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r}" style="{style}"/>'
    corners = " ".join(f"{x + dx:.1f},{y + dy:.1f}" for dx, dy in points[kind])
    return f'<polygon points="{corners}" style="{style}"/>'


def _dot_in_lane(number: int, mark: Mark, y: float, who: str) -> str:
    hue = _hue(number)
    low, high = _LABEL + mark.low * _PLOT, _LABEL + mark.high * _PLOT
    shapes = [_title(f"{who}: {mark.words}"), _stroke(low, y, high, y, hue, 2)]
    if mark.reference is not None:
        x = _LABEL + mark.reference * _PLOT
        shapes.append(_stroke(x, y - 6, x, y + 6, INK, 2))
    shapes.append(_shape(number, _LABEL + mark.value * _PLOT, y))
    return f"<g>{''.join(shapes)}</g>"


_HATCHES = (
    "",
    "M-1 7L7 -1M-1 1L1 -1M5 7L7 5",
    "M-1 -1L7 7M-1 5L1 7M5 -1L7 1",
    "M3 1.6V4.4M1.6 3H4.4",
    "M0 3H6",
    "M3 0V6",
    "M0 0L6 6M0 6L6 0",
    "M0 3H6M3 0V6",
    "M0 1H6M0 4H6",
    "M1 0V6M4 0V6",
)


def _pattern(name: str, number: int) -> str:
    hue, hatch = _hue(number), _HATCHES[number % len(_HATCHES)]
    style = f"stroke:{_PAPER};stroke-width:1.3;fill:none"
    return (
        f'<pattern id="{name}-{number}" width="6" height="6" '
        'patternUnits="userSpaceOnUse">'
        f'<rect width="6" height="6" style="fill:{hue}"/>'
        f'<path d="{hatch}" style="{style}"/></pattern>'
    )


def _swatch(name: str, number: int) -> str:
    style = f"fill:url(#{name}-{number})"
    return f'<rect x="0" y="-6" width="15" height="12" style="{style}"/>'


def _grid_x(tick: float, top: float, bottom: float) -> str:
    x = _LABEL + tick * _PLOT
    label = _text(x, bottom + 17, f"{100 * tick:.0f}", "middle", FAINT)
    return _stroke(x, top, x, bottom, _LINE, 1) + label


def _band(x: float, y: float, width: float, height: float) -> str:
    style = f"fill:{_LINE};opacity:0.28"
    return (
        f'<rect x="{x}" y="{y:.1f}" width="{width}" height="{height:.1f}" '
        f'style="{style}"/>'
    )


def _stroke(x1: float, y1: float, x2: float, y2: float, ink: str, width: float) -> str:
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
        f'style="stroke:{ink};stroke-width:{width:g}"/>'
    )


def _text(x: float, y: float, words: str, anchor: str, ink: str = INK) -> str:
    # Editors ignore `dominant-baseline`, but all of them shift by part of the size.
    style = f"fill:{ink};font:{_SIZE}px Helvetica,Arial,sans-serif"
    return (
        f'<text x="{x:.1f}" y="{y + 0.35 * _SIZE:.1f}" text-anchor="{anchor}" '
        f'style="{style}">{escape(words)}</text>'
    )


def _title(words: str) -> str:
    return f"<title>{escape(words)}</title>"


def _svg(shapes: Iterable[str], height: float, title: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" '
        f'height="{height:.0f}" viewBox="0 0 {WIDTH} {height:.0f}" role="img" '
        f'aria-label="{escape(title)}">{"".join(shapes)}</svg>'
    )
