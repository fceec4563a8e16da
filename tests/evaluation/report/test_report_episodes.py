"""Episodes behind a report: found, put into words, and done again."""

import json
from pathlib import Path

import pytest
from clumsy import EPISODES, KINDS, played_clumsily
from made_up import ABOUT, row, step

from lemma.env.episode import Episode
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.records import EPISODES as LINES
from lemma.evaluation.records import Row
from lemma.evaluation.report.episodes import Case, cases_of, explanation, spread
from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.evaluation.run.replay import Watcher, differences, play_again


@pytest.fixture(scope="module")
def folder() -> Path:
    return played_clumsily()


@pytest.fixture(scope="module")
def cases(folder: Path) -> list[Case]:
    found, uncounted = cases_of(entries_of(read_results([folder])), [folder])
    assert uncounted == []
    return found


def made_up(**more: object) -> Case:
    return Case("somebody", row(**more), ABOUT, Path("out"))  # type: ignore[arg-type]


def test_every_episode_is_found_with_its_cause(cases: list[Case]) -> None:
    assert len(cases) == EPISODES * len(KINDS)
    assert [case.cause for case in cases[:EPISODES]] == [
        None,
        Cause.STOPPED_EARLY,
        Cause.MISSED_PICK,
        Cause.WRONG_ROBOT,
    ]
    assert [case.mistake for case in cases[:EPISODES]] == [None, None, 0, 0]
    assert cases[EPISODES].name == "unseen/stack/0"


def test_causes_are_explained(cases: list[Case]) -> None:
    none, early, missed, robot = map(explanation, cases[:EPISODES])
    assert none == ""
    assert early.endswith("the policy stopped with work left.")
    assert missed.startswith("Sub-task 1 is the expert's. Its pick is 150 mm off")
    assert "the wrong robot. The expert would go on with “" in robot
    assert "robot: move the" in robot


@pytest.mark.parametrize(
    ("departure", "words"),
    [
        ("order", "too soon"),
        ("primitive", "wrong primitive"),
        ("object", "wrong object"),
    ],
)
def test_every_deviation_is_explained(departure: str, words: str) -> None:
    case = made_up(steps=[step(2, departure)], left=2)
    assert words in explanation(case)


def test_faults_of_a_policy_are_quoted() -> None:
    error = {"kind": "raised", "explanation": "ValueError: no"}
    case = made_up(failure="policy_error", policy_error=error)
    assert explanation(case) == "The policy itself failed. ValueError: no"


def test_lines_that_a_result_does_not_quote_are_left_out(
    folder: Path, tmp_path: Path
) -> None:
    entries = entries_of(read_results([folder]))
    lines = [json.loads(one) for one in (folder / LINES).read_text().splitlines()]
    lines[0]["progress"] = 0.5
    (tmp_path / LINES).write_text("".join(json.dumps(one) + "\n" for one in lines))
    assert cases_of(entries, [tmp_path]) == ([], [tmp_path / LINES])
    found, uncounted = cases_of(entries, [tmp_path, folder])
    assert (len(found), uncounted) == (len(lines), [tmp_path / LINES])


def test_lines_lie_beside_a_file_of_a_result(folder: Path, tmp_path: Path) -> None:
    entries = entries_of(read_results([folder]))
    (tmp_path / "seed-0").mkdir()
    (tmp_path / "seed-0" / LINES).write_bytes((folder / LINES).read_bytes())
    found, _ = cases_of(entries, [tmp_path / "seed-0.json"])
    assert len(found) == EPISODES * len(KINDS)


def test_pictures_are_spread_over_causes_and_tasks() -> None:
    def case(task: str, departure: str, index: int) -> Case:
        return made_up(task=task, index=index, steps=[step(2, departure)], left=2)

    every = [case("pass", "robot", i) for i in range(5)]
    every += [case("pass", "object", 5), case("stack", "robot", 6)]
    every.append(made_up(success=True, index=7))
    chosen = spread(every, 4)
    assert [one.row["index"] for one in chosen] == [0, 5, 6, 1]
    assert len(spread(every, 99)) == 7
    assert spread(every, 0) == []


def test_an_episode_done_again_is_the_same(cases: list[Case]) -> None:
    seen: list[int] = []

    def before(episode: Episode, number: int) -> None:
        seen.append(number)

    for case in cases[:2]:
        assert differing(case, case.row, before) == []
    assert seen == [0, 1, 2, 0, 1]


def differing(case: Case, row: Row, watch: Watcher) -> list[str]:
    again = play_again(row, case.instance, case.about, watch, strictly=True)
    return list(differences(row, again, strictly=True))


def test_a_difference_is_told(cases: list[Case]) -> None:
    case = cases[1]
    steps = [{**case.row["subtasks"][0], "duration_s": 99.0}]
    changed = {**case.row, "subtasks": steps, "progress": 0.75}
    duration, progress = sorted(differing(case, changed, lambda *_: None), reverse=True)
    assert duration.startswith("subtasks[1].duration_s is 99.0, and ")
    assert progress == "progress is 0.75, and 0.5 when played again"
