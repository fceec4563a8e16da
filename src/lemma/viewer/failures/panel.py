"""What is chosen and read beside two tables."""

from collections.abc import Sequence
from html import escape
from typing import Any

import viser

from lemma.evaluation.report.episodes import Case
from lemma.viewer.episode.transport import SPEEDS
from lemma.viewer.failures.catalog import Catalog, Filter, title, words
from lemma.viewer.failures.viewing import Cursor, Sight, Viewing
from lemma.viewer.panel.words import timeline_html
from lemma.viewer.recording.track import EXPERT, Track

PLAY, PAUSE, MISTAKE, START = MOVES = ("Play", "Pause", "Mistake", "Start")
"""What can be pressed while an episode is looked at."""
BACK, ON = TURNS = ("Previous", "Next")
"""To other failures."""
_FRAME = '<div style="padding:0 1em 0.5em;font-size:0.9em;line-height:1.45">{}</div>'
_SLIDER_S = 0.1


class FailurePanel:
    """Widgets of a page of failures."""

    def __init__(
        self,
        server: viser.ViserServer,
        catalog: Catalog,
        viewing: Viewing,
        cursor: Cursor,
        wanted: Filter,
    ) -> None:
        """Make the widgets, and look at the first failure.

        Args:
            server: The page.
            catalog: What there is to look at.
            viewing: Does it again.
            cursor: The moment that is looked at.
            wanted: What is looked for at first.
        """
        self._catalog, self._viewing, self._cursor = catalog, viewing, cursor
        # Its handles have types by which nothing could be written to them.
        gui: Any = server.gui
        self._found: list[Case] = []
        self._shown: Sight | None = None
        self._content: dict[int, str] = {}
        self.status = gui.add_html("")
        self.turns = gui.add_button_group("", TURNS)
        self.episode = gui.add_dropdown("Episode", ("",))
        self.beside = gui.add_dropdown("Beside it", (EXPERT,))
        with gui.add_folder("Which"):
            self.policy = gui.add_dropdown("Policy", catalog.policies)
            self.task = gui.add_dropdown("Task", catalog.tasks)
            self.cause = gui.add_dropdown("Cause", catalog.causes)
        with gui.add_folder("Episode"):
            self.moves = gui.add_button_group("", MOVES)
            speeds = tuple(f"{speed:g} ×" for speed in SPEEDS)
            self.speed = gui.add_dropdown("Speed", speeds, initial_value="1 ×")
            self.time = gui.add_slider("Time [s]", 0.0, 1.0, _SLIDER_S / 2, 0.0)
            self.timelines = [gui.add_html(""), gui.add_html("")]
        for widget, value in (
            (self.policy, wanted.policy),
            (self.task, wanted.task),
            (self.cause, wanted.cause),
        ):
            widget.value = value
            widget.on_update(lambda _: self.list())
        self.episode.on_update(lambda event: self._by_visitor(event, self._choose))
        self.beside.on_update(lambda event: self._by_visitor(event, self.look))
        self.time.on_update(lambda event: self._by_visitor(event, self._seek))
        self.speed.on_update(lambda _: self._set_speed())
        self.turns.on_click(lambda event: self.turn(event.target.value))
        self.moves.on_click(lambda event: self.move(event.target.value))
        self.list()

    @property
    def case(self) -> Case | None:
        """The episode that is chosen; None where the list is empty."""
        number = self._number()
        return self._found[number] if self._found else None

    def _number(self) -> int:
        options = self.episode.options
        return options.index(self.episode.value) if self._found else 0

    def list(self) -> None:
        """List what is looked for, and look at the first of it."""
        wanted = Filter(self.policy.value, self.task.value, self.cause.value)
        self._found = self._catalog.find(wanted)
        names = [f"{i}. {title(case)}" for i, case in enumerate(self._found, 1)]
        self.episode.options = tuple(names) or ("none",)
        self.episode.value = self.episode.options[0]
        self._choose()

    def turn(self, where: str) -> None:
        """Go to the failure before or after."""
        if self._found:
            step = 1 if where == ON else -1
            options = self.episode.options
            self.episode.value = options[(self._number() + step) % len(options)]
            self._choose()

    def move(self, what: str) -> None:
        """Play, pause, or go to the mistake or the start."""
        cursor, sight = self._cursor, self._shown
        if what == PLAY:
            cursor.play()
        elif what == PAUSE:
            cursor.playing = False
        elif what == START:
            cursor.seek(0.0)
        elif sight is not None:
            cursor.seek(sight.opens_s)

    def _choose(self) -> None:
        if self.case is not None:
            self.beside.options = (EXPERT, *self._catalog.others(self.case))
            self.beside.value = EXPERT
        self.look()

    def look(self) -> None:
        """Look at what is chosen."""
        if self.case is not None:
            others = self._catalog.others(self.case)
            self._viewing.ask(self.case, others.get(self.beside.value))

    def _by_visitor(self, event: Any, then: Any) -> None:
        if event.client_id is not None:
            then()

    def _seek(self) -> None:
        self._cursor.seek(self.time.value)

    def _set_speed(self) -> None:
        self._cursor.speed = float(self.speed.value.removesuffix(" ×"))

    def refresh(self, sight: Sight | None) -> None:
        """Say what is seen; what has not changed is not sent again."""
        cursor = self._cursor
        if sight is not self._shown:
            self._shown = sight
            self.time.max = max(1.0, cursor.end_s)
        busy = self._viewing.busy
        self._write(self.status, _status(self.case, sight, len(self._found), busy))
        still = not cursor.playing
        if abs(cursor.at_s - self.time.value) >= _SLIDER_S * (0.6 if still else 1.0):
            self.time.value = round(cursor.at_s, 2)
        tracks: Sequence[Track] = sight.tracks if sight else ()
        for number, widget in enumerate(self.timelines):
            found = tracks[number : number + 1]
            self._write(widget, "".join(_timeline(t, cursor.at_s) for t in found))

    def _write(self, widget: Any, content: str) -> None:
        if self._content.get(id(widget)) != content:
            self._content[id(widget)] = widget.content = content


def _status(case: Case | None, sight: Sight | None, count: int, busy: bool) -> str:
    """Return what is looked at, and why it failed."""
    if case is None or case.cause is None:
        return _FRAME.format("Nothing failed that way.")
    row = case.row
    parts = [
        f'<div style="opacity:0.7">{count} failures</div>',
        f'<div style="font-weight:600" data-cause="{escape(case.cause)}">'
        f"{escape(title(case))}: {escape(words(case.cause))}</div>",
        f"<div><i>“{escape(row['instruction'])}”</i></div>",
    ]
    if busy:
        parts.append("<div>Doing it again …</div>")
    elif sight is not None:
        parts.append(f'<div data-done="{len(sight.tracks)}">{escape(sight.note)}</div>')
    return _FRAME.format("".join(parts))


def _timeline(track: Track, at_s: float) -> str:
    color = "#1f9d55" if track.solved else "#d64545"
    head = f'<div style="font-weight:600">{escape(track.title)}</div>'
    end = f'<div style="color:{color}">{escape(track.verdict)}</div>'
    return _FRAME.format(head) + timeline_html(track.lines, at_s) + _FRAME.format(end)
