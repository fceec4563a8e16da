"""The part of the panel for leading a robot by hand."""

from collections.abc import Callable
from typing import Any

import viser

from lemma.core.errors import LemmaError
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.session import Session
from lemma.viewer.episode.teleoperator import Teleoperator

OPEN, CLOSE = GRIPS = ("Open", "Close")
TARGET = "/teleoperation"
"""Name of the node with the handles of the hand."""
_SCALE = 0.3


class TeleoperationPanel:
    """Widgets for leading hands; visible while an episode goes on."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        complain: Callable[[str], None],
    ) -> None:
        """Make the widgets.

        Args:
            server: The page.
            session: Takes their commands.
            complain: Called with the reason why something cannot be done.
        """
        self._server, self._session, self._complain = server, session, complain
        self._target: Any = None
        self._led: tuple[object, ...] = ()
        self._offered: Teleoperator | None = None
        gui: Any = server.gui
        with gui.add_folder("By hand", visible=False) as self.folder:
            self.take = gui.add_button(
                "Take over", hint="Lead the robots yourself from here on."
            )
            self.back = gui.add_button(
                "Hand back", hint="Let the policy go on from here."
            )
            self.robot = gui.add_dropdown("Robot", ("robot",))
            self.grips = gui.add_button_group("Gripper", GRIPS)
            self.save = gui.add_button("Save what was done")
        self.take.on_click(lambda _: self.take_over())
        self.back.on_click(lambda _: self._session.play.hand_back())
        self.grips.on_click(lambda event: self.grip(event.target.value))
        self.save.on_click(lambda event: self.download(event.client))

    @property
    def _number(self) -> int:
        names = self.robot.options
        return names.index(self.robot.value) if self.robot.value in names else 0

    def take_over(self) -> None:
        """Lead the robots from now on, first the one that was acting."""
        try:
            self._session.play.take_over()
            self._complain("")
        except LemmaError as error:
            self._complain(str(error))

    def grip(self, what: str) -> None:
        """Open or close the gripper of the robot that is led."""
        teleoperator = self._session.play.teleoperator
        if teleoperator is not None:
            teleoperator.grip(self._number, opened=what == OPEN)

    def download(self, client: Any) -> None:
        """Send a visitor the log as a file."""
        try:
            done = self._session.play.kept()
        except LemmaError as error:
            self._complain(str(error))
            return
        table = done.instance
        name = f"{table.task}-{table.split}-{table.index}-by-hand.json"
        content = done.to_json().encode()
        client.send_file_download(name, content, save_immediately=True)

    def refresh(self, play: Play) -> None:
        """Show the handles at the target of the hand that is led, if any."""
        leads, goes_on = play.is_led, play.acts and not play.transport.over
        for widget, needed in (
            (self.folder, goes_on or play.teleoperator is not None or play.was_led),
            (self.take, play.can_be_taken_over),
            (self.back, leads and play.can_hand_back),
            (self.robot, leads),
            (self.grips, leads),
            (self.save, play.was_led),
        ):
            if widget.visible != needed:
                widget.visible = needed
        teleoperator = play.teleoperator
        if leads and teleoperator is not self._offered and play.instance is not None:
            self._offered = teleoperator
            self._offer(play.instance, play.led_first)
        goal = (
            teleoperator.target(self._number)
            if leads and teleoperator is not None
            else None
        )
        if teleoperator is None or goal is None:
            self._remove()
            return
        led = (teleoperator, self._number)
        if self._target is None or self._led != led:
            self._led = led
            self._remove()
            self._target = self._server.scene.add_transform_controls(
                TARGET,
                _SCALE,
                depth_test=False,
                opacity=0.7,
                position=goal[:3],
                wxyz=goal[3:7],
            )
            self._target.on_update(self._moved)

    def _offer(self, instance: Instance, acting: str) -> None:
        """Offer the robots of a table, first the one that was acting."""
        names, phrases = (
            instance.scene.robot_names,
            robot_phrases(instance.scene.robots),
        )
        self.robot.options = phrases
        self.robot.value = phrases[names.index(acting) if acting in names else 0]

    def _remove(self) -> None:
        if self._target is not None:
            self._target.remove()
            self._target = None

    def forget(self) -> None:
        """Know that the nodes of the page are gone."""
        self._target = None

    async def _moved(self, event: Any) -> None:
        position, wxyz = event.target.position, event.target.wxyz
        teleoperator = self._session.play.teleoperator
        if teleoperator is not None:
            teleoperator.lead(self._number, position, wxyz)
