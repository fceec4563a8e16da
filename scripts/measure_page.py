"""Measure the page of ``lemma play`` during an episode at real time.

python scripts/measure_page.py pass
"""

import json
import socket
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from urllib.request import urlopen

import viser
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from lemma.core.errors import InvalidConfigError
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.tasks.instance import Instance
from lemma.tasks.suite import load_instance
from lemma.viewer.episode.session import Session
from lemma.viewer.episode.status import EpisodeRequest, Phase
from lemma.viewer.page import Page
from lemma.viewer.server import open_server

HOST = "127.0.0.1"
_LOOK_S = 0.002
_LONGEST_S = 300.0


@dataclass(frozen=True, slots=True)
class PageFigures:
    """Performance of a page on this machine while the expert acts at real time."""

    up_s: float
    """Time from the call that opens the page until it answers [s]."""
    first_scene_s: float
    """Time from the call that opens the page until a visitor has the scene [s]."""
    updates_hz: float
    """Updates of the scene per second while robots act [Hz]."""
    slowest_ms: float
    """99th percentile of the time between two messages to a visitor [ms]."""
    realtime: float
    """Simulated seconds shown per second."""
    kb_s: float
    """Data rate to a visitor [kB/s]."""
    same_state: bool
    """Whether the episode ended in the same state as without a page."""

    def to_dict(self) -> dict[str, float | bool]:
        """Return plain data, ready for JSON."""
        return {
            name: value if isinstance(value, bool) else round(value, 3)
            for name, value in asdict(self).items()
        }


class _Visitor:
    """A client that receives the page's messages and records their times."""

    def __init__(self, socket_: Connection) -> None:
        self._socket = socket_
        self.arrived: list[tuple[float, int]] = []
        """Time [s] and size [B] of each message."""
        self._thread = threading.Thread(target=self._take, daemon=True)
        self._thread.start()

    def _take(self) -> None:
        for message in self._socket:
            self.arrived.append((time.perf_counter(), len(message)))

    def leave(self) -> None:
        """Close the connection."""
        self._socket.close()
        self._thread.join()


def measure_page(instance: Instance, speed: float = 1.0) -> PageFigures:
    """Open a page with one visitor, and run the expert in it.

    Args:
        instance: The instance to play.
        speed: Speed as a multiple of real time.

    Raises:
        InvalidConfigError: The expert did not finish.
    """
    begin = time.perf_counter()
    request = EpisodeRequest(
        instance.task, instance.split, instance.index, policy=ORACLE
    )
    page = Page(Session(request, (ORACLE,)), open_server(HOST, _free_port()))
    loop = threading.Thread(target=page.run, daemon=True)
    loop.start()
    try:
        with urlopen(page.address) as answer:
            answer.read()
        up_s = time.perf_counter() - begin
        address = page.address.replace("http", "ws")
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        # Without proxies and limit of size, because a scene is one message.
        with connect(
            address, subprotocols=[protocol], max_size=None, proxy=None
        ) as socket_:
            visitor = _Visitor(socket_)
            _wait(lambda: page.session.play.status.phase is Phase.READY)
            _wait(lambda: bool(visitor.arrived))
            first_scene_s = time.perf_counter() - begin
            page.session.set_speed(speed)
            page.session.ask(request, acts=True)
            figures = _watch(page, visitor)
            visitor.leave()
        rollout = page.session.play.rollout
        assert rollout is not None
        state = rollout.episode.simulation.scene.state_hash()
    finally:
        page.close()
        loop.join()
    return PageFigures(up_s, first_scene_s, *figures, state == _alone(instance))


def _watch(page: Page, visitor: _Visitor) -> tuple[float, float, float, float]:
    """Return updates [Hz], the slowest [ms], the real-time factor, and rate [kB/s]."""
    transport = page.session.play.transport
    _wait(lambda: transport.cursor_s > 0.0)
    start, shown_s, updates = time.perf_counter(), transport.cursor_s, page.updates
    _wait(lambda: transport.over and transport.at_end)
    end = time.perf_counter()
    took_s = end - start
    arrived = [each for each in visitor.arrived if start <= each[0] <= end]
    gaps = sorted(
        1000.0 * (after - before) for (before, _), (after, _) in pairwise(arrived)
    )
    return (
        (page.updates - updates) / took_s,
        gaps[int(0.99 * (len(gaps) - 1))],
        (transport.end_s - shown_s) / took_s,
        sum(size for _, size in arrived) / 1000.0 / took_s,
    )


def _alone(instance: Instance) -> str:
    """Return the hash of the final state of the same episode without a page."""
    rollout = Rollout(instance)
    for _ in roll_out([rollout], Player.load(PolicySpec(ORACLE))):
        pass
    return rollout.episode.simulation.scene.state_hash()


def _wait(true: Callable[[], bool]) -> None:
    end = time.monotonic() + _LONGEST_S
    while not true():
        if time.monotonic() > end:
            raise InvalidConfigError(f"The page did nothing for {_LONGEST_S:g} s.")
        time.sleep(_LOOK_S)


def _free_port() -> int:
    with socket.socket() as found:
        found.bind((HOST, 0))
        port: int = found.getsockname()[1]
        return port


if __name__ == "__main__":
    instance = load_instance(sys.argv[1] if len(sys.argv) > 1 else "pass", "test", 0)
    print(json.dumps(measure_page(instance).to_dict()))
