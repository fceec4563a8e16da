"""The page of a report, in a browser and in its bytes."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from browser import Page, page_in_chromium
from clumsy import EPISODES, FAILED, KINDS, played_clumsily
from command import run as lemma

from lemma.cli.report import ReportOptions, choose, report, within
from lemma.core.errors import InvalidConfigError
from lemma.evaluation.report.episodes import Case, cases_of
from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.tasks.suite import load_instance
from lemma.viz.pages.demo import Illustration
from lemma.viz.pages.demo import write_page as write_demo
from lemma.viz.pages.report import (
    Findings,
    demo_command,
    failures_data,
    write_report_page,
)
from lemma.viz.pages.report_pictures import Pictures, picture
from lemma.viz.recording import record

PIXEL = (
    b"GIF89a\x01\x00\x01\x00\x80\x00\x00\x00\x00\x00\xff\xff\xff,\x00\x00\x00\x00\x01"
    b"\x00\x01\x00\x00\x02\x02D\x01\x00;"
)
SEEN = Pictures(PIXEL, PIXEL, PIXEL, "")
ALL = EPISODES * len(KINDS)
LOST = FAILED * len(KINDS)


@pytest.fixture(scope="module")
def folder() -> Path:
    return played_clumsily()


@pytest.fixture(scope="module")
def cases(folder: Path) -> list[Case]:
    found, _ = cases_of(entries_of(read_results([folder])), [folder])
    return found


@pytest.fixture(scope="module")
def written(
    folder: Path, cases: list[Case], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("page") / "index.html"
    found = Findings(cases, {1: SEEN, 3: SEEN}, "Some were left out.")
    write_report_page(path, entries_of(read_results([folder])), found)
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with page_in_chromium(tmp_path_factory.mktemp("browser")) as page:
        yield page


@pytest.fixture
def page(browser: Page, written: Path) -> Page:
    browser.events.clear()
    browser.prefer("light")
    browser.resize(1280)
    browser.open(written.as_uri())
    return browser


def cards(page: Page) -> list[str]:
    found: list[str] = page.run(
        "[...document.querySelectorAll('.case')].map(c => c.dataset.id)"
    )
    return found


def choose_option(page: Page, name: str, value: str) -> None:
    page.run(
        f"(() => {{ const s = document.querySelector('select[name={name}]'); "
        f"s.value = {json.dumps(value)}; s.dispatchEvent(new Event('change')); }})()"
    )


@pytest.mark.slow
def test_the_page_is_whole_and_asks_for_nothing(page: Page) -> None:
    assert not [e for e in page.events if e["method"] == "Runtime.exceptionThrown"]
    asked = [
        event["params"]["request"]["url"]
        for event in page.events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert asked
    assert all(re.match(r"(file|data|about|blob):", address) for address in asked)
    assert page.run("document.querySelectorAll('svg').length") >= 8
    assert page.run("[...document.images].every(i => i.alt)")
    count = page.run("document.querySelector('.count').textContent")
    assert f"{LOST} of {ALL} episodes; 2 with pictures." in count
    # Those with pictures come first.
    assert len(cards(page)) == LOST
    assert cards(page)[:2] == ["0/high_level/stack/1", "0/high_level/stack/3"]
    assert page.run("document.querySelectorAll('.case img').length") == 6
    # A download is a file on its own.
    figure = "document.querySelector('#success-by-task-unseen svg')"
    assert page.run(f"standalone({figure}).includes('var(')") is False


def test_filters_act_and_stay_in_the_address(page: Page) -> None:
    choose_option(page, "cause", "wrong_robot")
    assert cards(page) == ["0/high_level/stack/3", "0/unseen/stack/3"]
    choose_option(page, "kind", "unseen")
    assert cards(page) == ["0/unseen/stack/3"]
    address = page.run("location.href")
    assert address.endswith("#failures?kind=unseen&cause=wrong_robot")
    page.open(address)
    assert cards(page) == ["0/unseen/stack/3"]
    assert (
        page.run("document.querySelector('select[name=cause]').value") == "wrong_robot"
    )
    page.run("document.querySelector('.filters button').click()")
    assert len(cards(page)) == LOST
    assert page.run("location.hash") == "#failures"


def test_options_say_how_many_there_are_solved_ones_as_well(page: Page) -> None:
    said = page.run(
        "[...document.querySelectorAll('select[name=cause] option')]"
        ".filter(o => !o.disabled).map(o => o.textContent)"
    )
    causes = "wrong robot", "missed pick", "stopped early"
    assert said == [f"all ({LOST})", *(f"{cause} ({len(KINDS)})" for cause in causes)]
    choose_option(page, "outcome", "all")
    assert len(cards(page)) == ALL
    choose_option(page, "outcome", "solved")
    assert cards(page) == [f"0/{kind}/stack/0" for kind in KINDS]


def test_an_episode_can_be_linked_and_links_keep_the_filters(
    page: Page, written: Path
) -> None:
    choose_option(page, "cause", "missed_pick")
    page.run("document.querySelector('nav a[href=\"#tables\"]').click()")
    assert page.run("location.hash") == "#tables?cause=missed_pick"
    assert len(cards(page)) == len(KINDS)
    page.open(written.as_uri())
    page.run("document.querySelectorAll('.case header a')[1].click()")
    page.wait_for("document.querySelectorAll('.case').length == 1")
    assert cards(page) == ["0/high_level/stack/3"]
    page.open(written.as_uri() + "#failures?episode=nobody")
    assert cards(page) == []


@pytest.mark.parametrize("form", ["latex", "markdown"])
def test_tables_are_copied(page: Page, form: str) -> None:
    page.ask(
        "Browser.grantPermissions",
        permissions=["clipboardReadWrite", "clipboardSanitizedWrite"],
    )
    page.ask("Page.bringToFront")
    button = f'button[data-copy={form}][data-table="high-level-instructions"]'
    page.run(f"document.querySelector('{button}').click()")
    page.wait_for(f"document.querySelector('{button}').textContent == 'Copied'")
    text = page.run("navigator.clipboard.readText()")
    assert (r"\toprule" if form == "latex" else "| :--- | ---: |") in text
    assert "clumsy:Clumsy" in text


def test_the_keyboard_is_enough(page: Page) -> None:
    page.press("j")
    page.press("j")
    focused = "document.activeElement.dataset.id"
    assert page.run(focused) == "0/high_level/stack/3"
    page.press("k")
    assert page.run(focused) == "0/high_level/stack/1"
    page.press("Tab")
    assert page.run("document.activeElement.tagName") == "A"
    page.run("document.querySelector('select[name=kind]').focus()")
    page.press("ArrowDown")
    page.press("j")
    assert page.run("document.activeElement.name") == "kind"


@pytest.mark.parametrize(("scheme", "width"), [("light", 400), ("dark", 1280)])
def test_the_page_fits(page: Page, scheme: str, width: int) -> None:
    page.resize(width)
    page.prefer(scheme)
    assert page.run("document.documentElement.scrollWidth") == width
    # Text against its ground, by the contrast that WCAG asks of small text.
    contrast = page.run(
        """(() => {
          const style = getComputedStyle(document.documentElement);
          const light = (name) => {
            const hex = style.getPropertyValue(name).trim().slice(1);
            const part = (i) => parseInt(hex.slice(2 * i, 2 * i + 2), 16) / 255;
            const line = (c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
            const [red, green, blue] = [0, 1, 2].map((i) => line(part(i)));
            return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
          };
          return ["--ink", "--faint", "--bad", "--good", "--expert"].map((name) => {
            const both = [light(name), light("--card")].sort((a, b) => b - a);
            return (both[0] + 0.05) / (both[1] + 0.05);
          });
        })()"""
    )
    assert min(contrast) >= 4.5


def test_nothing_in_a_name_becomes_html(
    page: Page, folder: Path, cases: list[Case], tmp_path: Path
) -> None:
    case = cases[1]
    evil = "</script><img src=x onerror=document.title='caught'>"
    changed = Case(evil, {**case.row, "instruction": evil}, case.about, case.lines)
    path = tmp_path / "index.html"
    write_report_page(path, entries_of(read_results([folder])), Findings([changed]))
    page.open(path.as_uri())
    assert evil in page.run("document.querySelector('.case h3').textContent")
    assert page.run("document.title") == "LEMMA Bench: a report"


def test_failures_are_plain_data(cases: list[Case]) -> None:
    data = failures_data(Findings(cases, {1: SEEN}))
    assert data["policies"] == ["clumsy:Clumsy"]
    solved, early, missed, robot = data["cases"][:EPISODES]
    assert "steps" not in solved
    assert solved["outcome"] == "solved"
    assert early["map"].startswith("data:image/jpeg;base64,")
    assert "map" not in missed
    assert missed["steps"][0]["errors"].startswith("pick 150 mm off")
    assert robot["steps"][0]["departs"] == "wrong robot"
    assert robot["steps"][0]["expert"] != robot["steps"][0]["words"]
    assert robot["film"].endswith(
        "--episode high_level/stack/3 --videos --out out/film"
    )


def test_demo_is_offered_where_it_plays_the_same(cases: list[Case]) -> None:
    assert demo_command(cases[1]) == (
        "lemma demo stack --split val --index 1 --policy clumsy:Clumsy"
    )
    assert demo_command(cases[EPISODES + 1]) == ""
    for changed in (
        {"policy": {**cases[1].about["policy"], "gta": True}},
        {"weights": {"reachnet": {"sha256": "", "seed": 1, "data": {}}}},
    ):
        told = replace(cases[1], about={**cases[1].about, **changed})
        assert demo_command(told) == ""


@pytest.mark.slow
def test_pictures_are_of_some_episodes_or_one(cases: list[Case]) -> None:
    (chosen,) = choose(cases, ReportOptions(episode="high-level/stack/2"))
    assert chosen == (2, cases[2])
    says = "No episode high_level/stack/0 failed"
    with pytest.raises(InvalidConfigError, match=says):
        choose(cases, ReportOptions(episode="high_level/stack/0"))
    some = choose(cases, ReportOptions(failures=3))
    assert [number for number, _ in some] == [1, 2, 3]
    drawn = dict.fromkeys(range(10), SEEN)
    assert within(drawn, 10 * SEEN.size) == drawn
    assert list(within(drawn, 5 * SEEN.size)) == [0, 2, 4, 6, 8]
    assert within({}, 1.0) == {}


@pytest.mark.slow
def test_the_verb_writes_page_tables_and_figures(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report((folder,), tmp_path, wishes=ReportOptions(failures=0)) == 0
    said = capsys.readouterr().out
    assert f"0 of {LOST} failed episodes have pictures" in said.replace("\n", " ")
    assert (tmp_path / "results.md").exists()
    assert len(list((tmp_path / "figures").glob("*.svg"))) == 12
    text = (tmp_path / "index.html").read_text()
    assert not re.search(r"(?:src|href)=\"(?!#|data:)", text)
    assert not re.search(r"https?://(?!www\.w3\.org)", text)
    assert lemma("report", folder, "--failures", "-1", "--out", tmp_path) == 2


@pytest.mark.slow
@pytest.mark.render
def test_failures_are_drawn_and_filmed(cases: list[Case], tmp_path: Path) -> None:
    # As packed lines have it, without the time that it took.
    row = {name: cases[2].row[name] for name in cases[2].row if name != "wall_s"}
    film = tmp_path / "videos" / "2.mp4"
    seen = picture(replace(cases[2], row=row), film)
    assert seen.differs == ""
    assert seen.video == "videos/2.mp4"
    assert (tmp_path / seen.video).stat().st_size > 10_000
    assert all(one[:2] == b"\xff\xd8" for one in (seen.map, seen.before, seen.after))
    # The wrong robot has no poses, so its map has the expert's arrow alone.
    assert picture(cases[3]).map != seen.map
    assert seen.size < 150_000


@pytest.mark.slow
def test_demo_fits_a_phone_and_its_subtasks_lead_into_the_video(
    browser: Page, tmp_path: Path
) -> None:
    done = record(load_instance("hook_stack", "test", 42), horizon_s=20.0)
    (tmp_path / "hook_stack.mp4").write_bytes(b"")
    seen = Illustration(tmp_path / "hook_stack.mp4", PIXEL, PIXEL)
    path = tmp_path / "demo.html"
    write_demo(path, [done], [seen], 4, {"hook_stack": "replays/hook_stack.html"})
    browser.resize(390)
    browser.open(path.as_uri())
    wide = "document.documentElement.scrollWidth > 390"
    assert not browser.run(wide)
    table = "document.querySelector('.scroll')"
    assert browser.run(f"{table}.scrollWidth <= {table}.clientWidth")
    assert browser.run("document.querySelector('a.chip').pathname").endswith(
        "/replays/hook_stack.html"
    )
    at = "document.querySelector('video').currentTime"
    button, span = "li:last-child button", ".span[data-number='2']"
    leads = {
        button: f"Number(document.querySelector('{button}').dataset.s)",
        span: f'document.querySelector("{span}").dataset.start / 4',
    }
    for selector, wanted in leads.items():
        click = "dispatchEvent(new MouseEvent('click', { bubbles: true }))"
        browser.run(f'document.querySelector("{selector}").{click}')
        assert browser.run(at) == pytest.approx(browser.run(wanted), abs=0.01)
