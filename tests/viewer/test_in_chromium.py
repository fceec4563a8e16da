"""The page in a real browser: what visitors do, and what they see of it."""

import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from browser import Page as Browser
from browser import page_in_chromium
from looked_at import EVIL, STACK, seen_at, session_of, until, until_phase

from lemma.viewer.by_hand import NOTHING_TO_ORDER
from lemma.viewer.episode.status import OWN_WORDS, TOGETHER, Phase
from lemma.viewer.page import Page
from lemma.viewer.server import open_server

TRIES, SETTLES_S, FRAMES, NEAR_M = 3, 0.5, 3, np.array([0.0, -0.95, 0.69])
SHOWS = "document.body.innerText.includes({!r})"
CANVAS = "document.querySelector('canvas').getBoundingClientRect()"
BUTTON = (
    "[...document.querySelectorAll('button')]"
    ".find(button => button.innerText.trim() == {!r})"
)


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    page = Page(session_of(STACK), open_server("127.0.0.1", 18080))
    loop = threading.Thread(target=page.run)
    loop.start()
    yield page
    page.close()
    loop.join(10.0)


@pytest.fixture(scope="module")
def browser(page: Page, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with page_in_chromium(tmp_path_factory.mktemp("profile")) as found:
        # Software draws large pictures slowly.
        found.resize(900, 320)
        found.open(page.address)
        found.wait_for(SHOWS.format("Ready"))
        yield found


@pytest.fixture(autouse=True)
def anew(page: Page, browser: Browser) -> None:
    """Begin with the same choices, whichever test was there before."""
    page.session.set_speed(8.0)
    panel = page.panel
    panel.task.value, panel.policy.value = STACK.task, STACK.policy
    panel.index.value, panel.saying.value = STACK.index, "high_level"
    panel.set_table()
    until_phase(page.session.play, Phase.READY)
    browser.wait_for("document.querySelector('[data-phase=READY]')")


def press(browser: Browser, name: str) -> None:
    """Press a button as soon as it is there."""
    browser.wait_for(BUTTON.format(name))
    browser.run(f"{BUTTON.format(name)}.click()")


def say(browser: Browser, text: str) -> None:
    browser.run("document.querySelector('textarea').select()")
    browser.run("document.querySelector('textarea').focus()")
    browser.type(text)


@pytest.mark.slow
def test_expert_is_played_to_success_and_looked_at_again(
    browser: Browser, page: Page
) -> None:
    # Slow enough that it goes on until a slow browser has pressed the button.
    page.session.set_speed(1.0)
    press(browser, "Do it")
    browser.wait_for("document.querySelectorAll('.subtask').length == 2")
    press(browser, "Pause")
    until(lambda: not page.session.play.transport.playing)
    page.session.set_speed(8.0)
    press(browser, "Play")
    browser.wait_for("document.querySelector('[data-phase=SOLVED]')")
    until(lambda: page.session.play.transport.at_end)
    slider = "document.querySelector('[role=slider]')"
    at_s = page.session.play.transport.cursor_s
    browser.wait_for(f"{slider}.ariaValueNow > {at_s - 0.5}")
    browser.run(f"{slider}.focus()")
    for _ in range(3):
        browser.press("ArrowLeft")
    until(lambda: not page.session.play.transport.at_end)
    assert page.session.play.transport.cursor_s > 10.0


def test_typed_text_is_shown_as_it_is(browser: Browser, page: Page) -> None:
    say(browser, f"Fetch me a {EVIL}")
    until(lambda: page.panel.saying.value == OWN_WORDS)
    press(browser, "Do it")
    browser.wait_for("document.querySelector('[data-phase=FAILED]')")
    assert browser.run(SHOWS.format("none of them"))
    assert browser.run(SHOWS.format(EVIL))
    assert browser.run("window.evil") is None


@pytest.mark.slow
def test_cube_is_dragged_and_the_table_is_ones_own(
    browser: Browser, page: Page
) -> None:
    (visitor,) = page._server.get_clients().values()
    assert page.session.play.instance is not None
    ((cube, _),) = page.session.play.instance.goal.pairs
    lies = page.session.play.instance.scene.placement(cube).pose
    to = (0.6 * lies.x, lies.y + 0.2)
    # From near by, where a cube is large, and from the front: a key that was pressed
    # in a test before may have turned the scene.
    middle = np.array([*np.mean([lies.xy, to], 0), 0.0])
    for _ in range(TRIES):
        visitor.camera.position, visitor.camera.look_at = middle + NEAR_M, middle
        # A browser, however slow, draws that before the mouse moves.
        time.sleep(SETTLES_S)
        for _ in range(FRAMES):
            browser.run("new Promise(requestAnimationFrame).then(() => true)")
        size = browser.run(f"[{CANVAS}.width, {CANVAS}.height]")
        start, end = (seen_at(visitor, (*xy, 0.03), size) for xy in (lies.xy, to))
        browser.drag(start, end)
        # A mouse that missed turned the scene, and tries again.
        with suppress(AssertionError):
            until(lambda: page.session.play.request.own is not None, wait_s=10.0)
            break
    own = page.session.play.request.own
    assert own is not None
    assert own.scene.placement(cube).pose.xy == pytest.approx(to, abs=0.05)
    browser.wait_for(SHOWS.format("Your own table"))
    page.session.take_listed()
    until_phase(page.session.play, Phase.READY)
    browser.wait_for(f"!{SHOWS.format('Your own table')}")


@pytest.mark.slow
def test_robot_is_taken_over_and_handed_back(browser: Browser, page: Page) -> None:
    # Slow enough for a browser that is slower.
    page.session.set_speed(0.25)
    press(browser, "Do it")
    press(browser, "Take over")
    browser.wait_for(BUTTON.format("Hand back"))
    play = page.session.play
    led = page.panel.teleoperation.robot
    number = led.options.index(led.value)

    def opening_m() -> float:
        goal = None if play.teleoperator is None else play.teleoperator.target(number)
        return -1.0 if goal is None else float(goal[7])

    press(browser, "Close")
    until(lambda: opening_m() == 0.0)
    press(browser, "Open")
    until(lambda: opening_m() > 0.0)
    page.session.set_speed(8.0)
    press(browser, "Hand back")
    browser.wait_for("document.querySelector('[data-phase=SOLVED]')")
    assert [line.outcome for line in play.status.lines][:2] == ["taken over", "by hand"]


@pytest.mark.slow
def test_four_robots_act_at_once_and_take_orders(browser: Browser, page: Page) -> None:
    panel, session = page.panel, page.session
    session.policies = (*session.policies, TOGETHER)
    panel.policy.options = session.policies
    panel.task.value, panel.policy.value, panel.index.value = "carousel", TOGETHER, 3
    panel.set_table()
    until_phase(session.play, Phase.READY)
    session.set_speed(0.5)
    press(browser, "Do it")
    robots = (
        "new Set([...document.querySelectorAll('.span')].map(s => s.dataset.robot))"
    )
    browser.wait_for(f"{robots}.size == 4")
    until(lambda: session.play.transport.end_s > 1.0)
    press(browser, "Pause")
    # Orders are taken in a pause, too.
    until(lambda: panel.orders.what.value != NOTHING_TO_ORDER)
    press(browser, "Take over")
    browser.wait_for(SHOWS.format("red robot (yours)"))
    ordered = panel.orders.what.value
    press(browser, "Give order")
    session.set_speed(8.0)
    press(browser, "Play")
    browser.wait_for(SHOWS.format(f"red robot: {ordered}"))
    press(browser, "Hand back")
    browser.wait_for("document.querySelector('[data-phase=SOLVED]')")


@pytest.mark.slow
def test_two_tabs_see_the_same(browser: Browser, page: Page) -> None:
    with browser.tab() as other:
        other.resize(500, 300)
        other.open(page.address)
        other.wait_for("document.querySelector('[data-phase]')")
        assert page.session.play.instance is not None
        said = page.session.play.instance.instructions["high_level"]
        for tab in (browser, other):
            tab.wait_for(SHOWS.format(said))


@pytest.mark.slow
def test_page_is_there_at_the_width_of_a_phone(
    browser: Browser, tmp_path: Path
) -> None:
    # A tab that was closed leaves this one in the background, where little is drawn.
    browser.ask("Page.bringToFront")
    browser.resize(390, 640)
    wide = "document.documentElement.scrollWidth > document.documentElement.clientWidth"
    browser.wait_for("document.querySelector('canvas').clientWidth <= 390")
    assert not browser.run(wide)
    panel = (
        "document.getElementById('lemma-style')?.closest('.mantine-Paper-root')"
        ".getBoundingClientRect()"
    )
    browser.wait_for(f"{panel}.width == 390")
    assert browser.run(f"{panel}.top") > 300
    place = f"{BUTTON.format('Do it')}.getBoundingClientRect()"
    assert browser.run(f"{place}.bottom") <= 640
