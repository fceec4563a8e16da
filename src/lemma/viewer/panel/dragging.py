"""The part of the panel for dragging, and for own tables."""

from collections.abc import Callable
from typing import Any

import viser

from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.core.poses import Pose2
from lemma.tasks.instance import Instance
from lemma.tasks.rules import problems
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.session import Session
from lemma.viewer.panel.words import table_html
from lemma.viewer.scene.dragging import Dragging

LARGEST_FILE = 1_000_000
"""Bytes of a file that are read."""


class DraggingPanel:
    """Widgets for changes of a table by hand."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        complain: Callable[[str], None],
    ) -> None:
        """Make the widgets, and the dragging that they command.

        Args:
            server: The page.
            session: Takes their commands.
            complain: Called with the reason why something cannot be done.
        """
        self._session, self._complain = session, complain
        self.dragging = Dragging(server, self.drop)
        gui: Any = server.gui
        with gui.add_folder("Table"):
            self.told = gui.add_html("")
            self.things = gui.add_checkbox(
                "Drag things",
                True,
                hint="Cubes, pads and the stick. Click to turn one.",
            )
            self.robots = gui.add_checkbox(
                "Drag robots", False, hint="Before an episode."
            )
            self.save = gui.add_button("Save table as JSON")
            self.open = gui.add_upload_button("Open table", mime_type=".json")
            self.reset = gui.add_button("Back to the list", visible=False)
        self.save.on_click(lambda event: self.download(event.client))
        self.open.on_upload(lambda event: self.read(event.target.value.content))
        self.reset.on_click(lambda _: self.forget())
        self._moved: Any = None
        self._instance: Instance | None = None

    def drop(self, name: str, pose: Pose2) -> None:
        """Put a robot or an object where it was carried, if it can be there."""
        try:
            self._session.move(name, pose)
            self._complain("")
        except LemmaError as error:
            self.dragging.let_go()
            self._complain(str(error))

    def table(self) -> Instance:
        """Return the table that is set.

        Raises:
            LemmaError: There is no such instance.
        """
        return self._session.play.request.instance()

    def download(self, client: Any) -> None:
        """Give a visitor the table as a file, as ``--instance`` takes it."""
        try:
            table = self.table()
        except LemmaError as error:
            self._complain(str(error))
            return
        name = f"{table.task}-{table.split}-{table.index}.json"
        client.send_file_download(name, table.to_json().encode(), save_immediately=True)

    def read(self, content: bytes) -> None:
        """Set the table that is in a file."""
        try:
            if len(content) > LARGEST_FILE:
                raise InvalidConfigError(f"The file has {len(content):,} bytes.")
            self._session.take(Instance.read(content, "The file"))
            self._complain("")
        except LemmaError as error:
            self._complain(str(error))

    def forget(self) -> None:
        """Set the table of the task's list again."""
        self._session.take_listed()

    def refresh(self, play: Play) -> None:
        """Report problems of a table, and undo impossible moves."""
        request = play.request
        if play.instance is not None and play.instance is not self._instance:
            self._instance = play.instance
            own = request.own is not None
            bad = problems(request.instance()) if own else ()
            self.told.content = table_html(own, bad)
            if self.reset.visible != own:
                self.reset.visible = own
        if play.moved is not None and play.moved is not self._moved:
            self._moved = play.moved
            self.dragging.let_go()
            self._complain(play.moved.problem)

    def allow(self, instance: Instance) -> None:
        """Let visitors drag the things whose box is ticked."""
        names = set(instance.scene.object_names) if self.things.value else set()
        if self.robots.value:
            names |= set(instance.scene.robot_names)
        self.dragging.allow(names)
