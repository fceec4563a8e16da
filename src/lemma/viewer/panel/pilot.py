"""The part of the panel by which a visitor leads a robot."""

from collections.abc import Callable
from typing import Any

import viser

from lemma.tasks.language.bank import robot_phrases
from lemma.viewer.episode.by_hand import BY_HAND
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.session import Session

OPEN, CLOSE = GRIPS = ("Open", "Close")
TARGET = "/pilot"
"""Name of the node with the handles of the hand."""
_SCALE = 0.3


class Pilot:
    """Widgets for hands that are led; to be seen while somebody leads one."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        complain: Callable[[str], None],
    ) -> None:
        """Make the widgets.

        Args:
            server: The page.
            session: What they command.
            complain: Told why something cannot be done.
        """
        self._server, self._session, self._complain = server, session, complain
        self._target: Any = None
        self._led: tuple[object, ...] = ()
        gui: Any = server.gui
        with gui.add_folder("By hand", visible=False) as self.folder:
            self.robot = gui.add_dropdown("Robot", ("robot",))
            self.grips = gui.add_button_group("Gripper", GRIPS)
            self.save = gui.add_button("Save what was done")
        self.grips.on_click(lambda event: self.grip(event.target.value))
        self.save.on_click(lambda event: self.download(event.client))

    @property
    def _number(self) -> int:
        names = self.robot.options
        return names.index(self.robot.value) if self.robot.value in names else 0

    def grip(self, what: str) -> None:
        """Open or close the gripper of the robot that is led."""
        self._session.hand.grip(self._number, opened=what == OPEN)

    def download(self, client: Any) -> None:
        """Give a visitor what was done as a file."""
        table = self._session.play.instance
        recording = None if table is None else self._session.hand.recording(table)
        if table is None or recording is None or not recording.rows:
            self._complain("Nothing was done by hand yet.")
            return
        name = f"{table.task}-{table.split}-{table.index}-by-hand.json"
        content = recording.to_json().encode()
        client.send_file_download(name, content, save_immediately=True)

    def refresh(self, play: Play) -> None:
        """Show the handles where the hand shall be, if somebody leads one."""
        leads = play.wish.policy == BY_HAND and play.acts
        if self.folder.visible != leads:
            self.folder.visible = leads
        hand = self._session.hand
        goal = hand.target(self._number) if leads else None
        if goal is None or play.instance is None or play.transport.over:
            self._remove()
            return
        phrases = robot_phrases(play.instance.scene.robots)
        if self.robot.options != phrases:
            self.robot.options = phrases
        led = (hand, self._number)
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

    def _remove(self) -> None:
        if self._target is not None:
            self._target.remove()
            self._target = None

    def forget(self) -> None:
        """Know that the nodes of the page are gone."""
        self._target = None

    async def _moved(self, event: Any) -> None:
        position, wxyz = event.target.position, event.target.wxyz
        self._session.hand.lead(self._number, position, wxyz)
