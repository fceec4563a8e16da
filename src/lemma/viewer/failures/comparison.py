"""An episode beside another, both played again in a thread of its own."""

import threading
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

from lemma.core.errors import LemmaError
from lemma.evaluation.report.episodes import Case
from lemma.viewer.recording.replays import Replayed, expert_instead, replay_line
from lemma.viz.recording import Recording

_KEPT = 16
NOT_SAID = (
    "Its line does not say all that was done: motor commands are too many for a line, "
    "and other versions have other instances."
)


@dataclass(frozen=True)
class Comparison:
    """One episode beside another."""

    case: Case
    sides: tuple[Recording, ...]
    """From left to right; none where nothing can be shown."""
    opens_s: float = 0.0
    """The moment at which it went wrong [s]."""
    note: str = ""
    """A remark, such as why nothing can be shown."""


class Replayer:
    """Plays episodes again, the last one that was asked for; thread-safe."""

    def __init__(self) -> None:
        """Start the thread."""
        self._changed = threading.Condition()
        self._asked: tuple[Case, Case | None] | None = None
        self._comparison: Comparison | None = None
        self._busy = self._closed = False
        self._done: OrderedDict[tuple[str, Path, str], Replayed] = OrderedDict()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def comparison(self) -> Comparison | None:
        """The newest comparison; a new object whenever it changes."""
        return self._comparison

    @property
    def busy(self) -> bool:
        """Whether another one is being made."""
        return self._busy

    def ask(self, case: Case, other: Case | None = None) -> None:
        """Compare an episode.

        Args:
            case: The episode.
            other: Another policy's; the expert goes on from the mistake if None.
        """
        with self._changed:
            self._asked, self._busy = (case, other), True
            self._changed.notify_all()

    def close(self) -> None:
        """End the thread after its present work."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._asked is None and not self._closed:
                    self._changed.wait()
                if self._closed or self._asked is None:
                    return
                (case, other), self._asked = self._asked, None
            try:
                comparison = self._look(case, other)
            except Exception as error:
                # The page reports any error, and stays alive.
                what = str(error) if isinstance(error, LemmaError) else repr(error)
                comparison = Comparison(case, (), note=what)
            with self._changed:
                self._comparison, self._busy = comparison, self._asked is not None

    def _look(self, case: Case, other: Case | None) -> Comparison:
        if not case.is_repeatable or (other and not other.is_repeatable):
            return Comparison(case, (), note=NOT_SAID)
        again = self._again(case)
        notes = [again.differs]
        if other is None:
            beside = expert_instead(case, again)
        else:
            found = self._again(other)
            notes.append(found.differs)
            beside = found.recording
        note = " ".join(f"It went differently here. {text}" for text in notes if text)
        return Comparison(case, (again.recording, beside), again.turn_s, note)

    def _again(self, case: Case) -> Replayed:
        key = case.policy, case.lines, case.name
        if key not in self._done:
            self._done[key] = replay_line(case)
            if len(self._done) > _KEPT:
                self._done.popitem(last=False)
        return self._done[key]


class Cursor:
    """The moment that is shown."""

    def __init__(self) -> None:
        """Stand still at 0 s."""
        self.at_s = self.end_s = 0.0
        self.speed = 1.0
        self.playing = False

    def open(self, at_s: float, end_s: float) -> None:
        """Stand at a moment of another comparison [s]."""
        self.at_s, self.end_s, self.playing = at_s, end_s, False

    def play(self) -> None:
        """Move on, from the beginning if it stands at the end."""
        if self.at_s >= self.end_s:
            self.at_s = 0.0
        self.playing = True

    def seek(self, at_s: float) -> None:
        """Stand at another moment [s]."""
        self.at_s, self.playing = min(max(at_s, 0.0), self.end_s), False

    def advance(self, real_s: float) -> None:
        """Move by some real time [s], unless it stands still."""
        if self.playing:
            self.at_s = min(self.at_s + real_s * self.speed, self.end_s)
            self.playing = self.at_s < self.end_s
