"""The panel without a browser: what its widgets ask for, and what is written there."""

import json
import socket
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import viser
from looked_at import EVIL, STACK, Explains, Reads, own, session_of, until
from tiers import slow_but

from lemma.core.poses import Pose2
from lemma.policies.interfaces import Insight, SeenObject
from lemma.scene.objects.entity import entity_named
from lemma.tasks.subtask import STOP
from lemma.tasks.suite import SUITE, load_instance
from lemma.viewer.by_hand import CLOSE
from lemma.viewer.episode.reading import Explanation
from lemma.viewer.episode.status import OWN_WORDS, Phase, Reading, Status
from lemma.viewer.episode.teleoperator import BY_HAND, Teleoperator
from lemma.viewer.page import PAUSE, PLAY, RESTART, STEP, Page
from lemma.viewer.scene.pictures import MAP
from lemma.viewer.server import open_server
from lemma.viewer.words import part, status_html, why_html
from lemma.viz.recording import Line

VISITOR = SimpleNamespace(client_id=1)


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port


GOAL = load_instance("stack", "test", 0).goal.pairs


@pytest.fixture
def page() -> Iterator[Page]:
    vague = Reads((("red_cube", "blue_pad"),), 0.2)
    session = session_of(STACK, vague=vague, knows=Explains(GOAL, 0.9))
    session.policies = (*session.policies, BY_HAND)
    found = Page(session, open_server("127.0.0.1", free_port()))
    until_phase(found, Phase.READY)
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
    assert page.panel.text.value == page.session.play.status.said
    assert page.stage.bodies is not None
    assert len(page.stage.bodies.nodes) > 10
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


def test_complaint_stays_until_the_next_request(page: Page) -> None:
    page.panel.policy.value = "os:system"
    page.panel.act()
    page.tick(0.0)
    assert "os:system" in page.panel.status.content
    page.panel.policy.value = "oracle"
    page.panel.move(RESTART)
    until_phase(page, Phase.READY)
    assert "READY" in page.panel.status.content


def test_step_pause_and_seek(page: Page) -> None:
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
    names = page.stage.overlays["reach"]
    assert not any(handle.visible for handle in names)
    page.panel.overlays["reach"].value = True
    assert all(handle.visible for handle in names)
    page.panel.overlays["contacts"].value = True
    page.tick(0.0)
    (contacts,) = page.stage.overlays["contacts"]
    assert len(contacts.points) > 0
    assert np.abs(contacts.points[:, 2]).max() < 0.2


def test_way_of_the_hand_is_drawn(page: Page) -> None:
    page.panel.overlays["path"].value = True
    page.panel.move(PLAY)
    until_true(page, lambda: bool(page.stage.overlays["path"]))
    lines, _ = page.stage.overlays["path"]
    assert lines.visible
    (bottom,) = [bottom for _, bottom in GOAL]
    at = load_instance("stack", "test", 0).scene.placement(bottom).pose
    assert np.abs(lines.points[:, 0, :2] - at.xy).sum(-1).min() < 0.01


def test_why_is_said_and_drawn(page: Page) -> None:
    page.panel.policy.value = "knows"
    page.panel.overlays["perceived"].value = True
    page.panel.act()
    until_true(page, lambda: "Why" in page.panel.why.content)
    assert "90% stop" in page.panel.why.content
    assert "10% " in page.panel.why.content
    assert page.panel.why.content.count("cm inside") == 2
    assert page.panel.why.content.count("cm too far") == 2
    drawn = page.stage.overlays["perceived"]
    assert all(node.visible for node in drawn)
    assert any("goes on top" in str(getattr(node, "text", "")) for node in drawn)
    page.panel.move(RESTART)
    page.panel.policy.value = "oracle"
    page.panel.set_table()
    until_phase(page, Phase.READY)
    assert not page.stage.overlays["perceived"]
    assert not page.panel.why.content


@pytest.mark.slow
def test_policy_behind_an_address_is_offered(page: Page) -> None:
    for bad in ("os:system", "", "http://", "file:///etc/passwd"):
        page.panel.address.value = bad
        page.panel.offer()
        assert "not the address" in page.panel.status.content
    page.panel.address.value = " http://127.0.0.1:1 "
    page.panel.offer()
    assert page.panel.policy.value == "http://127.0.0.1:1"
    page.panel.act()
    until_phase(page, Phase.BROKEN)
    assert "127.0.0.1:1" in page.panel.status.content
    page.panel.policy.value = "oracle"
    page.panel.set_table()
    until_phase(page, Phase.READY)


@pytest.mark.render
def test_pictures_follow(page: Page) -> None:
    page.panel.picture.value = "robot_0"
    until_true(page, lambda: page.panel.image.visible)
    assert page.panel.image.image.shape == (360, 480, 3)
    assert page.panel.image.image.std() > 5.0


class Client:
    """Stands for a visitor who is given files."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}

    def send_file_download(self, name: str, content: bytes, **_: object) -> None:
        self.files[name] = content


def test_table_is_saved_and_opened_again(page: Page) -> None:
    top = load_instance("stack", "test", 0).goal.pairs[0][0]
    page.panel.table.drop(top, Pose2(0.1, 0.7))
    until_phase(page, Phase.READY)
    assert "problem" in page.panel.table.text.content
    visitor = Client()
    page.panel.table.download(visitor)
    ((name, content),) = visitor.files.items()
    assert name == "stack-own-0.json"
    own = page.session.play.instance
    page.session.take_listed()
    until_phase(page, Phase.READY)
    assert page.session.play.instance != own
    page.panel.table.read(content)
    until_phase(page, Phase.READY)
    assert page.session.play.instance == own
    # Another choice means a table of the list.
    page.panel.index.value = 3
    page.panel.chosen(VISITOR)
    until_phase(page, Phase.READY)
    assert page.session.play.instance == load_instance("stack", "test", 3)


def led(page: Page) -> Teleoperator:
    return page.session.play.teleoperator or Teleoperator()


def test_visitor_takes_over_and_hands_back(page: Page) -> None:
    pilot = page.panel.teleoperation
    pilot.take_over()
    page.tick(0.0)
    assert "while an episode runs" in page.panel.status.content
    page.panel.act()
    until_true(page, lambda: pilot.take.visible)
    assert not pilot.grips.visible
    # There is nothing to save yet.
    assert not pilot.save.visible
    pilot.take_over()
    until_true(page, lambda: pilot.back.visible)
    assert pilot.grips.visible
    # Of the robot that was acting.
    assert page.session.play.instance is not None
    acted = page.session.play.explanations[0].robot
    names = page.session.play.instance.scene.robot_names
    assert pilot.robot.value == pilot.robot.options[names.index(acted)]
    assert not pilot.take.visible
    assert "You lead" in page.panel.timeline.content
    # There is something to save once a command was carried out by hand.
    until_true(page, lambda: page.session.play.was_led)
    page.session.play.hand_back()
    until_true(page, lambda: pilot.take.visible)
    assert not pilot.grips.visible
    assert pilot.save.visible


def test_handles_of_a_hand_are_there_while_it_is_led(page: Page) -> None:
    visitor = Client()
    page.panel.teleoperation.download(visitor)
    assert not visitor.files
    page.panel.policy.value = BY_HAND
    page.panel.act()
    until_true(page, lambda: led(page).target(1) is not None)
    assert page.panel.teleoperation.folder.visible
    robots = page.panel.teleoperation.robot
    robots.value = robots.options[1]
    page.panel.teleoperation.grip(CLOSE)
    goal = led(page).target(1)
    assert goal is not None
    assert goal[7] == 0.0
    until_true(page, lambda: page.session.play.transport.cursor_s > 0.3)
    page.panel.teleoperation.download(visitor)
    ((name, content),) = visitor.files.items()
    assert name == "stack-test-0-by-hand.json"
    (part,) = json.loads(content)["done"]["commanded"]
    assert len(part["rows"]) >= 6
    assert not page.panel.teleoperation.back.visible
    page.panel.policy.value = "oracle"
    page.panel.set_table()
    until_phase(page, Phase.READY)
    assert not page.panel.teleoperation.folder.visible


def test_file_that_holds_no_table_is_refused(page: Page) -> None:
    for content in (b"", b"[]", b"x" * 2_000_000):
        page.panel.table.read(content)
        page.tick(0.0)
        assert "The file" in page.panel.status.content
    assert page.session.play.request.own is None


def test_carried_things_are_shown_and_snap_back(page: Page) -> None:
    hands, bodies = page.panel.table.dragging, page.stage.bodies
    assert bodies is not None
    name = load_instance("stack", "test", 0).goal.pairs[0][0]
    before = bodies.pose(name)
    bodies.elsewhere[name] = Pose2(0.1, 0.0)
    page.tick(0.0)
    (node,) = [n for n in bodies.nodes.values() if n.name == f"/world/{name}"]
    assert node.position[0] == pytest.approx(before.x + 0.1)
    hands.let_go()
    page.tick(0.0)
    assert node.position[0] == pytest.approx(before.x)


def test_two_pages_take_two_ports_and_know_nothing_of_each_other(page: Page) -> None:
    other = Page(session_of(), open_server("127.0.0.1", page.port))
    assert other.port != page.port
    other.session.ask(own("x"), acts=True)
    until_phase(page, Phase.READY)
    other.close()


@pytest.mark.parametrize(
    ("origin", "opens"),
    [
        (None, True),
        ("http://127.0.0.1:{port}", True),
        ("http://evil.example", False),
        *slow_but([("http://127.0.0.1:1", False), ("null", False)]),
    ],
)
def test_other_pages_cannot_steer_this_one(
    page: Page, origin: str | None, opens: bool
) -> None:
    client = pytest.importorskip("websockets.sync.client")
    asked = {
        "origin": origin and origin.format(port=page.port),
        "subprotocols": [f"viser-v{viser.__version__}"],
        "proxy": None,
    }
    address = page.address.replace("http", "ws")
    if opens:
        with client.connect(address, **asked) as socket:
            assert socket.recv(timeout=10.0)
    else:
        with pytest.raises(Exception, match="403"):
            client.connect(address, **asked)


def test_why_says_what_lies_under_something_else() -> None:
    ((top, bottom),) = GOAL
    seen = Insight((SeenObject(top, (0.3, 0.2)),), (), GOAL, ((STOP, 0.9),))
    instance = load_instance("stack", "test", 0)
    hidden = why_html(Explanation(0.0, seen, covers=((bottom, top),)), instance)
    phrases = [entity_named(name).phrase for name in (top, bottom)]
    assert "The {} hides the {}.".format(*phrases) in hidden
    assert "It sees no" not in hidden
    assert f"It sees no {phrases[1]}" in why_html(Explanation(0.0, seen), instance)


def test_nothing_that_was_typed_is_markup() -> None:
    status = Status(Phase.BROKEN, EVIL, EVIL, Reading(None, EVIL))
    lines = (Line(EVIL, 0.0, 1.0, EVIL, EVIL, ok=False),)
    written = status_html(status) + part("complaint", EVIL)
    written += part("timeline", lines, 2.0)
    assert "<img" not in written
    assert written.count("&lt;img") == 7


def test_timeline_says_what_runs_and_what_is_still_to_come() -> None:
    lines = (Line("one", 0.0, 2.0, "success"), Line("two", 2.0, 3.0, "no_grasp", "Why"))
    before = part("timeline", lines, 1.0)
    assert "success" not in before
    assert before.index("600") < before.index("one") < before.index("two")
    after = part("timeline", lines, 3.0)
    assert "success" in after
    assert "no grasp" in after
