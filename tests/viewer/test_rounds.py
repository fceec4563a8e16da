"""The loop that moves a page, and its end."""

import threading

import pytest

from lemma.viewer.server import Rounds

WAIT_S = 10.0


def test_end_waits_for_the_present_call() -> None:
    rounds, begun, go_on = Rounds(), threading.Event(), threading.Event()
    done: list[float] = []

    def tick(real_s: float) -> None:
        begun.set()
        assert go_on.wait(WAIT_S)
        done.append(real_s)

    loop = threading.Thread(target=rounds.go, args=(tick,))
    loop.start()
    assert begun.wait(WAIT_S)
    ending = threading.Thread(target=rounds.end)
    ending.start()
    ending.join(0.1)
    assert ending.is_alive()
    go_on.set()
    ending.join(WAIT_S)
    loop.join(WAIT_S)
    assert not ending.is_alive()
    assert not loop.is_alive()
    assert len(done) == 1
    assert done[0] >= 0.0


def test_nothing_is_called_after_the_end() -> None:
    rounds = Rounds()
    rounds.end()
    rounds.go(lambda real_s: pytest.fail("called"))


def test_loop_can_be_ended_after_an_interrupt() -> None:
    rounds = Rounds()

    def tick(real_s: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rounds.go(tick)
    rounds.end()
