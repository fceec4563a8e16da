"""Play, pause, step, seek: the cursor, and how far the simulation may go."""

import threading

import numpy as np
import pytest

from lemma.viewer.episode.transport import AbandonedError, Transport
from lemma.viz.recording import FRAME_S


class Ticking:
    """Something that ticks every 10 ms in another thread, up to an end."""

    def __init__(self, transport: Transport, end_s: float) -> None:
        self.transport, self.end_s = transport, end_s
        self.time_s = 0.0
        self.abandoned = False
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self) -> None:
        try:
            while self.time_s < self.end_s:
                self.transport.record(np.array([self.time_s]), self.time_s)
                self.time_s = round(self.time_s + 0.01, 2)
            self.transport.finish()
        except AbandonedError:
            self.abandoned = True

    def settle(self) -> float:
        """Return how far it goes if nothing moves the cursor."""
        self.thread.join(0.3)
        return self.time_s


def test_simulation_waits_for_the_cursor_and_no_longer() -> None:
    transport = Transport()
    ticking = Ticking(transport, 2.0)
    assert ticking.settle() == pytest.approx(transport.lead_s, abs=0.02)
    transport.play()
    for _ in range(100):
        transport.advance(0.05)
        ticking.thread.join(0.005)
    ticking.thread.join()
    transport.advance(9.0)
    assert transport.at_end
    assert not transport.playing
    assert transport.cursor_s == pytest.approx(1.95)


def test_seeking_shows_what_was_and_stays() -> None:
    transport = Transport()
    for number in range(5):
        transport.play()
        transport.advance(1.0)
        transport.record(np.array([float(number)]), number * FRAME_S)
    transport.seek(0.1)
    found = transport.qpos()
    assert found is not None
    assert found[0] == 2.0
    transport.advance(1.0)
    assert transport.cursor_s == pytest.approx(0.1)
    transport.seek(99.0)
    assert transport.cursor_s == transport.end_s
    transport.seek(-1.0)
    assert transport.cursor_s == 0.0


def test_step_ends_with_the_subtask() -> None:
    transport = Transport()
    transport.set_speed(8.0)
    for number in range(10):
        transport.record(np.array([float(number)]), number * FRAME_S)
        transport.play()
        transport.advance(1.0)
    transport.seek(0.0)
    for end_s in (0.2, 0.4):
        transport.mark(end_s)
    for end_s in (0.2, 0.4):
        transport.step()
        transport.advance(9.0)
        assert transport.cursor_s == pytest.approx(end_s)
        assert not transport.playing


def test_waiting_simulation_is_told_of_its_end() -> None:
    transport = Transport()
    ticking = Ticking(transport, 100.0)
    ticking.settle()
    transport.abandon()
    ticking.thread.join(5.0)
    assert ticking.abandoned


def test_speed_is_kept_within_bounds() -> None:
    transport = Transport()
    transport.set_speed(1e9)
    assert transport.speed == 8.0
    transport.set_speed(0.0)
    assert transport.speed == 0.25
