"""The panel of the page."""

from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from lemma.core.errors import LemmaError
from lemma.env.camera_rig import camera_names
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import FREE_SPLIT
from lemma.tasks.task import TASKS
from lemma.viewer.episode.explanation import Explanation
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.request import LONGEST, OWN_WORDS, SAYINGS, EpisodeRequest
from lemma.viewer.episode.session import Session
from lemma.viewer.episode.status import Phase, Status
from lemma.viewer.episode.transport import SPEEDS
from lemma.viewer.panel.dragging import DraggingPanel
from lemma.viewer.panel.teleoperation import TeleoperationPanel
from lemma.viewer.panel.words import (
    complaint_html,
    status_html,
    timeline_html,
    why_html,
)
from lemma.viewer.scene.pictures import MAP, NO_PICTURE
from lemma.viewer.scene.stage import OVERLAYS
from lemma.viewer.server import set_theme

PLAY, PAUSE, STEP, RESTART = MOVES = ("Play", "Pause", "Step", "Restart")
"""Buttons of an episode."""
_MOST = 100_000
_SLIDER_S = 0.1
_ANY = np.zeros((3, 4, 3), np.uint8)


class Panel:
    """Widgets of a page, bound to a session.

    The page calls :meth:`refresh` again and again; everything else is called by users,
    in threads of the server.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        overlays: set[str],
        set_overlay: Callable[[str, bool], None],
    ) -> None:
        """Make the widgets.

        Args:
            server: The page.
            session: Takes its commands.
            overlays: Shown at first.
            set_overlay: Shows or hides it.
        """
        self._session = session
        # The library types values of its handles as read-only.
        self._gui: Any = server.gui
        self._status: Status | None = None
        self._timeline = ""
        self._explanation: Explanation | None = None
        self._instance: Instance | None = None
        self._complaint = ""
        request = session.play.request
        self._add_choices(request)
        self._add_transport()
        self.teleoperation = TeleoperationPanel(server, session, self.complain)
        self.table = DraggingPanel(server, session, self.complain)
        self._add_overlays(overlays, set_overlay)
        self._add_details(request)

    def _add_choices(self, request: EpisodeRequest) -> None:
        gui = self._gui
        self.status = gui.add_html("")
        self.text = gui.add_text(
            "Say", request.text, multiline=True, hint="Type anything, then press Do it."
        )
        self.do = gui.add_button("Do it", color="blue")
        names = tuple(TASKS)
        self.task = gui.add_dropdown("Task", names, initial_value=request.task)
        self.index = gui.add_number("Instance", request.index, min=0, max=_MOST)
        self.policy = gui.add_dropdown(
            "Policy", self._session.policies, initial_value=request.policy
        )
        self.do.on_click(lambda _: self.act())
        self.text.on_update(self.typed)
        for widget in (self.task, self.index):
            widget.on_update(self.chosen)

    def _add_details(self, request: EpisodeRequest) -> None:
        gui = self._gui
        with gui.add_folder("More", expand_by_default=False):
            self.split = gui.add_dropdown(
                "Split", (*SPLITS, FREE_SPLIT), initial_value=request.split
            )
            self.saying = gui.add_dropdown(
                "Sentence", SAYINGS, initial_value=request.saying
            )
            self.address = gui.add_text(
                "Server", "", hint="Of a policy: http://HOST:PORT or vla-eval://..."
            )
            self.ask_there = gui.add_button("Offer its policy")
            self.dark = gui.add_checkbox("Dark", False)
        self.ask_there.on_click(lambda _: self.offer())
        self.dark.on_update(lambda _: set_theme(gui, dark=self.dark.value))
        for widget in (self.split, self.saying):
            widget.on_update(self.chosen)

    def _add_transport(self) -> None:
        gui = self._gui
        with gui.add_folder("Episode"):
            self.moves = gui.add_button_group("", MOVES)
            self.moves.on_click(lambda event: self.move(event.target.value))
            speeds = tuple(f"{speed:g} ×" for speed in SPEEDS)
            self.speed = gui.add_dropdown("Speed", speeds, initial_value="1 ×")
            self.time = gui.add_slider("Time [s]", 0.0, 1.0, _SLIDER_S / 2, 0.0)
            self.timeline = gui.add_html(timeline_html((), 0.0))
            self.why = gui.add_html("")
        self.speed.on_update(lambda _: self._set_speed())
        self.time.on_update(self.sought)

    def _add_overlays(
        self, overlays: set[str], set_overlay: Callable[[str, bool], None]
    ) -> None:
        gui = self._gui

        def bind(widget: Any, name: str) -> None:
            widget.on_update(lambda _: set_overlay(name, bool(widget.value)))

        self.overlays = {}
        with gui.add_folder("Show"):
            for name, hint in OVERLAYS.items():
                found = gui.add_checkbox(name.capitalize(), name in overlays, hint=hint)
                self.overlays[name] = found
                bind(found, name)
            self.picture = gui.add_dropdown("Picture", (NO_PICTURE,))
            self.image = gui.add_image(_ANY, format="jpeg", visible=False)

    def request(self) -> EpisodeRequest:
        """Return the present choices as a request.

        Raises:
            LemmaError: It is impossible.
        """
        chosen = self.task.value, self.split.value, self.index.value
        set_now = self._session.play.request
        same = (set_now.task, set_now.split, set_now.index) == chosen
        return EpisodeRequest(
            *chosen,
            self.saying.value,
            self.text.value.strip() if self.saying.value == OWN_WORDS else "",
            self.policy.value,
            set_now.own if same else None,
        )

    def act(self, *, steps: bool = False) -> None:
        """Set the table that is chosen, and act on it.

        Args:
            steps: Whether to stop after the first sub-task.
        """
        self._ask(acts=True, steps=steps)

    def move(self, what: str) -> None:
        """Play, pause, step or restart, as if it were pressed."""
        play = self._session.play
        if what == PAUSE:
            play.transport.pause()
        elif what == RESTART:
            self._complaint = ""
            self._session.restart()
        elif not play.acts:
            self.act(steps=what == STEP)
        elif what == PLAY:
            play.transport.play()
        elif what == STEP:
            play.transport.step()

    def offer(self) -> None:
        """Offer the policy behind the address that is written, and choose it."""
        try:
            self._session.offer(self.address.value)
        except LemmaError as error:
            self.complain(str(error))
            return
        self.policy.options = self._session.policies
        self.policy.value = self.address.value.strip()
        self.complain("")

    def set_table(self) -> None:
        """Set the table that is chosen, and wait."""
        self._ask(acts=False)

    def _ask(self, *, acts: bool, steps: bool = False) -> None:
        try:
            self._session.ask(self.request(), acts=acts, steps=steps)
            self._complaint = ""
        except LemmaError as error:
            self.complain(str(error))

    def complain(self, text: str) -> None:
        """Show why something cannot be done; an empty text clears it."""
        self._complaint, self._status = text, None
        if text:
            self.status.content = complaint_html(text)

    def chosen(self, event: Any) -> None:
        """Set the table when a visitor has chosen another."""
        if event.client_id is not None:
            self.set_table()

    def typed(self, event: Any) -> None:
        """Treat what a visitor types as an own sentence."""
        if event.client_id is not None:
            self.saying.value = OWN_WORDS
            if len(self.text.value) > LONGEST:
                self.text.value = self.text.value[:LONGEST]

    def sought(self, event: Any) -> None:
        """Look at the moment that a visitor has moved the slider to."""
        if event.client_id is not None:
            self._session.play.transport.seek(self.time.value)

    def _set_speed(self) -> None:
        speeds = {f"{speed:g} ×": speed for speed in SPEEDS}
        if self.speed.value in speeds:
            self._session.set_speed(speeds[self.speed.value])

    def refresh(self, play: Play) -> None:
        """Show the status of an episode; unchanged parts are not sent again."""
        status, transport = play.status, play.transport
        self.table.refresh(play)
        self.teleoperation.refresh(play)
        if play.instance is not None and play.instance != self._instance:
            self._show_instance(play)
        if status is not self._status and not self._complaint:
            self._status = status
            self.status.content = status_html(status)
            own = play.request.saying == OWN_WORDS
            if status.phase is Phase.READY and not own:
                self.text.value = status.said
        end_s, now_s = transport.end_s, transport.cursor_s
        if end_s > self.time.max or end_s < self.time.max - 1.0:
            self.time.max = max(1.0, end_s)
        if abs(now_s - self.time.value) >= _SLIDER_S or transport.at_end:
            self.time.value = round(now_s, 2)
        timeline = timeline_html(status.lines, now_s)
        if timeline != self._timeline:
            self._timeline = self.timeline.content = timeline
        self._show_why(play)

    def _show_instance(self, play: Play) -> None:
        assert play.instance is not None
        self._instance = play.instance
        if (
            self.task.value != play.request.task
            and play.request.task in self.task.options
        ):
            self.task.value = play.request.task
        names = camera_names(play.instance.scene.robot_names)
        options = (NO_PICTURE, MAP, *names)
        if self.picture.options != options:
            self.picture.options = options

    def _show_why(self, play: Play) -> None:
        explanation = play.explanation()
        if explanation is not self._explanation and play.instance is not None:
            self._explanation = explanation
            self.why.content = why_html(explanation, play.instance)

    def show_picture(self, picture: Any | None) -> None:
        """Show a picture, (H, W, 3) uint8; None for none."""
        if picture is not None:
            self.image.image = picture
        if self.image.visible != (picture is not None):
            self.image.visible = picture is not None
