"""Servers of pages: the loop that moves them, addresses, and who may open a socket."""

import threading

import pytest

from lemma.core.errors import InvalidConfigError
from lemma.viewer.server import Guard, Rounds, address_of, open_server

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


@pytest.mark.parametrize(
    ("host", "listens_at", "own"),
    [
        ("localhost:8080", "127.0.0.1", True),
        ("[::1]:8080", "::1", True),
        ("evil.example:8080", "127.0.0.1", False),
        ("robots.example:8080", "0.0.0.0", True),
    ],
)
def test_a_name_that_resolves_to_this_machine_is_not_ours(
    host: str, listens_at: str, own: bool
) -> None:
    assert Guard(listens_at).admits(f"http://{host}", host) is own


def test_a_proxy_may_be_named_and_refusals_are_told_once() -> None:
    told: list[str] = []
    guard = Guard("127.0.0.1", {"robots.example"}, told.append)
    assert guard.admits("https://robots.example:444", "127.0.0.1:8080")
    for _ in range(2):
        assert not guard.admits("https://evil.example", "robots.example")
    (sentence,) = told
    assert "https://evil.example" in sentence
    assert "--allow-host" in sentence


@pytest.mark.parametrize(
    ("host", "address"),
    [
        ("127.0.0.1", "http://127.0.0.1:7"),
        ("::1", "http://[::1]:7"),
        ("0.0.0.0", "http://127.0.0.1:7"),
        ("::", "http://[::1]:7"),
    ],
)
def test_address_can_be_visited(host: str, address: str) -> None:
    assert address_of(host, 7) == address


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 10**6), ("300.1.1.1", 8080)])
def test_impossible_address_is_refused(host: str, port: int) -> None:
    with pytest.raises(InvalidConfigError):
        open_server(host, port)
