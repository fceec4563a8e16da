"""Episodes played again, and the page that plays them from the disk."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from browser import Page as Browser
from browser import page_in_chromium
from clumsy import EPISODES, FAILED, Clumsy, played_clumsily
from command import run as lemma

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.workers.pool import Serial
from lemma.dataset.playback import FrameTaker
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.evaluation.records import SUMMARY
from lemma.evaluation.report.episodes import Case
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.viewer.replays import PAGE, PLAYER, VISER, cases_in, replays_in, write_cases
from lemma.viz.recording import FRAME_S, SOLVED
from lemma.viz.replay import Replayed, expert_instead, replay_line, turn_of


@pytest.fixture(scope="module")
def cases() -> dict[int, Case]:
    found = cases_in(played_clumsily())
    assert [case.cause is None for case in found] == [False] * 2 * FAILED + [True] * 2
    return {
        case.row["index"]: case for case in found if case.name.startswith("high_level")
    }


@pytest.fixture(scope="module")
def again(cases: dict[int, Case]) -> dict[int, Replayed]:
    return {index: replay_line(case) for index, case in cases.items()}


@pytest.mark.parametrize("index", range(EPISODES))
def test_line_gives_the_very_episode(
    index: int, cases: dict[int, Case], again: dict[int, Replayed]
) -> None:
    case, found = cases[index], again[index]
    played = Rollout(case.instance)
    taker = FrameTaker(played.episode.simulation, FRAME_S)
    for _ in roll_out([played], Player(Clumsy()), lenient=False):
        pass
    assert found.differs == ""
    # The rollout goes on after a protective stop, for the lenient verdict.
    for (time_s, qpos), (was_s, was) in zip(
        found.recording.frames, taker.frames, strict=False
    ):
        assert time_s == was_s
        assert qpos.tobytes() == was.tobytes()
    assert found.recording.success is played.success
    assert [line.outcome for line in found.recording.lines] == [
        str(step.result.outcome) for step in played.steps
    ]


def test_line_that_lies_is_found_out_and_one_without_commands_known(
    cases: dict[int, Case],
) -> None:
    row = {**cases[0].row, "elapsed_s": 1.0}
    assert "elapsed_s" in replay_line(replace(cases[0], row=row)).differs
    assert cases[0].is_repeatable
    commanded = {**cases[0].row, "control": {"mode": "ee_pose"}}
    assert not replace(cases[0], row=commanded).is_repeatable


@pytest.mark.parametrize("index", [1, 2, 3])
def test_expert_goes_on_from_the_mistake(
    index: int, cases: dict[int, Case], again: dict[int, Replayed]
) -> None:
    case, found = cases[index], again[index]
    instead = expert_instead(case, found)
    assert instead.success
    assert instead.verdict == SOLVED
    assert not found.recording.success
    turn = turn_of(case)
    assert turn == {1: 1, 2: 0, 3: 0}[index]
    assert instead.lines[:turn] == found.recording.lines[:turn]
    kept = round(found.turn_s / FRAME_S)
    times, before = (
        [time_s for time_s, _ in done.frames[:kept]]
        for done in (instead, found.recording)
    )
    assert times == before
    assert found.turn_s <= found.recording.frames[-1][0] + FRAME_S
    assert instead.lines[turn].start_s >= found.turn_s


@pytest.fixture(scope="module")
def folder(cases: dict[int, Case], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("page")
    played = cases[0].lines.parent
    assert lemma("replay", played, "--browser", out, "--limit", "2") == 0
    assert len(list(out.glob(f"*{VISER}"))) == 2
    return out


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with page_in_chromium(tmp_path_factory.mktemp("profile")) as found:
        nothing = dict.fromkeys(
            ("latency", "downloadThroughput", "uploadThroughput"), 0
        )
        found.ask("Network.emulateNetworkConditions", offline=True, **nothing)
        # Software draws large pictures slowly.
        found.resize(320, 400)
        yield found


@pytest.mark.slow
def test_page_plays_from_the_disk_without_a_network(
    browser: Browser, folder: Path
) -> None:
    browser.open((folder / PAGE).as_uri())
    browser.wait_for("document.body.dataset.at > 0")
    inner = "document.querySelector('iframe').contentDocument"
    browser.wait_for(f"{inner}.querySelector('canvas')")
    assert browser.run("document.querySelectorAll('h2').length") == 2
    assert browser.run("document.body.innerText.includes('Solved.')")
    reached = browser.run("document.querySelector('.reached').innerText")
    assert "of the stages; furthest: " in reached
    assert "nderstood: " in reached
    asked = [
        event["params"]["request"]["url"].partition(":")[0]
        for event in browser.events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert set(asked) <= {"file", "data", "blob"}
    assert not [e for e in browser.events if e["method"] == "Runtime.exceptionThrown"]


@pytest.mark.slow
def test_subtask_leads_to_its_moment(browser: Browser, folder: Path) -> None:
    page = (folder / PAGE).as_uri()
    browser.open(page + "#high_level-stack-2")
    browser.wait_for("document.body.dataset.at > 0")
    last = "[...document.querySelectorAll('section:last-child li')].at(-1)"
    browser.run(f"{last}.querySelector('button').click()")
    browser.wait_for(f"{last}.classList.contains('now')")
    # It goes on from there.
    at = browser.run("Number(document.body.dataset.at)")
    browser.wait_for(f"document.body.dataset.at != {at}")
    wide = "document.documentElement.scrollWidth > document.documentElement.clientWidth"
    browser.resize(390, 700)
    assert not browser.run(wide)


@pytest.mark.slow
def test_pages_of_a_folder_share_one_player(
    browser: Browser, cases: dict[int, Case], tmp_path: Path
) -> None:
    written = write_cases([(7, cases[3])], tmp_path, Serial(), lambda count: None)
    assert written == {7: "7-high_level-stack-3.html"}
    player = tmp_path / PLAYER
    assert (tmp_path / written[7]).stat().st_size < player.stat().st_size
    browser.open((tmp_path / written[7]).as_uri())
    browser.wait_for("document.body.dataset.at > 0")


@pytest.mark.slow
def test_recipe_is_looked_at_too(tmp_path: Path) -> None:
    recipe = tmp_path / "recipe"
    order = GenerateConfig(out=recipe, tasks=("pass",), splits=("val",), episodes=1)
    generate(order, Serial())
    count, replays = replays_in(recipe, "pass", "val", 1)
    assert count == 1
    (found,) = replays
    assert found.name == "pass-val-0"
    (side,) = found.sides
    assert side.success
    assert [line.ok for line in side.lines] == [True, True]
    assert len(found.content) > 50_000


def test_results_are_named_by_their_files_too_and_others_refused(
    tmp_path: Path, cases: dict[int, Case]
) -> None:
    lines = cases[0].lines
    for place in (lines, lines.with_name(SUMMARY), lines.parent):
        count, _ = replays_in(place, None, None, EPISODES)
        assert count == EPISODES
    with pytest.raises(DatasetError, match="neither a recipe nor a result"):
        replays_in(tmp_path, None, None, 1)
    with pytest.raises(InvalidConfigError, match="no episodes of task hook"):
        replays_in(lines.parent, "hook", None, 1)


@pytest.mark.slow
def test_expert_goes_on_where_several_robots_were_at_work(tmp_path: Path) -> None:
    played = tmp_path / "line"
    options = ("--policy", "oracle", "--tasks", "line", "--episodes", "1")
    assert lemma("evaluate", *options, "--out", played) == 0
    (case,) = cases_in(played)
    # As if the expert had been wrong before its fourth sub-task.
    case.__dict__["mistake"] = 3
    found = replay_line(case)
    assert found.differs == ""
    assert found.turn.begun
    instead = expert_instead(case, found)
    assert instead.success
    steps = [line.subtask for line in instead.lines]
    assert sorted(map(str, steps)) == sorted(
        str(line.subtask) for line in found.recording.lines
    )
    assert instead.lines[:3] == found.recording.lines[:3]
    assert any(line.start_s < found.turn_s for line in instead.lines[3:])
