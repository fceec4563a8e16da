"""Failures in a page: found, and opened where it went wrong, beside the expert."""

import threading
from collections.abc import Iterator
from dataclasses import replace

import pytest
from browser import page_in_chromium
from clumsy import FAILED, KINDS, play_clumsily
from looked_at import until

from lemma.cli.main import main
from lemma.core.errors import InvalidConfigError
from lemma.evaluation.report.episodes import Case
from lemma.viewer.failures.catalog import ALL, Catalog, Filter, words
from lemma.viewer.failures.comparison import NOT_SAID, Cursor
from lemma.viewer.failures.page import FailurePage
from lemma.viewer.failures.panel import MISTAKE, ON, PLAY, START
from lemma.viewer.recording.replays import EXPERT
from lemma.viewer.recording.sources import cases_in
from lemma.viewer.server import open_server

OTHER = "another"


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    return cases_in(play_clumsily(tmp_path_factory.mktemp("clumsy")))


@pytest.fixture(scope="module")
def catalog(cases: list[Case]) -> Catalog:
    return Catalog([*cases, *(replace(case, policy=OTHER) for case in cases)])


@pytest.fixture(scope="module")
def page(catalog: Catalog) -> Iterator[FailurePage]:
    found = FailurePage(catalog, open_server("127.0.0.1", 18180), Filter(OTHER))
    yield found
    found.close()


def seen(page: FailurePage) -> None:
    until(lambda: not page.replayer.busy)
    page.tick(0.0)


def test_failures_are_found_by_policy_task_and_cause(catalog: Catalog) -> None:
    each = FAILED * len(KINDS)
    assert len(catalog.find(Filter())) == 2 * each
    assert len(catalog.find(Filter(policy=OTHER))) == each
    assert not catalog.find(Filter(task="hook"))
    assert len(catalog.causes) == 1 + FAILED
    counts = [len(catalog.find(Filter(cause=cause))) for cause in catalog.causes]
    assert counts[0] == sum(counts[1:])
    assert catalog.tasks == (ALL, "stack")


def test_other_policies_are_found_on_the_same_instance(catalog: Catalog) -> None:
    case, *_ = catalog.find(Filter(policy=OTHER))
    (policy, other), *more = catalog.others(case).items()
    assert not more
    assert policy == other.policy != OTHER
    assert other.row is case.row


def test_there_must_be_a_failure(cases: list[Case]) -> None:
    with pytest.raises(InvalidConfigError, match=r"episodes\.jsonl"):
        Catalog([])
    with pytest.raises(InvalidConfigError, match="None of the 2 episodes failed"):
        Catalog([case for case in cases if case.cause is None])


def test_failure_opens_where_it_went_wrong(page: FailurePage) -> None:
    for wanted in page.panel.cause.options[1:]:
        page.panel.cause.value = wanted
        page.panel.list()
        seen(page)
        found = page.replayer.comparison
        assert found is not None
        assert found.case.cause is not None
        assert words(found.case.cause) == wanted
        policy, expert = found.sides
        assert policy.title == OTHER
        assert not policy.success
        assert expert.success
        at_s = found.case.row["subtasks"][found.case.mistake or 0]["start_s"]
        assert page.cursor.at_s >= at_s - 0.01
        assert not page.cursor.playing


def test_panel_leads_the_cursor(page: FailurePage) -> None:
    page.panel.cause.value = ALL
    page.panel.list()
    first = page.panel.case
    page.panel.turn(ON)
    assert page.panel.case is not first
    seen(page)
    opens_s = page.cursor.at_s
    page.panel.move(START)
    assert page.cursor.at_s == 0.0
    page.panel.move(PLAY)
    page.tick(0.5)
    assert page.cursor.at_s == pytest.approx(0.5)
    page.panel.move(MISTAKE)
    assert page.cursor.at_s == pytest.approx(opens_s)
    assert not page.cursor.playing


def test_two_policies_stand_side_by_side(page: FailurePage) -> None:
    page.panel.beside.value = page.panel.beside.options[1]
    page.panel.look()
    seen(page)
    found = page.replayer.comparison
    assert found is not None
    one, other = found.sides
    assert one.title == OTHER
    assert other.title == page.panel.beside.value != EXPERT
    assert [time_s for time_s, _ in one.frames] == [
        time_s for time_s, _ in other.frames
    ]


def test_motor_commands_cannot_be_done_again(
    page: FailurePage, cases: list[Case]
) -> None:
    case = replace(cases[0], row={**cases[0].row, "control": {}})
    page.replayer.ask(case)
    seen(page)
    assert page.replayer.comparison is not None
    assert page.replayer.comparison.note == NOT_SAID
    assert not page.replayer.comparison.sides


def test_broken_line_leaves_the_page_alive(
    page: FailurePage, cases: list[Case]
) -> None:
    # Of somebody of its own: what was seen before is not done again.
    row = {**cases[0].row, "subtasks": [{}]}
    page.replayer.ask(replace(cases[0], policy="broken", row=row))
    seen(page)
    assert page.replayer.comparison is not None
    assert page.replayer.comparison.note
    page.replayer.ask(cases[0])
    seen(page)
    assert page.replayer.comparison.sides


def test_cursor_stops_at_the_end() -> None:
    cursor = Cursor()
    cursor.open(1.0, 2.0)
    cursor.play()
    cursor.advance(5.0)
    assert (cursor.at_s, cursor.playing) == (2.0, False)
    cursor.play()
    assert (cursor.at_s, cursor.playing) == (0.0, True)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--failures",), "Name their folder"),
        (("nowhere", "--failures"), "There is no nowhere"),
        (("nowhere", "--failures", "--index", "1"), "no instance"),
    ],
)
def test_verb_wants_results(
    more: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["play", *more])
    assert left.value.code == 2
    assert says in capsys.readouterr().err


@pytest.mark.slow
def test_visitor_goes_through_failures(
    catalog: Catalog, tmp_path_factory: pytest.TempPathFactory
) -> None:
    page = FailurePage(catalog, open_server("127.0.0.1", 18190))
    loop = threading.Thread(target=page.run)
    loop.start()
    try:
        with page_in_chromium(tmp_path_factory.mktemp("profile")) as browser:
            # What is drawn in software costs time by its size.
            browser.resize(600, 300)
            browser.open(page.address)
            browser.wait_for("document.querySelector('[data-done=\"2\"]')")
            first = browser.run("document.querySelector('[data-cause]').innerText")
            browser.run(
                "[...document.querySelectorAll('button')]"
                f".find(button => button.innerText.trim() == {ON!r}).click()"
            )
            browser.wait_for(
                f"document.querySelector('[data-cause]').innerText != {first!r}"
            )
            browser.wait_for("document.querySelector('[data-done=\"2\"]')")
            assert browser.run("document.querySelectorAll('.subtask').length") >= 2
    finally:
        page.close()
        loop.join(10.0)
