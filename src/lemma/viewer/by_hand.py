"""Panel widgets for changes of the table, orders, and teleoperation by a visitor."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import viser

from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.core.poses import Pose2
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.rules import problems
from lemma.tasks.subtask import SubTask
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.session import Session
from lemma.viewer.episode.team_play import Options, TeamPlay
from lemma.viewer.episode.teleoperator import Teleoperator
from lemma.viewer.scene.dragging import Dragging
from lemma.viewer.words import order_words, part, team_html

LARGEST_FILE = 1_000_000
"""Largest size of an uploaded file [bytes]; larger ones are refused."""
NOTHING_TO_ORDER = "nothing now"
OPEN, CLOSE = GRIPS = ("Open", "Close")
TARGET = "/teleoperation"
"""Name of the scene node with the handles of the hand."""
_SCALE = 0.3

Complain = Callable[[str], None]
"""Called with the reason why an action is impossible; with ``""`` after success."""


@contextmanager
def complaining(complain: Complain) -> Iterator[None]:
    """Report a :class:`LemmaError` of the body, or success."""
    try:
        yield
    except LemmaError as error:
        complain(str(error))
    else:
        complain("")


def show_if(widget: Any, visible: bool) -> None:
    """Show or hide a widget; send only changes."""
    if widget.visible != visible:
        widget.visible = visible


class DraggingPanel:
    """Widgets for changes of a table by hand."""

    def __init__(
        self, server: viser.ViserServer, session: Session, complain: Complain
    ) -> None:
        """Make the widgets, and the dragging that they control.

        Args:
            server: The page's server.
            session: The session that receives their commands.
            complain: Called with the reason why an action is impossible.
        """
        self._session, self._complain = session, complain
        self.dragging = Dragging(server, self.drop)
        gui: Any = server.gui
        with gui.add_folder("Table"):
            self.text = gui.add_html("")
            hint = "Cubes, pads and the stick. Click to turn one."
            self.things = gui.add_checkbox("Drag things", True, hint=hint)
            hint = "Before an episode."
            self.robots = gui.add_checkbox("Drag robots", False, hint=hint)
            save = gui.add_button("Save table as JSON")
            upload = gui.add_upload_button("Open table", mime_type=".json")
            self.reset = gui.add_button("Back to the list", visible=False)
        save.on_click(lambda event: self.download(event.client))
        upload.on_upload(lambda event: self.read(event.target.value.content))
        self.reset.on_click(lambda _: session.take_listed())
        self._moved: Any = None
        self._instance: Instance | None = None

    def drop(self, name: str, pose: Pose2) -> None:
        """Put a dragged robot or object at a pose, if it can be there."""
        with complaining(self._complain):
            try:
                self._session.move(name, pose)
            except LemmaError:
                self.dragging.let_go()
                raise

    def download(self, client: Any) -> None:
        """Send a visitor the table as a JSON file for ``--instance``."""
        with complaining(self._complain):
            table = self._session.play.request.instance()
            name = f"{table.task}-{table.split}-{table.index}.json"
            content = table.to_json().encode()
            client.send_file_download(name, content, save_immediately=True)

    def read(self, content: bytes) -> None:
        """Set the table from the content of a JSON file."""
        with complaining(self._complain):
            if len(content) > LARGEST_FILE:
                raise InvalidConfigError(
                    f"The file has more than {LARGEST_FILE:,} bytes."
                )
            self._session.take(Instance.read(content, "The file"))

    def refresh(self, play: Play) -> None:
        """Report problems of a table, and undo impossible moves."""
        request = play.request
        if play.instance is not None and play.instance is not self._instance:
            self._instance = play.instance
            own = request.own is not None
            bad = problems(request.instance()) if own else ()
            self.text.content = part("table", own, bad)
            show_if(self.reset, own)
        if play.moved is not None and play.moved is not self._moved:
            self._moved = play.moved
            self.dragging.let_go()
            self._complain(play.moved.problem)

    def allow(self, instance: Instance) -> None:
        """Allow dragging of the groups whose box is ticked."""
        names = set(instance.scene.object_names) if self.things.value else set()
        if self.robots.value:
            names |= set(instance.scene.robot_names)
        self.dragging.allow(names)


class OrderPanel:
    """Widgets for orders to single robots; visible while all act at once."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        """Make the widgets.

        Args:
            server: The page's server.
            session: The session that receives their commands.
        """
        self._session = session
        self._asked: tuple[object, ...] = ()
        self._options: Options | None = None
        self._text = ""
        self._play: TeamPlay | None = None
        self._by_words: dict[str, SubTask] = {}
        gui: Any = server.gui
        with gui.add_folder("Orders", visible=False) as self.folder:
            self.text = gui.add_html("")
            self.robot = gui.add_dropdown("Robot", ("robot",))
            hint = "It finishes its sub-task and then follows your orders only."
            self.take = gui.add_button("Take over", hint=hint)
            hint = "Let the expert lead this robot again."
            self.back = gui.add_button("Hand back", hint=hint, visible=False)
            self.what = gui.add_dropdown("Order", (NOTHING_TO_ORDER,))
            hint = "Begins once the robot is free and its objects are in place."
            self.give = gui.add_button("Give order", color="blue", hint=hint)
        self.take.on_click(lambda _: self.lead(by_visitor=True))
        self.back.on_click(lambda _: self.lead(by_visitor=False))
        self.give.on_click(lambda _: self.order())

    def _chosen(self, play: TeamPlay) -> str:
        """Return the name of the chosen robot."""
        assert play.instance is not None
        names, options = play.instance.scene.robot_names, self.robot.options
        found = self.robot.value in options and len(options) == len(names)
        return names[options.index(self.robot.value) if found else 0]

    def lead(self, *, by_visitor: bool) -> None:
        """Take the chosen robot for the visitor, or give it back to the expert."""
        play = self._session.play
        if isinstance(play, TeamPlay) and play.takes_orders:
            (play.take if by_visitor else play.give_back)(self._chosen(play))

    def order(self) -> None:
        """Send the chosen order."""
        play, subtask = self._session.play, self._by_words.get(self.what.value)
        if isinstance(play, TeamPlay) and play.takes_orders and subtask is not None:
            play.order(subtask)

    def refresh(self, play: Play) -> None:
        """Show the robots' activities and the possible orders of the chosen one."""
        here = isinstance(play, TeamPlay) and play.takes_orders
        show_if(self.folder, here)
        if not isinstance(play, TeamPlay) or not here or play.instance is None:
            return
        instance = play.instance
        if play is not self._play:
            self._play, self._asked, self._options = play, (), None
            self.robot.options = robot_phrases(instance.scene.robots)
        robot = self._chosen(play)
        show_if(self.take, robot not in play.visitor_led)
        show_if(self.back, robot in play.visitor_led)
        text = team_html(play)
        if text != self._text:
            self._text = self.text.content = text
        asked = robot, play.status.lines, play.todo
        if asked != self._asked:
            self._asked = asked
            play.look_for_options(robot)
        options = play.options
        if options is not self._options and options and options.robot == robot:
            self._options = options
            self._by_words = {
                order_words(subtask, instance): subtask for subtask in options.subtasks
            }
            words = tuple(self._by_words) or (NOTHING_TO_ORDER,)
            if self.what.options != words:
                self.what.options = words


class TeleoperationPanel:
    """Widgets for teleoperation; visible while an episode runs."""

    def __init__(
        self, server: viser.ViserServer, session: Session, complain: Complain
    ) -> None:
        """Make the widgets.

        Args:
            server: The page's server.
            session: The session that receives their commands.
            complain: Called with the reason why an action is impossible.
        """
        self._server, self._session, self._complain = server, session, complain
        self._target: Any = None
        self._led: tuple[object, ...] = ()
        self._offered: Teleoperator | None = None
        gui: Any = server.gui
        with gui.add_folder("By hand", visible=False) as self.folder:
            hint = "Lead the robots yourself from here on."
            self.take = gui.add_button("Take over", hint=hint)
            hint = "Let the policy go on from here."
            self.back = gui.add_button("Hand back", hint=hint)
            self.robot = gui.add_dropdown("Robot", ("robot",))
            self.grips = gui.add_button_group("Gripper", GRIPS)
            self.save = gui.add_button("Save what was done")
        self.take.on_click(lambda _: self.take_over())
        self.back.on_click(lambda _: session.play.hand_back())
        self.grips.on_click(lambda event: self.grip(event.target.value))
        self.save.on_click(lambda event: self.download(event.client))

    @property
    def _number(self) -> int:
        names = self.robot.options
        return names.index(self.robot.value) if self.robot.value in names else 0

    def take_over(self) -> None:
        """Let the visitor lead the robots, first the one that was acting."""
        with complaining(self._complain):
            self._session.play.take_over()

    def grip(self, what: str) -> None:
        """Open or close the gripper of the chosen robot."""
        teleoperator = self._session.play.teleoperator
        if teleoperator is not None:
            teleoperator.grip(self._number, opened=what == OPEN)

    def download(self, client: Any) -> None:
        """Send a visitor the log as a file."""
        with complaining(self._complain):
            done = self._session.play.kept()
            table, content = done.instance, done.to_json().encode()
            name = f"{table.task}-{table.split}-{table.index}-by-hand.json"
            client.send_file_download(name, content, save_immediately=True)

    def refresh(self, play: Play) -> None:
        """Show the handles at the target of the chosen hand while a visitor leads."""
        leads, goes_on = play.is_led, play.acts and not play.transport.over
        teleoperator = play.teleoperator
        by_orders = isinstance(play, TeamPlay)
        shown = goes_on or teleoperator is not None or play.was_led
        show_if(self.folder, shown and not by_orders)
        show_if(self.take, play.can_be_taken_over)
        show_if(self.back, leads and play.can_hand_back)
        show_if(self.robot, leads)
        show_if(self.grips, leads)
        show_if(self.save, play.was_led)
        if leads and teleoperator is not self._offered and play.instance is not None:
            self._offered = teleoperator
            self._offer(play.instance, play.led_first)
        goal = None
        if leads and teleoperator is not None:
            goal = teleoperator.target(self._number)
        led = (teleoperator, self._number)
        if self._target is not None and (goal is None or self._led != led):
            self._target.remove()
            self._target = None
        if self._target is None and goal is not None:
            self._led = led
            self._target = self._server.scene.add_transform_controls(
                TARGET,
                _SCALE,
                depth_test=False,
                opacity=0.7,
                position=goal[:3],
                wxyz=goal[3:7],
            )
            self._target.on_update(self._lead)

    def _offer(self, instance: Instance, acting: str) -> None:
        """Set the choice of robots; select the one that was acting."""
        names = instance.scene.robot_names
        phrases = robot_phrases(instance.scene.robots)
        self.robot.options = phrases
        self.robot.value = phrases[names.index(acting) if acting in names else 0]

    def forget(self) -> None:
        """Drop the handles after all nodes of the page were removed."""
        self._target = None

    async def _lead(self, event: Any) -> None:
        position, wxyz = event.target.position, event.target.wxyz
        teleoperator = self._session.play.teleoperator
        if teleoperator is not None:
            teleoperator.lead(self._number, position, wxyz)
