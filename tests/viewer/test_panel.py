"""The panel without a browser: what its widgets ask for, and what is written there."""

import socket
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from looked_at import STACK, Reads, own, session_of, until

from lemma.core.errors import InvalidConfigError
from lemma.tasks.suite import SUITE, load_instance
from lemma.viewer.page import Page
from lemma.viewer.panel import PAUSE, PLAY, RESTART, STEP
from lemma.viewer.pictures import MAP
from lemma.viewer.wish import OWN_WORDS, Line, Phase, Reading, Status
from lemma.viewer.words import complaint_html, status_html, timeline_html

VISITOR = SimpleNamespace(client_id=1)
EVIL = "<img src=x onerror=alert(1)>{1+1}"


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port


@pytest.fixture
def page() -> Iterator[Page]:
    vague = Reads((("red_cube", "blue_pad"),), 0.2)
    found = Page(session_of(STACK, vague=vague), "127.0.0.1", free_port())
    yield found
    found.close()


def until_true(page: Page, true: Callable[[], bool]) -> None:
    """Let time pass on a page until something is true."""

    def there() -> bool:
        page.tick(0.2)
        return true()

    until(there)
    page.tick(0.0)


def until_phase(page: Page, phase: Phase) -> None:
    until_true(page, lambda: page.session.play.status.phase is phase)


def test_table_is_shown_and_acted_on(page: Page) -> None:
    until_phase(page, Phase.READY)
    assert page.panel.text.value == page.session.play.status.said
    assert len(page.stage.bodies) > 10
    page.panel.move(PLAY)
    until_phase(page, Phase.SOLVED)
    until_true(page, lambda: page.session.play.transport.at_end)
    assert "SOLVED" in page.panel.status.content
    assert page.panel.timeline.content.count("success") == 2
    assert page.panel.time.value == pytest.approx(page.session.play.transport.end_s)


def test_choosing_sets_another_table(page: Page) -> None:
    page.panel.task.value = SUITE[0]
    page.panel.index.value = 7
    page.panel.saying.value = "human"
    page.panel.chosen(VISITOR)
    until_phase(page, Phase.READY)
    expected = load_instance(SUITE[0], "test", 7)
    assert page.session.play.instance == expected
    assert page.panel.text.value == expected.instructions["human"]
    assert page.panel.picture.options[:3] == ("none", MAP, "robot_0")


def test_typing_makes_the_sentence_ones_own(page: Page) -> None:
    until_phase(page, Phase.READY)
    page.panel.text.value = EVIL
    page.panel.typed(VISITOR)
    assert page.panel.saying.value == OWN_WORDS
    page.panel.policy.value = "vague"
    page.panel.act()
    until_phase(page, Phase.FAILED)
    assert "could not be read" in page.panel.status.content
    assert "&lt;img" in page.panel.status.content
    assert "<img" not in page.panel.status.content
    assert page.panel.text.value == EVIL


def test_what_cannot_be_is_said_until_something_else_is_asked(page: Page) -> None:
    until_phase(page, Phase.READY)
    page.panel.policy.value = "os:system"
    page.panel.act()
    page.tick(0.0)
    assert "os:system" in page.panel.status.content
    page.panel.policy.value = "oracle"
    page.panel.move(RESTART)
    until_phase(page, Phase.READY)
    assert "READY" in page.panel.status.content


def test_step_pause_and_seek(page: Page) -> None:
    until_phase(page, Phase.READY)
    page.panel.move(STEP)
    play = page.session.play
    until_true(page, lambda: bool(play.status.lines) and not play.transport.playing)
    first = play.status.lines[0]
    assert first.end_s is not None
    assert play.transport.cursor_s == pytest.approx(first.end_s, abs=1.1)
    page.panel.time.value = 1.0
    page.panel.sought(VISITOR)
    page.tick(1.0)
    assert play.transport.cursor_s == pytest.approx(1.0)
    page.panel.move(PLAY)
    page.tick(0.5)
    page.panel.move(PAUSE)
    page.tick(5.0)
    assert play.transport.cursor_s == pytest.approx(1.5)


def test_overlays_are_switched(page: Page) -> None:
    until_phase(page, Phase.READY)
    names = page.stage.overlays["reach"]
    assert not any(handle.visible for handle in names)
    page.panel.overlays["reach"].value = True
    assert all(handle.visible for handle in names)
    page.panel.overlays["contacts"].value = True
    page.tick(0.0)
    (contacts,) = page.stage.overlays["contacts"]
    assert len(contacts.points) > 0
    assert np.abs(contacts.points[:, 2]).max() < 0.2


@pytest.mark.render
def test_pictures_follow(page: Page) -> None:
    until_phase(page, Phase.READY)
    page.panel.picture.value = "robot_0"
    until_true(page, lambda: page.panel.image.visible)
    assert page.panel.image.image.shape == (360, 480, 3)
    assert page.panel.image.image.std() > 5.0


def test_two_pages_take_two_ports_and_know_nothing_of_each_other(page: Page) -> None:
    other = Page(session_of(), "127.0.0.1", page.port)
    assert other.port != page.port
    other.session.ask(own("x"), acts=True)
    until_phase(page, Phase.READY)
    other.close()


def test_nothing_that_was_typed_is_markup() -> None:
    status = Status(Phase.BROKEN, EVIL, EVIL, EVIL, Reading(None, EVIL))
    line = Line(EVIL, 0.0, 1.0, EVIL, EVIL, ok=False)
    written = status_html(status) + complaint_html(EVIL) + timeline_html((line,), 2.0)
    assert "<img" not in written
    assert written.count("&lt;img") == 7


def test_timeline_says_what_runs_and_what_is_still_to_come() -> None:
    lines = (Line("one", 0.0, 2.0, "success"), Line("two", 2.0, 3.0, "no_grasp", "Why"))
    before = timeline_html(lines, 1.0)
    assert "success" not in before
    assert before.index("600") < before.index("one") < before.index("two")
    after = timeline_html(lines, 3.0)
    assert "success" in after
    assert "no grasp" in after


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 10**6), ("300.1.1.1", 8080)])
def test_impossible_address_is_refused(host: str, port: int) -> None:
    session = session_of()
    with pytest.raises(InvalidConfigError):
        Page(session, host, port)
    session.close()
