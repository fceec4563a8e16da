"""Plots: what they show, and that they stand alone."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from lemma.evaluation.analysis.result import Cell, Loss, Result
from lemma.evaluation.experiments.catalog import EXPERIMENTS
from lemma.evaluation.report.policy_results import PolicyResults
from lemma.viz.figures import Bar, Mark, Series, dots, lines, stacks, standalone
from lemma.viz.pages.report_figures import figures_of, write_figures

SVG = "{http://www.w3.org/2000/svg}"
ABOUT = {"weights": {}, "split": "test", "language": "full"}


def cell(task: str, successes: int, distractors: int = 1) -> Cell:
    progress = (10 + successes) / 2
    return Cell("high_level", task, "ur5+ur10", distractors, 10, successes, progress)


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


def shapes(svg: str, tag: str) -> list[ElementTree.Element]:
    return list(ElementTree.fromstring(svg).iter(f"{SVG}{tag}"))


def test_a_mark_stands_where_its_value_is() -> None:
    one = Series("A", (Mark(0.0, 0.0, 0.1, "none"), Mark(1.0, 0.9, 1.0, "all"), None))
    svg = dots(["x", "y", "z"], [one], "success [%]")
    ticks = {
        text.text: float(text.attrib["x"]) for text in shapes(svg, "text") if text.text
    }
    # The first circle is the legend's.
    places = [float(mark.attrib["cx"]) for mark in shapes(svg, "circle")[1:]]
    assert places == [ticks["0"], ticks["100"]]
    assert words_of(svg) == ["A, x: none", "A, y: all"]


def test_values_rise_upwards() -> None:
    one = Series("A", (Mark(0.2, 0.1, 0.3, "low"), Mark(0.8, 0.7, 0.9, "high")))
    svg = lines(["0", "1"], [one], ("distractors", "success [%]"))
    low, high = (float(mark.attrib["cy"]) for mark in shapes(svg, "circle")[1:])
    assert high < low


def test_series_differ_without_colors() -> None:
    series = [Series(f"P{i}", (Mark(0.5, 0.4, 0.6, "half"),)) for i in range(18)]
    svg = standalone(dots(["x"], series, "success [%]"))
    grey = re.sub(r"#(?!ffffff)[0-9a-f]{6}", "#000000", svg)
    keys = re.findall(r'<g transform="translate[^>]*>(<[^>]*>)', grey)
    assert len(keys) == len(set(keys)) == 18


def test_parts_differ_without_colors_and_fill_their_share() -> None:
    parts = ["a", "b", "never"]
    svg = stacks("it", parts, [Bar("P", "3 of 4", (0.25, 0.5, 0.0))], "share")
    hatches = [one.attrib["d"] for one in shapes(svg, "path")]
    assert len(hatches) == len(set(hatches)) == 2
    bars = [one for one in shapes(svg, "rect") if one.find(f"{SVG}title") is not None]
    small, large = (float(bar.attrib["width"]) for bar in bars)
    assert large == pytest.approx(2 * small, rel=0.01)
    assert words_of(svg) == ["P: a 25.0%", "P: b 50.0%"]


def test_names_are_escaped() -> None:
    one = Series("<b>&", (Mark(0.5, 0.4, 0.6, '"half"'),))
    assert words_of(dots(["x"], [one], "a<b")) == ['<b>&, x: "half"']


def test_a_file_needs_nothing_else() -> None:
    for figure in figures_of([entry(5)]):
        alone = standalone(figure.svg)
        assert "var(" not in alone
        assert "http" not in alone.replace("http://www.w3.org/2000/svg", "")
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
    assert f"{title}, pass: 50.0% (24%–76%), 5 of 10; the paper: 87 %" in said
    assert f"{title}, mean: 75.0% (53%–89%), 15 of 20; the paper: 43.2 %" in said
    assert "ReachNet (ours), pass: 100.0% (72%–100%), 10 of 10" in said
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
