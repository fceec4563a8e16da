"""Tables: what was counted, with intervals, beside what the paper says."""

from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
from made_up import ABOUT, result, row, step

import results
from lemma.cli.report import report as verb
from lemma.core.errors import DatasetError
from lemma.core.tables import Table
from lemma.evaluation.analysis.result import Asked, Result, summarise
from lemma.evaluation.report import measures, tables
from lemma.evaluation.report.below_paper import below_paper
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    NOTHING,
    PolicyResults,
    entries_of,
    read_results,
)
from lemma.evaluation.report.sections import page, sections
from lemma.policies.spec import PolicySpec
from lemma.tasks.suite import SUITE


def entry_of(*results: Result) -> PolicyResults:
    (entry,) = entries_of(results)
    return entry


def anybody(policy: str) -> Result:
    """Return the result of a policy that is no experiment by its name."""
    made = result(2)
    about = {**made.about, "policy": PolicySpec(policy).about()}
    return replace(made, experiment="", about=about)


def cells(table: Table, title: str) -> dict[str, str]:
    (found,) = [line for line in table.rows if line[0] == title]
    return dict(zip(table.header, found, strict=True))


def test_one_seed_has_wilson_intervals() -> None:
    entry = entry_of(result(5))
    found = cells(tables.by_task([entry], "high_level"), "ReachNet")
    assert found["pass"] == "50.0 (24–76)"
    assert found["mean"] == "50.0 (30–70) †"
    # Nobody played the other tasks.
    assert list(found) == ["success [%]", "pass", "stack", "mean"]


def test_several_seeds_have_a_spread() -> None:
    entry = entry_of(result(6, seed=1), result(4, seed=0), result(8, seed=2))
    found = cells(tables.by_task([entry], "high_level"), "ReachNet")
    assert (found["pass"], found["mean"]) == ("60.0 ± 20.0", "60.0 ± 20.0 †")
    assert [one.seed for one in entry.results] == [0, 1, 2]


def test_the_paper_stands_below_the_same_row() -> None:
    table = tables.by_task(entries_of([], complete=True), "high_level")
    assert table.header == ("success [%]", *SUITE, "mean")
    lines = [line[0] for line in table.rows]
    assert lines[:2] == ["ET + CLIPort, single-step", "*paper*"]
    assert table.rows[1][-1] == "43.21 ± 0.45"
    assert table.rows[1][1] == "87.00 ± 0.67"
    assert table.rows[0][-1] == NOT_RUN


def test_breakdowns_pool_all_tasks() -> None:
    entry = entry_of(result(5))
    distractors = cells(
        tables.breakdown([entry], "high_level", "distractors"), entry.title
    )
    assert distractors["1"] == distractors["all"] == "50.0 (30–70)"
    assert list(distractors) == ["success [%]", "1", "all"]
    team = cells(tables.breakdown([entry], "high_level", "team"), entry.title)
    assert team["ur5+ur10"] == "50.0 (30–70)"
    assert list(team) == ["success [%]", "ur5+ur10", "all"]


def test_losses_are_summed_over_seeds() -> None:
    entry = entry_of(result(6, seed=0), result(7, seed=1))
    found = cells(tables.losses([entry]), entry.title)
    assert (found["failed"], found["of"], found["wrong robot"]) == ("14", "40", "14")
    by_task = tables.losses_by_task(entry)
    assert [line[1] for line in by_task.rows] == ["pass", "stack"]


def mistaken(**departed: int) -> PolicyResults:
    """Return a policy with sub-tasks by departure, which name objects or do not."""
    named = "robot" in departed
    rows = [
        row("stack", number, steps=[step(2, departure, able=named or None)], left=2)
        for departure, count in departed.items()
        for number in range(count)
    ]
    return entry_of(summarise(rows, {**ABOUT, "policy": PolicySpec("mine:A").about()}))


def test_causes_that_cannot_be_told_without_names_are_not_called_zero() -> None:
    named, nameless = mistaken(object=2, robot=1), mistaken(object=2, primitive=1)
    for entry, robots, orders in (
        (named, "1", "0"),
        (nameless, NOTHING, NOTHING),
    ):
        found = cells(tables.losses([entry]), entry.title)
        assert (found["wrong robot"], found["wrong order"]) == (robots, orders)
        assert found["missed place"] == orders
        assert found["wrong object"] == "2"
        assert found["stopped early"] == "0"
        # Contacts tell the causes at control level alone.
        assert found["untouched"] == NOTHING
        together = measures.coordination([entry], "high_level").rows[0]
        assert (NOTHING in together[4:7]) == (entry is nameless)
    # A policy that gives no motor commands is known as such without any mistake, too.
    for failure in ("thrown", "policy_error"):
        steps = [step(2, able=None)]
        thrown = summarise(
            [row(steps=steps, failure=failure)],
            {**ABOUT, "policy": PolicySpec("mine:A").about()},
        )
        found = cells(tables.losses([entry_of(thrown)]), "mine:A")
        assert (found["wrong object"], found["untouched"]) == ("0", NOTHING)
    (shares,) = tables.cause_shares([nameless]).rows
    assert shares == (nameless.title, "100.0", "33.3", "66.7")
    both = tables.cause_shares([named, nameless])
    assert both.header[2:] == ("wrong robot", "wrong primitive", "wrong object")
    assert both.rows[1][2] == NOTHING


def test_ablations_have_a_table_of_their_own() -> None:
    entries = entries_of(
        [
            result(9),
            result(3, experiment="no-palette"),
            result(8, experiment="complete"),
        ]
    )
    assert [(*line[:2], line[-1]) for line in tables.ablations(entries).rows] == [
        ("nothing left out", "80.0 (58–92) †", "20"),
        ("no palette swap", "30.0 (15–52) †", "20"),
    ]
    titles = [line[0] for line in tables.by_task(entries, "high_level").rows]
    assert titles == ["ReachNet", "*lenient*"]


def test_results_are_found_in_folders(tmp_path: Path) -> None:
    result(5).write(tmp_path / "reachnet" / "seed-0.json")
    result(6, seed=1).write(tmp_path / "reachnet" / "seed-1.json")
    result(3, experiment="no-turn").write(tmp_path / "ablations" / "no-turn.json")
    mine = anybody("mypackage.mymodule:MyPolicy")
    mine.write(tmp_path / "mine" / "summary.json")
    (tmp_path / "mine" / "about.json").write_text("{}")
    whole = entries_of(read_results([tmp_path]))
    assert [len(entry.results) for entry in whole] == [2, 1, 1]
    assert whole[-1].title == "mypackage.mymodule:MyPolicy"
    assert entries_of(read_results(sorted(tmp_path.iterdir()))) == whole


def test_an_evaluated_policy_of_the_registry_is_its_row() -> None:
    assert entry_of(anybody("episodic-transformer+oracle")).experiment is not None
    assert entry_of(anybody("episodic-transformer+mine")).experiment is None


def test_seeds_count_once() -> None:
    with pytest.raises(DatasetError, match="seed 0"):
        entries_of([result(6), result(4)])


@pytest.mark.parametrize(
    ("changed", "words"),
    [({"split": "val"}, "split"), ({"protocol": "6" * 64}, r"666.*555")],
)
def test_protocols_are_not_mixed(
    tmp_path: Path, changed: dict[str, str], words: str
) -> None:
    result(5).write(tmp_path / "seed-0.json")
    other = result(5, seed=1)
    replace(other, about=other.about | changed).write(tmp_path / "seed-1.json")
    with pytest.raises(DatasetError, match=words):
        read_results([tmp_path])


def control(language: str, successes: int, **about: object) -> Result:
    """Return ReachNet under a control of language, or from perturbed starts."""
    made = result(successes, experiment="")
    policy = PolicySpec("reachnet").about()
    told = {**made.about, "policy": policy, "language": language, **about}
    return replace(made, about=told)


def test_controls_of_language_stand_in_one_row() -> None:
    swapped = replace(
        control("swapped", 1),
        asked=(Asked("high_level", "pass", 8, 6), Asked("high_level", "stack", 10, 9)),
    )
    few, fewer = control("none", 3), control("none", 1)
    bare = [replace(c, distractors=0) for c in few.cells if c.task == "pass"]
    full = [replace(c, distractors=2) for c in fewer.cells if c.task == "stack"]
    none = replace(few, cells=(*bare, *full))
    entries = entries_of([control("full", 9), none, swapped])
    assert len(entries) == 3
    (line,) = tables.language(entries).rows
    assert line[:3] == ("ReachNet", "high-level", "90.0 (70–97) †")
    assert [cell.split(" ")[0] for cell in line[3:6]] == ["20.0", "–", "10.0"]
    assert [cell.split(" ")[0] for cell in line[6:8]] == ["30.0", "10.0"]
    assert line[8] == "83.3 of 18"
    assert tables.language(entries_of([control("full", 9)])).rows == ()


def test_perturbed_starts_stand_beside_the_others() -> None:
    entries = entries_of([control("full", 9), control("full", 7, perturb_start=True)])
    assert [entry.title for entry in entries] == [
        "ReachNet",
        "ReachNet, perturbed starts",
    ]
    (line,) = tables.starts(entries).rows
    assert line == ("ReachNet", "high-level", "90.0 (70–97) †", "70.0 (48–85) †")
    # Controls of language have a table of their own.
    assert tables.language(entries).rows == ()


def test_controls_do_not_crowd_the_tables_of_success() -> None:
    alone = [control("none", 3), control("full", 7, perturb_start=True)]
    beside = entries_of([control("full", 9), *alone])
    for table in (
        tables.by_task,
        partial(tables.breakdown, by="team"),
        partial(tables.breakdown, by="distractors"),
    ):
        (row,) = [r for r in table(beside, "high_level").rows if "ReachNet" in r[0]]
        assert row[-1].startswith("90.0")
        # Each with its lenient verdicts below it.
        assert len(table(entries_of(alone), "high_level").rows) == 4


def test_coordination_is_of_sums_over_all_tasks() -> None:
    entry = entry_of(result(5))
    found = cells(measures.coordination([entry], "high_level"), entry.title)
    assert found["time / expert's"] == "1.50"
    assert (found["idle, left [%]"], found["idle, right [%]"]) == ("16.7", "83.3")
    assert (found["first-try allocation [%]"], found["expert's robot [%]"]) == (
        "100.0",
        "0.0",
    )
    assert (found["nearest arms [mm]"], found["touching"]) == ("80", "0")
    several = entry_of(result(5), result(6, seed=1))
    spread = cells(measures.coordination([several], "high_level"), entry.title)
    assert spread["time / expert's"] == "1.50 ± 0.00"


@pytest.mark.slow
def test_the_verb_passes_over_tables_and_refuses_nothing(tmp_path: Path) -> None:
    kept = tmp_path / "results"
    result(5).write(kept / "reachnet" / "seed-0.json")
    (kept / "results.md").write_text("# Results\n")
    (kept / "begun").mkdir()
    assert verb(tuple(sorted(kept.iterdir())), tmp_path / "report") == 0
    with pytest.raises(DatasetError, match=r"no results in .*begun"):
        verb((kept / "begun",), tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
def test_the_committed_page_is_made_from_the_committed_results() -> None:
    for path, text in results.pages().items():
        # Fonts of a figure differ by machine.
        if path in results.FIGURES:
            assert path.is_file()
        else:
            assert text == path.read_text(encoding="utf-8"), (
                f"{path} is not what the results give: python scripts/results.py"
            )


def test_every_caption_of_a_sample_says_so() -> None:
    said = "**A sample:** 10 of 60 episodes of each of 2 of the eight tasks (pass, "
    said += "stack)."
    tables_of_rates = sections(entries_of([result(5)]))[:-1]
    assert all(one.caption.endswith(said) for one in tables_of_rates if one.table.rows)
    whole = result(5, episodes=60, tasks=SUITE)
    assert not any("ample:**" in one.caption for one in sections(entries_of([whole])))
    both = sections(entries_of([whole, result(5, seed=1, tasks=SUITE)]))
    assert "**Some rows are of a sample:** 10 of 60 episodes" in both[0].caption


def test_lenient_verdicts_stand_below_the_strict() -> None:
    made = result(5)
    cells_of_both = tuple(
        replace(cell, lenient_successes=cell.successes + 2) for cell in made.cells
    )
    entry = entry_of(replace(made, cells=cells_of_both))
    strict, lenient = tables.by_task([entry], "high_level").rows
    assert strict[1:] == ("50.0 (24–76)", "50.0 (24–76)", "50.0 (30–70) †")
    assert [cell.split(" ")[0] for cell in lenient] == ["*lenient*", *["70.0"] * 3]
    # A result that was played strictly alone has no such row.
    alone = tuple(replace(cell, lenient_successes=None) for cell in made.cells)
    table = tables.by_task([entry_of(replace(made, cells=alone))], "high_level")
    assert len(table.rows) == 1


def test_all_tables_of_the_paper_stand_below_ours() -> None:
    nobody = entries_of([], complete=True)
    teams = tables.breakdown(nobody, "human", "team")
    assert teams.header[1:4] == ("ur5+ur5", "ur5+ur10", "ur10+ur10")
    below = {above[0]: row for above, row in pairwise(teams.rows)}
    assert below["M-CLIPort"][1:4] == ("6.62 ± 0.93", "8.52 ± 1.25", "4.48 ± 1.06")
    numbers = tables.distractors_by_task(nobody)
    assert numbers.header[3:] == ("0", "1", "2")
    hook = ("26.09 ± 2.51", "32.46 ± 3.62", "17.59 ± 2.07")
    assert ("*paper*", "hook", "human", *hook) in numbers.rows
    assert len(numbers.rows) == 2 * 8


def test_all_that_is_below_the_paper_is_listed_with_its_failures() -> None:
    entries = results.entries()
    found = {row[:3]: row[3:] for row in below_paper(entries).rows}
    lower = {}
    for kind in ("high_level", "human"):
        for line in tables.by_task(entries, kind).rows:
            if line[0] not in (tables.LENIENT, tables.PAPER):
                strict = line
            if line[0] == tables.PAPER:
                for task, own, paper in zip(SUITE, strict[1:], line[1:], strict=False):
                    if float(own.split()[0]) < float(paper.split()[0]):
                        lower[strict[0], kind.replace("_", "-"), task] = own, paper
    assert lower
    assert {key: row[:2] for key, row in found.items()} == lower
    for *_, failed, causes in found.values():
        assert int(failed) == sum(int(each.split()[-1]) for each in causes.split(", "))


def test_the_readme_has_the_table_of_the_results(tmp_path: Path) -> None:
    assert results.readme() == results.README.read_text(encoding="utf-8"), (
        "README.md is not what the results give: python scripts/results.py"
    )
    assert "no results of this version yet" in results.headline(tmp_path)
    result(5).write(tmp_path / "reachnet" / "seed-0.json")
    told = results.headline(tmp_path)
    assert "| ReachNet | 50.0 (30–70) † |" in told
    assert "| *lenient* | 50.0 (30–70) † |" in told
    written = results.pages(tmp_path)
    assert "50.0 (24–76)" in written[results.PAGE]
    named = written[results.FOLDER / "rows.md"].partition("yet: ")[2]
    assert "`oracle`" in named
    assert "`reachnet`" not in named


def test_a_part_is_called_a_part() -> None:
    text = page(entries_of([result(5)]))
    assert (
        "**in part**, 10 of 60 episodes of each of 2 of the eight tasks (pass, stack), "
        "with high-level instructions"
    ) in text
    assert "† marks a mean over other tasks" in text
    assert "each of the eight tasks" not in text
    assert "hook" not in text
    assert "There are no results" not in text
    whole = result(5, episodes=60, tasks=SUITE)
    text = page(entries_of([whole]))
    assert "60 episodes of each of the eight tasks, with high-level instr" in text
    assert "†" not in text
    for tasks, words in (
        (SUITE, "10 of 60 episodes of each of the eight tasks, with"),
        (("hook",), "10 of 60 episodes of hook, with"),
        (("hook", "tower"), "10 of 60 episodes of each of 2 tasks (hook, tower), with"),
    ):
        assert f"**in part**, {words}" in page(entries_of([result(5, tasks=tasks)]))
    both = page(entries_of([whole, result(5, seed=1, tasks=SUITE)]))
    assert (
        "Some rows, or some of their seeds, are of fewer: the table *How each" in both
    )


def test_a_policy_that_does_nothing_has_a_dash_for_shares_of_its_time() -> None:
    rows = [
        {**row("pass", number), "elapsed_s": 0.0, "idle_s": {"robot_0": 0.0}}
        for number in range(3)
    ]
    made = summarise(rows, {**ABOUT, "policy": PolicySpec("mine:Idle").about()})
    table = measures.coordination([entry_of(made)], "high_level")
    found = dict(zip(table.header, table.rows[0], strict=True))
    assert found["idle, left [%]"] == found["time / expert's"] == NOTHING
    assert "mine:Idle" in page([entry_of(made)])
