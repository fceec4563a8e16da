"""Play, pause and seek: the cursor of the viewer and the lead of the simulation.

The simulation runs in its own thread and records a state every ``FRAME_S``. A cursor
moves over these states at a multiple of real time, the speed. The simulation waits
while it is :attr:`Transport.lead_s` ahead of the cursor. A pause stops both. Seeking
back shows earlier states and does not change later ones.
"""

import threading
from collections.abc import Callable

import numpy as np

from lemma.core.poses import FloatArray
from lemma.viz.recording import FRAME_S

SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Speeds of playback, as multiples of real time."""
_LEAD_S = 0.1


class AbandonedError(Exception):
    """The page has left this episode."""


class InterruptedEpisodeError(Exception):
    """A visitor takes over, which interrupts the sub-task."""


class Transport:
    """A cursor over the states of an episode; safe to use from any thread.

    Other threads may only read its attributes.
    """

    def __init__(self, speed: float = 1.0) -> None:
        """Begin paused, without any state."""
        self.speed = speed
        """Speed of playback, as a multiple of real time."""
        self.cursor_s = 0.0
        """Simulated time of the cursor [s]."""
        self.playing = False
        """Whether the cursor moves or waits for the simulation."""
        self.over = False
        """Whether the last state is final."""
        self.latest: tuple[float, FloatArray] | None = None
        """The newest state: simulated time [s] and joint positions, (nq,)."""
        self.changing = threading.Lock()
        """Held while a state is changed by hand."""
        self._changed = threading.Condition()
        self._frames: list[FloatArray] = []
        self._marks: list[float] = []
        self._changes: list[Callable[[], None]] = []
        self._questions: list[Callable[[], None]] = []
        self._until: float | None = None
        self._abandoned = self._interrupted = False

    @property
    def end_s(self) -> float:
        """Simulated time of the last state [s]."""
        return max(0, len(self._frames) - 1) * FRAME_S

    @property
    def at_end(self) -> bool:
        """Whether the episode is over and the cursor is at its end."""
        return self.over and self.cursor_s >= self.end_s

    @property
    def lead_s(self) -> float:
        """Largest lead of the simulation over the cursor, in simulated time [s].

        It is two moves of the cursor, so that a fast simulation is always ahead.
        """
        return _LEAD_S * (1.0 + self.speed)

    def qpos(self) -> FloatArray | None:
        """Return the joint positions at the cursor, (nq,); None without a state."""
        with self._changed:
            if not self._frames:
                return None
            # Times are rounded to two digits and may be slightly too small.
            number = int(self.cursor_s / FRAME_S + 1e-6)
            return self._frames[min(number, len(self._frames) - 1)]

    def play(self) -> None:
        """Let the cursor move; from the beginning if it is at the end."""
        with self._changed:
            if self.at_end:
                self.cursor_s = 0.0
            self._until, self.playing = None, True
            self._changed.notify_all()

    def pause(self) -> None:
        """Stop the cursor."""
        with self._changed:
            self._until, self.playing = None, False

    def step(self) -> None:
        """Let the cursor move until the next end of a sub-task."""
        with self._changed:
            if not self.at_end:
                self._until, self.playing = self.cursor_s, True
                self._changed.notify_all()

    def seek(self, time_s: float) -> None:
        """Pause with the cursor at a simulated time [s]."""
        with self._changed:
            self.cursor_s = float(np.clip(time_s, 0.0, self.end_s))
            self._until, self.playing = None, False

    def set_speed(self, speed: float) -> None:
        """Set the speed, as a multiple of real time."""
        with self._changed:
            self.speed = float(np.clip(speed, SPEEDS[0], SPEEDS[-1]))
            self._changed.notify_all()

    def advance(self, real_s: float) -> None:
        """Move the cursor by some real time [s], at its speed."""
        with self._changed:
            if not self.playing:
                return
            time_s = min(self.cursor_s + real_s * self.speed, self.end_s)
            mark = self._mark()
            if mark is not None and time_s >= mark:
                time_s, self._until, self.playing = mark, None, False
            elif self.over and time_s >= self.end_s:
                self._until, self.playing = None, False
            self.cursor_s = time_s
            self._changed.notify_all()

    def _mark(self) -> float | None:
        """Return the simulated time at which to stop [s]; None if it is unknown."""
        if self._until is None:
            return None
        later = (mark for mark in self._marks if mark > self._until + 1e-6)
        return next(later, None)

    def record(self, qpos: FloatArray, time_s: float) -> None:
        """Record a state every ``FRAME_S``, and wait while it is too far ahead.

        Args:
            qpos: MuJoCo's joint positions, (nq,).
            time_s: Simulated time [s].

        Raises:
            AbandonedError: The page has left the episode.
            InterruptedEpisodeError: A visitor takes over.
        """
        with self._changed:
            self.latest = time_s, qpos.copy()
            if time_s > len(self._frames) * FRAME_S - 1e-6:
                self._frames.append(qpos.copy())
        while due := self._wait(time_s):
            questions, changes = due
            for answer in questions:
                answer()
            if not changes:
                continue
            with self.changing:
                for change in changes:
                    change()
                with self._changed:
                    # Show the changed state.
                    self._frames[-1] = qpos.copy()
                    self.latest = time_s, qpos.copy()
                    self.cursor_s = self.end_s
        if self._interrupted:
            self._interrupted = False
            raise InterruptedEpisodeError

    def _wait(self, time_s: float) -> tuple[list[Callable[[], None]], ...]:
        """Wait until the simulation may continue; return any queries and changes."""
        with self._changed:
            self._changed.wait_for(
                lambda: (
                    self._abandoned
                    or self._changes
                    or self._questions
                    or self._interrupted
                    or time_s <= self.cursor_s + self.lead_s
                )
            )
            if self._abandoned:
                raise AbandonedError
            questions, self._questions = self._questions, []
            changes, self._changes = self._changes, []
            return (questions, changes) if questions or changes else ()

    def change(self, make: Callable[[], None]) -> None:
        """Change the state in the simulation's thread, at its next record.

        Args:
            make: Function that changes the state; called between two steps of physics.
        """
        with self._changed:
            self._until, self.playing = None, False
            self._changes.append(make)
            self._changed.notify_all()

    def ask(self, answer: Callable[[], None]) -> None:
        """Run a query in the simulation's thread, at its next record or in a pause.

        Args:
            answer: Function that reads the state; called between two steps of physics.
                It must not change the state.
        """
        with self._changed:
            self._questions.append(answer)
            self._changed.notify_all()

    def interrupt(self) -> None:
        """Interrupt the sub-task at the next record or in a pause."""
        with self._changed:
            self._interrupted = True
            self._changed.notify_all()

    def mark(self, time_s: float) -> None:
        """Report the end of a sub-task at a simulated time [s]."""
        with self._changed:
            self._marks.append(min(time_s, self.end_s))

    def finish(self) -> None:
        """Report that the last state is final."""
        with self._changed:
            self.over = True

    def abandon(self) -> None:
        """End the simulation at its next record."""
        with self._changed:
            self._abandoned = True
            self._changed.notify_all()
