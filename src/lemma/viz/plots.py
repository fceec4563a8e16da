"""Plots for pages and papers: SVG from matplotlib, with selectable text.

Series differ by color and marker, parts of bars by color and hatching, so plots are
legible without color. The colors are those of Okabe and Ito. Each is written as
``var(--name, #color)``: a page may set others for a dark background, and
:func:`standalone` leaves the plain color. A mark shows its numbers as a tooltip.
"""

import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

WIDTH = 720
_SIZE = 13
_LANE = 13
_TALL = 280
_ROW = 30
INK, FAINT, LINE, PAPER = "#181c22", "#5d6672", "#d5d8dc", "#fffffe"
_HUES = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"),
    *("#5d6673", "#8c510a", "#762a83", "#35978f", "#bf812d", "#9970ab"),
)
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "p", "<", "*", ">", "h")
_HATCHES = ("", "////", "\\\\\\\\", "++", "----", "||||", "xxxx", "//", "--", "||")
_NAMES = {
    **{INK: "ink", FAINT: "faint", LINE: "line", PAPER: "card"},
    **{hue: f"hue-{number}" for number, hue in enumerate(_HUES)},
}
_COLOR = re.compile("|".join(_NAMES))
_VARIABLE = re.compile(r"var\(--[\w-]+, ([^)]+)\)")
_SVG = "http://www.w3.org/2000/svg"
_STYLE = Path(__file__).with_suffix(".mplstyle")

_BESIDE: dict[str, Any] = {
    "xycoords": ("axes fraction", "data"),
    "xytext": (10, 0),
    "textcoords": "offset points",
    "va": "center",
    "color": FAINT,
}
"""Position of a note: right of the axes."""


@dataclass(frozen=True, slots=True)
class Mark:
    """One value of a series, from 0 to 1."""

    value: float
    low: float
    """Lower end of its whisker."""
    high: float
    """Upper end of its whisker."""
    words: str
    """Its tooltip."""
    reference: float | None = None
    """Another value to compare it with; None without one."""


@dataclass(frozen=True, slots=True)
class Series:
    """Values of one policy, one per category; None for a missing value."""

    name: str
    marks: tuple[Mark | None, ...]


@dataclass(frozen=True, slots=True)
class Curve:
    """Points that a line joins."""

    group: str
    """Its name in the legend; curves of the same name look alike."""
    words: str
    """Its tooltip."""
    points: tuple[tuple[float, float], ...]
    """Both coordinates of each point, as on the axes."""


@dataclass(frozen=True, slots=True)
class Bar:
    """A bar that is divided into parts."""

    label: str
    note: str
    """Text at its end."""
    parts: tuple[float, ...]
    """Lengths of the parts, as shares of 1."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot for a page or a file."""

    name: str
    """Name of its file, without ending."""
    title: str
    caption: str
    svg: str


def standalone(svg: str) -> str:
    """Return a plot as the content of a file, with plain colors and no style sheet."""
    return _VARIABLE.sub(r"\1", svg) + "\n"


def dots(categories: Sequence[str], series: Sequence[Series], axis: str) -> str:
    """Return a dot plot with whiskers: categories are rows with a lane per series.

    A thin line across a lane shows :attr:`Mark.reference`.

    Args:
        categories: Names of the rows.
        series: At least one.
        axis: Label of the axis of values.
    """
    row = _LANE * max(len(series), 2) + 10

    def draw(axes: Axes, tips: list[str]) -> None:
        for j in range(1, len(categories), 2):
            axes.axhspan(j - 0.5, j + 0.5, color=LINE, alpha=0.28, linewidth=0)
        for i, one in enumerate(series):
            shift = (i - (len(series) - 1) / 2) * _LANE / row
            for j, mark in enumerate(one.marks):
                if mark is not None and mark.reference is not None:
                    ends = j + shift - 6 / row, j + shift + 6 / row
                    axes.plot([100 * mark.reference] * 2, ends, color=INK, lw=2)
            _draw_marks(axes, tips, i, one, categories, shift)
        axes.set(xlim=(-1.5, 101.5), xlabel=axis)
        axes.set(yticks=range(len(categories)), yticklabels=categories)
        axes.set_ylim(len(categories) - 0.5, -0.5)
        axes.grid(axis="x")

    return _plot(draw, row * len(categories) + 48, axis, [one.name for one in series])


def lines(
    categories: Sequence[str], series: Sequence[Series], axes_words: tuple[str, str]
) -> str:
    """Return a line plot with whiskers: categories from left to right.

    Args:
        categories: Names along the horizontal axis.
        series: At least one.
        axes_words: Labels of the axes of categories and of values.
    """
    apart = min(0.02, 0.7 / len(series) / max(len(categories), 1))

    def draw(axes: Axes, tips: list[str]) -> None:
        for i, one in enumerate(series):
            shift = (i - (len(series) - 1) / 2) * apart * len(categories)
            found = [(j + shift, mark) for j, mark in enumerate(one.marks) if mark]
            xs, ys = [x for x, _ in found], [100 * mark.value for _, mark in found]
            axes.plot(xs, ys, color=_hue(i), lw=1.5, alpha=0.55)
            _draw_marks(axes, tips, i, one, categories, shift, upright=True)
        axes.set(xlabel=axes_words[0], ylabel=axes_words[1], ylim=(-2, 102))
        axes.set(xticks=range(len(categories)), xticklabels=categories)
        axes.set_xlim(-0.5, len(categories) - 0.5)
        axes.grid(axis="y")

    title = f"{axes_words[1]} by {axes_words[0]}"
    return _plot(draw, _TALL + 60, title, [one.name for one in series])


def curves(
    found: Sequence[Curve], axes_words: tuple[str, str], limits: tuple[float, float]
) -> str:
    """Return thin lines with a small marker at each point, where its numbers are.

    Args:
        found: At least one.
        axes_words: Labels of the horizontal and of the vertical axis.
        limits: Smallest and largest value on both axes.
    """
    groups = list(dict.fromkeys(one.group for one in found))
    margin = 0.02 * (limits[1] - limits[0])
    ends = limits[0] - margin, limits[1] + margin

    def draw(axes: Axes, tips: list[str]) -> None:
        for one in found:
            xs, ys = zip(*one.points, strict=True)
            looks = _marker(groups.index(one.group)) | _SMALL
            axes.plot(xs, ys, **looks, gid=_tip(tips, one.words))
        axes.set(xlabel=axes_words[0], ylabel=axes_words[1], xlim=ends, ylim=ends)
        axes.grid(axis="y")

    title = f"{axes_words[1]} by {axes_words[0]}"
    return _plot(draw, _TALL + 60, title, groups)


def stacks(parts: Sequence[str], bars: Sequence[Bar], axis: str) -> str:
    """Return stacked bars; parts differ by color and hatching.

    Args:
        parts: Names of the parts.
        bars: Bars from top to bottom.
        axis: Label of the axis of lengths.
    """
    used = [k for k in range(len(parts)) if any(bar.parts[k] for bar in bars)]
    most = max((sum(bar.parts) for bar in bars), default=0.0)
    limit = next(tick for tick in (0.05, 0.1, 0.25, 0.5, 1.0) if tick >= most - 1e-9)

    def draw(axes: Axes, tips: list[str]) -> None:
        for j, bar in enumerate(bars):
            left = 0.0
            for k in used:
                width = 100 * bar.parts[k]
                if width > 0:
                    tip = _tip(tips, f"{bar.label}: {parts[k]} {bar.parts[k]:.1%}")
                    axes.barh(j, width, 0.6, left, **_filling(k), gid=tip)
                left += width
            axes.annotate(bar.note, (1.0, j), **_BESIDE)
        axes.set(xlim=(0, 100 * limit), xlabel=axis)
        axes.set(yticks=range(len(bars)), yticklabels=[bar.label for bar in bars])
        axes.set_ylim(max(len(bars), 1) - 0.5, -0.5)
        axes.grid(axis="x")
        for k in used:
            axes.barh(0, 0, **_filling(k), label=parts[k])

    return _plot(draw, _ROW * len(bars) + 48, axis, [parts[k] for k in used])


def _hue(number: int) -> str:
    return _HUES[number % len(_HUES)]


def _filling(number: int) -> dict[str, Any]:
    """Return the color and hatching of a part."""
    hatch = _HATCHES[number % len(_HATCHES)]
    return {"facecolor": _hue(number), "edgecolor": PAPER, "hatch": hatch}


def _marker(number: int) -> dict[str, Any]:
    """Return the marker of a series: first filled ones, then hollow ones."""
    hollow = number // len(_MARKERS) % 2 == 1
    return {
        "marker": _MARKERS[number % len(_MARKERS)],
        "markersize": 9,
        "markerfacecolor": PAPER if hollow else _hue(number),
        "markeredgecolor": _hue(number),
        "markeredgewidth": 1.6,
        "color": _hue(number),
    }


_SMALL = {"markersize": 5, "markeredgewidth": 0.8, "lw": 1.0, "alpha": 0.75}
"""Changes to a marker, and its line, where there are many."""


def _draw_marks(
    axes: Axes,
    tips: list[str],
    number: int,
    series: Series,
    categories: Sequence[str],
    shift: float,
    *,
    upright: bool = False,
) -> None:
    """Draw the marks of a series, each on a line from its lower to its upper end.

    Args:
        axes: Axes to draw into.
        tips: List of tooltips; those of the marks are appended.
        number: Index of the series, which selects color and marker.
        series: The values.
        categories: Names of the categories.
        shift: Offset of the marks from the middle of each category.
        upright: Whether the axis of values is vertical.
    """
    for j, mark in enumerate(series.marks):
        if mark is None:
            continue
        values = [100 * mark.low, 100 * mark.value, 100 * mark.high]
        xs, ys = ([j + shift] * 3, values) if upright else (values, [j + shift] * 3)
        looks = {**_marker(number), "lw": 2, "clip_on": False, "zorder": 3}
        tip = _tip(tips, f"{series.name}, {categories[j]}: {mark.words}")
        axes.plot(xs, ys, **looks, markevery=[1], gid=tip)


def _tip(tips: list[str], words: str) -> str:
    """Append the tooltip of a shape, and return the name of the shape."""
    tips.append(words)
    return f"tip-{len(tips) - 1}"


def _plot(
    draw: Callable[[Axes, list[str]], None],
    height: float,
    title: str,
    series: Sequence[str] = (),
) -> str:
    """Return a plot as SVG.

    Args:
        draw: Function that draws into axes and appends tooltips.
        height: Height without the legend [px].
        title: Title for screen readers.
        series: Names in the legend; of the labelled shapes or of markers.
    """
    tips: list[str] = []
    widths = [0.58 * _SIZE * len(name) + 40 for name in series]
    columns = math.floor(WIDTH / max(widths, default=WIDTH)) or 1
    columns = max(len(series), 1) if sum(widths) < WIDTH else columns
    height += 22 * math.ceil(len(series) / columns)
    with rc_context(fname=_STYLE):
        # At 72 per inch, one point of the figure is one pixel of its SVG.
        drawing = Drawing(figsize=(WIDTH / 72, height / 72), layout="constrained")
        drawing.patch.set_visible(False)
        axes = drawing.add_subplot()
        axes.patch.set_visible(False)
        draw(axes, tips)
        if series:
            handles = axes.get_legend_handles_labels()[0] or [
                axes.plot([], [], **_marker(i), ls="")[0] for i in range(len(series))
            ]
            drawing.legend(*(handles, series), loc="outside upper left", ncols=columns)
        buffer = io.StringIO()
        drawing.savefig(buffer, format="svg", metadata={"Date": None})
    return _finished(buffer.getvalue(), title, tips)


def _finished(text: str, title: str, tips: Sequence[str]) -> str:
    """Return SVG for a page: tooltips instead of names, and variables for colors."""
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ElementTree.fromstring(text)
    for metadata in root.findall(f"{{{_SVG}}}metadata"):
        root.remove(metadata)
    for shape in list(root.iter()):
        shape.text = (shape.text or "").strip()
        shape.tail = ""
        name = shape.get("id", "")
        if name.startswith("tip-"):
            words = ElementTree.Element(f"{{{_SVG}}}title")
            words.text = tips[int(name.removeprefix("tip-"))]
            shape.insert(0, words)
        # Several plots in one page must not share names.
        if name and f"#{name}" not in text:
            del shape.attrib["id"]
    root.set("width", f"{WIDTH}")
    root.set("height", root.get("height", "").removesuffix("pt"))
    root.set("role", "img")
    root.set("aria-label", title)
    svg = ElementTree.tostring(root, encoding="unicode")
    return _COLOR.sub(lambda found: f"var(--{_NAMES[found[0]]}, {found[0]})", svg)
