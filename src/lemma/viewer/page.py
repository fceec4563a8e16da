"""The page: a server, a session, a panel, and the loop that updates them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from lemma.env.camera_rig import camera_names
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import FREE_SPLIT
from lemma.tasks.task import TASKS
from lemma.viewer.by_hand import (
    DraggingPanel,
    OrderPanel,
    TeleoperationPanel,
    complaining,
    show_if,
)
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.reading import Explanation
from lemma.viewer.episode.session import Session, best_for
from lemma.viewer.episode.status import (
    KNOWING,
    LONGEST,
    OWN_WORDS,
    SAYINGS,
    TOGETHER,
    EpisodeRequest,
    Phase,
    Status,
)
from lemma.viewer.episode.teleoperator import BY_HAND
from lemma.viewer.episode.transport import SPEEDS
from lemma.viewer.scene.pictures import MAP, NO_PICTURE, Pictures
from lemma.viewer.scene.stage import OVERLAYS, Stage
from lemma.viewer.server import (
    Rounds,
    address_of,
    close_server,
    prepare_panel,
    set_theme,
)
from lemma.viewer.words import chart_html, part, reached_html, status_html, why_html

PLAY, PAUSE, STEP, RESTART = MOVES = ("Play", "Pause", "Step", "Restart")
"""Buttons of an episode."""
_MOST = 100_000
_SLIDER_S = 0.1
_SPEEDS = {f"{speed:g} ×": speed for speed in SPEEDS}
_ANY = np.zeros((3, 4, 3), np.uint8)
_LOOK_AT_FIRST = {"names"}


class Panel:
    """Widgets of a page, bound to a session.

    The page's loop calls :meth:`refresh`; threads of the server call all other methods
    when users act.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        set_overlay: Callable[[str, bool], None],
    ) -> None:
        """Make the widgets.

        Args:
            server: The page's server.
            session: The session that receives the commands.
            set_overlay: Function that shows or hides an overlay, by name.
        """
        self._session = session
        # In viser's types, values of handles are read-only.
        self._gui: Any = server.gui
        self._status: Status | None = None
        self._timeline = self._reached = ""
        self._charted: tuple[object, ...] = ()
        self._explanation: Explanation | None = None
        self._instance: Instance | None = None
        self._complaint = ""
        self._add_choices(session.play.request)
        self._add_transport()
        self.orders = OrderPanel(server, session)
        self.teleoperation = TeleoperationPanel(server, session, self.complain)
        self._add_subtasks()
        self.table = DraggingPanel(server, session, self.complain)
        self._add_overlays(set_overlay)
        self._add_details(session.play.request)
        self.text.on_update(self.typed)
        for widget in (self.task, self.index, self.split, self.saying):
            widget.on_update(self.chosen)

    def _add_choices(self, request: EpisodeRequest) -> None:
        gui, offered = self._gui, self._session.policies
        self.status = gui.add_html("")
        hint = "Type anything, then press Do it."
        self.text = gui.add_text("Say", request.text, multiline=True, hint=hint)
        do = gui.add_button("Do it", color="blue")
        self.task = gui.add_dropdown("Task", tuple(TASKS), initial_value=request.task)
        self.index = gui.add_number("Instance", request.index, min=0, max=_MOST)
        self.policy = gui.add_dropdown("Policy", offered, initial_value=request.policy)
        do.on_click(lambda _: self.act())

    def _add_details(self, request: EpisodeRequest) -> None:
        gui, splits = self._gui, (*SPLITS, FREE_SPLIT)
        with gui.add_folder("More", expand_by_default=False):
            self.split = gui.add_dropdown("Split", splits, initial_value=request.split)
            self.saying = gui.add_dropdown(
                "Sentence", SAYINGS, initial_value=request.saying
            )
            hint = "Address of a policy: http://HOST:PORT or vla-eval://..."
            self.address = gui.add_text("Server", "", hint=hint)
            ask_there = gui.add_button("Offer its policy")
            dark = gui.add_checkbox("Dark", False)
        ask_there.on_click(lambda _: self.offer())
        dark.on_update(lambda _: set_theme(gui, dark=dark.value))

    def _add_transport(self) -> None:
        gui = self._gui
        with gui.add_folder("Episode"):
            moves = gui.add_button_group("", MOVES)
            speed = gui.add_dropdown("Speed", tuple(_SPEEDS), initial_value="1 ×")
            self.time = gui.add_slider("Time [s]", 0.0, 1.0, _SLIDER_S / 2, 0.0)
            self.chart = gui.add_html("")
        moves.on_click(lambda event: self.move(event.target.value))
        speed.on_update(lambda _: self._session.set_speed(_SPEEDS[speed.value]))
        self.time.on_update(self.sought)

    def _add_subtasks(self) -> None:
        gui = self._gui
        with gui.add_folder("Sub-tasks"):
            self.reached = gui.add_html("")
            self.timeline = gui.add_html(part("timeline", (), 0.0))
            self.why = gui.add_html("")

    def _add_overlays(self, set_overlay: Callable[[str, bool], None]) -> None:
        gui, self.overlays = self._gui, {}

        def bind(widget: Any, name: str) -> None:
            widget.on_update(lambda _: set_overlay(name, bool(widget.value)))

        with gui.add_folder("Show"):
            for name, hint in OVERLAYS.items():
                shown = name in _LOOK_AT_FIRST
                box = gui.add_checkbox(name.capitalize(), shown, hint=hint)
                self.overlays[name] = box
                bind(box, name)
            self.picture = gui.add_dropdown("Picture", (NO_PICTURE,))
            self.image = gui.add_image(_ANY, format="jpeg", visible=False)

    def request(self) -> EpisodeRequest:
        """Return the present choices as a request.

        Raises:
            LemmaError: The choices are not valid.
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
        """Set the chosen table, and act.

        Args:
            steps: Whether to pause after the first sub-task.
        """
        self.set_table(acts=True, steps=steps)

    def set_table(self, *, acts: bool = False, steps: bool = False) -> None:
        """Set the chosen table, and act if wanted.

        Args:
            acts: Whether to act; otherwise only the table is set.
            steps: Whether to pause after the first sub-task.
        """
        with complaining(self.complain):
            self._session.ask(self.request(), acts=acts, steps=steps)

    def move(self, what: str) -> None:
        """Execute one of :data:`MOVES`."""
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
        """Add the policy at the entered address to the choices, and choose it."""
        with complaining(self.complain):
            self._session.offer(self.address.value)
            self.policy.options = self._session.policies
            self.policy.value = self.address.value.strip()

    def complain(self, text: str) -> None:
        """Show the reason why an action is impossible; an empty text clears it."""
        self._complaint, self._status = text, None
        if text:
            self.status.content = part("complaint", text)

    def chosen(self, event: Any) -> None:
        """Set the table when a visitor has chosen another."""
        if event.client_id is not None:
            best = best_for(self.task.value, self._session.policies)
            if best == TOGETHER and self.policy.value not in (*KNOWING, BY_HAND):
                self.policy.value = best
            self.set_table()

    def typed(self, event: Any) -> None:
        """Treat a visitor's input as their own sentence."""
        if event.client_id is not None:
            self.saying.value = OWN_WORDS
            if len(self.text.value) > LONGEST:
                self.text.value = self.text.value[:LONGEST]

    def sought(self, event: Any) -> None:
        """Show the time at which a visitor has put the slider."""
        if event.client_id is not None:
            self._session.play.transport.seek(self.time.value)

    def refresh(self, play: Play) -> None:
        """Show the status of an episode; send only changes."""
        status, transport = play.status, play.transport
        self.table.refresh(play)
        self.teleoperation.refresh(play)
        self.orders.refresh(play)
        instance = play.instance
        if instance is not None and instance != self._instance:
            self._show_instance(instance, play.request)
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
        timeline = part("timeline", status.lines, now_s)
        if timeline != self._timeline:
            self._timeline = self.timeline.content = timeline
        charted = (play, status.lines, round(now_s, 1), round(end_s), transport.over)
        if charted != self._charted:
            self._charted = charted
            self.chart.content = chart_html(play, now_s)
        reached = reached_html(play.reached(), over=transport.over)
        if reached != self._reached:
            self._reached = self.reached.content = reached
        explanation = play.explanation()
        if explanation is not self._explanation and instance is not None:
            self._explanation = explanation
            self.why.content = why_html(explanation, instance)

    def _show_instance(self, instance: Instance, request: EpisodeRequest) -> None:
        self._instance = instance
        if self.task.value != request.task and request.task in self.task.options:
            self.task.value = request.task
        options = (NO_PICTURE, MAP, *camera_names(instance.scene.robot_names))
        if self.picture.options != options:
            self.picture.options = options

    def show_picture(self, picture: Any | None) -> None:
        """Show a picture, (H, W, 3) uint8; None hides it."""
        if picture is not None:
            self.image.image = picture
        show_if(self.image, picture is not None)


class Page:
    """A page with one session; all browser tabs show the same."""

    def __init__(self, session: Session, server: viser.ViserServer) -> None:
        """Show a session.

        Args:
            session: The session; the page closes it.
            server: The page's server; the page closes it.
        """
        self._server = server
        self.session = session
        prepare_panel(server)
        self.port = server.get_port()
        self.address = address_of(server.get_host(), self.port)
        self.stage = Stage(server, _LOOK_AT_FIRST)
        self.panel = Panel(server, session, self.stage.set_visible)
        self.pictures = Pictures(self.panel.show_picture)
        self._shown: Play | None = None
        self._rounds = Rounds()
        self.updates = 0
        """Number of iterations of the loop."""

    def tick(self, real_s: float) -> None:
        """Advance by a real time [s], and show the state."""
        play = self.session.play
        play.transport.advance(real_s)
        scene, instance, qpos = play.scene, play.instance, play.transport.qpos()
        if scene is None or instance is None or qpos is None:
            self.stage.refresh()
        else:
            new = play is not self._shown
            if new and self.stage.set_scene(scene, instance):
                self.panel.teleoperation.forget()
            self.stage.viewpoint.step_back()
            self.stage.show(qpos)
            if new and self.stage.bodies is not None:
                self.panel.table.dragging.watch(self.stage.bodies, scene)
                self._shown = play
            self.panel.table.allow(instance)
            why = play.explanation()
            self.stage.explain(why.insight, play.paths())
            self.pictures.want(self.panel.picture.value, instance, qpos)
        self.panel.refresh(play)
        self.updates += 1

    def run(self) -> None:
        """Run until another thread calls :meth:`close`, or until an interrupt."""
        self._rounds.go(self.tick)

    def close(self) -> None:
        """Stop listening, and release session, pictures and server."""
        # The loop uses the session and the scene, so it ends first.
        self._rounds.end()
        self.session.close()
        self.pictures.close()
        close_server(self._server)
