"""Plots: what they show, and that they stand alone."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from lemma.evaluation.analysis.rates import Cell
from lemma.evaluation.analysis.result import Loss, Result
from lemma.evaluation.experiments.catalog import EXPERIMENTS
from lemma.evaluation.report.policy_results import PolicyResults
from lemma.viz.pages.report_figures import figures_of, write_figures
from lemma.viz.plots import (
    Bar,
    Curve,
    Mark,
    Series,
    curves,
    dots,
    lines,
    stacks,
    standalone,
)

SVG = "{http://www.w3.org/2000/svg}"
ABOUT = {"weights": {}, "split": "test", "language": "full"}


def cell(task: str, successes: int, distractors: int = 1) -> Cell:
    progress = (10 + successes) / 2
    counts = (distractors, 10, successes, successes)
    return Cell("high_level", task, "ur5+ur10", *counts, progress)


def entry(*successes: int, name: str = "et-cliport-single-step") -> PolicyResults:
    """Return an entry with a seed for each number of successes."""
    results = tuple(
        Result(
            ABOUT,
            "",
            "",
            (cell("pass", count), cell("stack", 10, 2)),
            (Loss("high_level", "pass", "wrong_robot", 10 - count),) * (count < 10),
        )
        for count in successes
    )
    return PolicyResults(EXPERIMENTS[name].title, results, EXPERIMENTS[name])


def words_of(svg: str) -> list[str]:
    return [one.text or "" for one in ElementTree.fromstring(svg).iter(f"{SVG}title")]


def shapes(svg: str) -> dict[str, ElementTree.Element]:
    """Return the shapes that say something, by what they say."""
    found = {}
    for group in ElementTree.fromstring(svg).iter(f"{SVG}g"):
        title = group.find(f"{SVG}title")
        if title is not None:
            found[title.text or ""] = group
    return found


def place_of(shape: ElementTree.Element) -> tuple[float, float]:
    """Return where the marker of a shape stands."""
    (use,) = shape.iter(f"{SVG}use")
    return float(use.attrib["x"]), float(use.attrib["y"])


def extent_of(shape: ElementTree.Element) -> tuple[float, float]:
    """Return where a line or bar begins and ends, from left to right."""
    path = next(shape.iter(f"{SVG}path"))
    xs = [float(x) for x in re.findall(r"[ML] ([\d.]+) [\d.]+", path.attrib["d"])]
    return min(xs), max(xs)


def tick(svg: str, words: str) -> float:
    """Return where a number of the horizontal axis stands."""
    texts = ElementTree.fromstring(svg).iter(f"{SVG}text")
    return next(float(text.attrib["x"]) for text in texts if text.text == words)


def test_a_mark_stands_where_its_value_is() -> None:
    one = Series("A", (Mark(0.0, 0.0, 0.1, "none"), Mark(1.0, 0.9, 1.0, "all"), None))
    svg = dots(["x", "y", "z"], [one], "success [%]")
    found = shapes(svg)
    assert list(found) == ["A, x: none", "A, y: all"]
    none, every = found.values()
    assert place_of(none)[0] == pytest.approx(tick(svg, "0"), abs=0.1)
    assert place_of(every)[0] == pytest.approx(tick(svg, "100"), abs=0.1)
    # Categories go down, whiskers from low to high.
    assert place_of(none)[1] < place_of(every)[1]
    tenth = (tick(svg, "100") - tick(svg, "0")) / 10
    left, right = extent_of(every)
    assert right - left == pytest.approx(tenth, abs=0.1)


def test_the_value_to_compare_with_is_drawn() -> None:
    mark = Mark(0.5, 0.4, 0.6, "half", 0.25)
    svg = dots(["x"], [Series("A", (mark,))], "success [%]")
    stroke = rf"M {(tick(svg, '0') + (tick(svg, '100') - tick(svg, '0')) / 4):.2f}"
    assert stroke in svg
    assert stroke not in dots(
        ["x"], [Series("A", (replace(mark, reference=None),))], "success [%]"
    )


def test_values_rise_upwards() -> None:
    one = Series("A", (Mark(0.2, 0.1, 0.3, "low"), Mark(0.8, 0.7, 0.9, "high")))
    svg = lines(["0", "1"], [one], ("distractors", "success [%]"))
    low, high = map(place_of, shapes(svg).values())
    assert high[1] < low[1]
    assert low[0] == pytest.approx(tick(svg, "0"), abs=0.1)


def test_points_of_curves_stand_at_their_numbers_and_share_looks_by_group() -> None:
    found = [
        Curve("A", "one", ((0.0, 50.0), (74.0, 60.0))),
        Curve("A", "two", ((0.0, 20.0), (74.0, 30.0))),
        Curve("B", "three", ((100.0, 50.0),)),
    ]
    svg = curves(found, ("share [%]", "score [%]"), (0.0, 100.0))
    places = {
        name: [
            (float(u.attrib["x"]), u.attrib["style"]) for u in shape.iter(f"{SVG}use")
        ]
        for name, shape in shapes(svg).items()
    }
    assert list(places) == ["one", "two", "three"]
    assert places["one"] == places["two"]
    begin, end = tick(svg, "0"), tick(svg, "100")
    assert [x for x, _ in places["one"]] == pytest.approx(
        [begin, begin + 0.74 * (end - begin)], abs=0.1
    )
    assert places["three"][0][0] == pytest.approx(end, abs=0.1)
    assert places["three"][0][1] != places["one"][0][1]


def test_series_differ_without_colors() -> None:
    series = [Series(f"P{i}", (Mark(0.5, 0.4, 0.6, "half"),)) for i in range(18)]
    svg = standalone(dots(["x"], series, "success [%]"))
    grey = re.sub(r"#(?!fffffe)[0-9a-f]{6}\b", "black", svg)
    root = ElementTree.fromstring(grey)
    drawn = {
        path.attrib["id"]: path.attrib["d"]
        for path in root.iter(f"{SVG}path")
        if "id" in path.attrib
    }
    looks = set()
    for shape in shapes(grey).values():
        (use,) = shape.iter(f"{SVG}use")
        name = use.attrib["{http://www.w3.org/1999/xlink}href"].removeprefix("#")
        looks.add((drawn[name], use.attrib["style"]))
    assert len(looks) == 18


def test_parts_differ_without_colors_and_fill_their_share() -> None:
    parts = ["a", "b", "never"]
    svg = stacks(parts, [Bar("P", "3 of 4", (0.25, 0.5, 0.0))], "share [%]")
    small, large = shapes(svg).values()
    assert words_of(svg) == ["P: a 25.0%", "P: b 50.0%"]
    (left, middle), (start, right) = extent_of(small), extent_of(large)
    assert start == pytest.approx(middle, abs=0.1)
    assert right - start == pytest.approx(2 * (middle - left), abs=0.2)
    assert left == pytest.approx(tick(svg, "0"), abs=0.1)
    # One is plain, the other hatched.
    hatched = [
        "url(#" in next(s.iter(f"{SVG}path")).attrib["style"] for s in (small, large)
    ]
    assert hatched == [False, True]
    assert "3 of 4" in svg
    assert "never" not in svg


def test_the_same_plot_has_the_same_bytes_and_shares_no_names() -> None:
    one = [Series("A", (Mark(0.5, 0.4, 0.6, "half"),))]
    svg = dots(["x"], one, "success [%]")
    assert svg == dots(["x"], one, "success [%]")
    for name in re.findall(r' id="([^"]+)"', svg):
        assert f"#{name}" in svg


def test_names_are_escaped() -> None:
    one = Series("<b>&", (Mark(0.5, 0.4, 0.6, '"half"'),))
    assert words_of(dots(["x"], [one], "a<b")) == ['<b>&, x: "half"']


def test_a_file_needs_nothing_else() -> None:
    for figure in figures_of([entry(5)]):
        alone = standalone(figure.svg)
        assert "var(" not in alone
        assert "http" not in alone.replace("http://www.w3.org/", "")
        ElementTree.fromstring(alone)


def test_figures_show_results_and_the_paper(tmp_path: Path) -> None:
    figures = {
        one.name: one for one in figures_of([entry(5), entry(10, name="reachnet")])
    }
    assert list(figures) == [
        "success-by-task-high-level",
        "success-by-distractors-high-level",
        "success-by-team-high-level",
        "causes-high-level",
        "progress-by-task-high-level",
    ]
    said = words_of(figures["success-by-task-high-level"].svg)
    title = "ET + CLIPort, single-step"
    assert f"{title}, pass: 50.0% (24%–76%), 5 of 10; the paper: 87.00 ± 0.67 %" in said
    # The paper's mean is over all eight.
    assert f"{title}, mean of 2: 75.0% (53%–89%), 15 of 20" in said
    assert "ReachNet, pass: 100.0% (72%–100%), 10 of 10" in said
    said = words_of(figures["success-by-distractors-high-level"].svg)
    assert f"{title}, 2: 100.0% (72%–100%), 10 of 10" in said
    assert words_of(figures["causes-high-level"].svg) == [f"{title}: wrong robot 25.0%"]
    said = words_of(figures["progress-by-task-high-level"].svg)
    assert f"{title}, pass: progress 75.0%, success 50.0%" in said
    write_figures(tmp_path, figures.values())
    assert {path.stem for path in tmp_path.glob("*.svg")} == set(figures)


def test_several_seeds_have_a_spread() -> None:
    figure = figures_of([entry(4, 6, 8)])[0]
    said = words_of(figure.svg)[0]
    assert "60.0% ± 20.0% over 3 seeds" in said


def test_nothing_is_plotted_of_what_was_not_run() -> None:
    assert figures_of([entry(), entry(5, name="no-palette")]) == []


def test_controls_are_plotted_where_nothing_else_is() -> None:
    expert, policy = entry(10, name="oracle"), entry(5)
    assert "the expert" in figures_of([expert])[0].svg
    assert "the expert" not in figures_of([expert, policy])[0].svg
