"""The panel beside two tables: which failure is shown, and its sub-tasks."""

from collections.abc import Sequence
from html import escape
from typing import Any

import viser

from lemma.evaluation.report.episodes import Case
from lemma.viewer.episode.transport import SPEEDS
from lemma.viewer.failures.catalog import Catalog, Filter, title, words
from lemma.viewer.failures.comparison import Comparison, Cursor, Replayer
from lemma.viewer.panel.words import BAD, FRAME, GOOD, timeline_html
from lemma.viewer.recording.replays import EXPERT
from lemma.viz.recording import Recording

PLAY, PAUSE, MISTAKE, START = MOVES = ("Play", "Pause", "Mistake", "Start")
BACK, ON = TURNS = ("Previous", "Next")
_SLIDER_S = 0.1


class FailurePanel:
    """Widgets of a page of failures."""

    def __init__(
        self,
        server: viser.ViserServer,
        catalog: Catalog,
        replayer: Replayer,
        cursor: Cursor,
        wanted: Filter,
    ) -> None:
        """Make the widgets, and look at the first failure.

        Args:
            server: The page.
            catalog: The failures.
            replayer: Plays episodes again.
            cursor: The moment that is shown.
            wanted: Filter to begin with.
        """
        self._catalog, self._replayer, self._cursor = catalog, replayer, cursor
        # The library types values of its handles as read-only.
        gui: Any = server.gui
        self._found: list[Case] = []
        self._shown: Comparison | None = None
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
        """List the failures that pass the filter, and show the first."""
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
        cursor, comparison = self._cursor, self._shown
        if what == PLAY:
            cursor.play()
        elif what == PAUSE:
            cursor.playing = False
        elif what == START:
            cursor.seek(0.0)
        elif comparison is not None:
            cursor.seek(comparison.opens_s)

    def _choose(self) -> None:
        if self.case is not None:
            self.beside.options = (EXPERT, *self._catalog.others(self.case))
            self.beside.value = EXPERT
        self.look()

    def look(self) -> None:
        """Show what is chosen."""
        if self.case is not None:
            others = self._catalog.others(self.case)
            self._replayer.ask(self.case, others.get(self.beside.value))

    def _by_visitor(self, event: Any, then: Any) -> None:
        if event.client_id is not None:
            then()

    def _seek(self) -> None:
        self._cursor.seek(self.time.value)

    def _set_speed(self) -> None:
        self._cursor.speed = float(self.speed.value.removesuffix(" ×"))

    def refresh(self, comparison: Comparison | None) -> None:
        """Say what is shown; what has not changed is not sent again."""
        cursor = self._cursor
        if comparison is not self._shown:
            self._shown = comparison
            self.time.max = max(1.0, cursor.end_s)
        busy = self._replayer.busy
        self._write(self.status, _status(self.case, comparison, len(self._found), busy))
        still = not cursor.playing
        if abs(cursor.at_s - self.time.value) >= _SLIDER_S * (0.6 if still else 1.0):
            self.time.value = round(cursor.at_s, 2)
        sides: Sequence[Recording] = comparison.sides if comparison else ()
        for number, widget in enumerate(self.timelines):
            found = sides[number : number + 1]
            self._write(widget, "".join(_timeline(t, cursor.at_s) for t in found))

    def _write(self, widget: Any, content: str) -> None:
        if self._content.get(id(widget)) != content:
            self._content[id(widget)] = widget.content = content


def _status(case: Case | None, shown: Comparison | None, count: int, busy: bool) -> str:
    """Return which episode is shown, and why it failed."""
    if case is None or case.cause is None:
        return FRAME.format("Nothing failed that way.")
    row = case.row
    parts = [
        f'<div style="opacity:0.7">{count} failures</div>',
        f'<div style="font-weight:600" data-cause="{escape(case.cause)}">'
        f"{escape(title(case))}: {escape(words(case.cause))}</div>",
        f"<div><i>“{escape(row['instruction'])}”</i></div>",
    ]
    if busy:
        parts.append("<div>Playing it again …</div>")
    elif shown is not None:
        parts.append(f'<div data-done="{len(shown.sides)}">{escape(shown.note)}</div>')
    return FRAME.format("".join(parts))


def _timeline(side: Recording, at_s: float) -> str:
    color = GOOD if side.success else BAD
    head = f'<div style="font-weight:600">{escape(side.title)}</div>'
    end = f'<div style="color:{color}">{escape(side.verdict)}</div>'
    return FRAME.format(head) + timeline_html(side.lines, at_s) + FRAME.format(end)
