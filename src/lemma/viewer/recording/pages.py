"""Recordings as files of the page's own player, and as pages that play them."""

import contextlib
import socket
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import viser

from lemma.core.files import write_whole
from lemma.scene.scene import Scene
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.viewer.scene.bodies import Bodies, light_room, name_bodies
from lemma.viewer.scene.viewpoint import Viewpoint
from lemma.viewer.server import NOTICE_STYLE, close_server, open_server
from lemma.viz.pages.replays import Replay, write_replays
from lemma.viz.recording import FRAME_S, Recording, main_sentence

VISER = ".viser"
"""End of the names of files of the player."""
PAGE = "index.html"
LAST_S = 1.5
"""Time that the end stays before the player begins again [s]."""
_ASPECTS = 1.6, 2.1
"""Of windows with one table and with two."""
_APART_M = 2.0 * TABLE_HALF_X_M + 0.2
_BESIDE_M = 0.9
_TITLE_M = (0.0, TABLE_HALF_Y_M, 0.0)
_HOST = "127.0.0.1"
_CLIENT = "client/build/index.html"


def replay_of(
    name: str,
    title: str,
    sides: Sequence[Recording],
    *,
    sentence: str | None = None,
    opens_s: float = 0.0,
    note: str = "",
) -> Replay:
    """Return an episode, or two side by side, for a page.

    Args:
        name: Its address within the page.
        title: Its heading.
        sides: The episodes, from left to right.
        sentence: The instruction; that of the instance if None.
        opens_s: Simulated time that is shown first [s].
        note: A remark below the sentence.
    """
    if sentence is None:
        sentence = main_sentence(sides[0].instance)
    return Replay(name, title, sentence, serialize(sides), sides, opens_s, note)


def write_folder(folder: Path, replays: Sequence[Replay]) -> Path:
    """Write a page that needs nothing else, and its recordings as files beside it.

    Args:
        folder: Where; made if it is missing.
        replays: The episodes.

    Returns:
        The page.

    Raises:
        DatasetError: It cannot be written there.
    """
    for replay in replays:
        write = partial(_write, replay.content)
        write_whole(folder / f"{replay.name}{VISER}", write)
    write_replays(folder / PAGE, replays, client_page())
    return folder / PAGE


def write_recording(path: Path, recording: Recording) -> None:
    """Write a page that plays a recording; its player lies beside it, for others too.

    Args:
        path: The HTML file.
        recording: With frames.

    Raises:
        DatasetError: It cannot be written there.
    """
    instance = recording.instance
    found = replay_of(instance.task, instance.key, [recording])
    write_replays(path, [found], client_page(), shared=True)


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def serialize(sides: Sequence[Recording]) -> bytes:
    """Return recordings side by side, as the content of a ``.viser`` file.

    Args:
        sides: The episode on each table, from left to right.
    """
    with _server() as server:
        tables = SideBySide(server, sides)
        Viewpoint(server, tables.half_width_m, _ASPECTS[len(sides) > 1])
        serializer = server.get_scene_serializer()
        times = sorted({time_s for side in sides for time_s, _ in side.frames})
        before_s = 0.0
        for time_s in times:
            # Clocks of two episodes may differ by less than anybody sees.
            if time_s - before_s > 0.5 * FRAME_S:
                serializer.insert_sleep(time_s - before_s)
                before_s = time_s
                tables.show(time_s)
        serializer.insert_sleep(LAST_S)
        return serializer.serialize()


class SideBySide:
    """Nodes of recordings that are looked at together."""

    def __init__(self, server: viser.ViserServer, sides: Sequence[Recording]) -> None:
        """Draw the first states, from left to right.

        Args:
            server: The page; its former nodes are removed.
            sides: The episode on each table.
        """
        self._server, self._sides = server, tuple(sides)
        server.scene.reset()
        light_room(server)
        first_m = -0.5 * _APART_M * (len(self._sides) - 1)
        self._tables = []
        for number, side in enumerate(self._sides):
            root = f"/table_{number}"
            at_m = (first_m + number * _APART_M, 0.0, 0.0)
            bodies = Bodies(server, Scene(side.instance.scene), root, at_m, number > 0)
            name_bodies(server, side.instance, root)
            if len(self._sides) > 1:
                server.scene.add_label(f"{root}/title", side.title, position=_TITLE_M)
            self._tables.append(bodies)
        bases = [
            abs(robot.base.x)
            for side in self._sides
            for robot in side.instance.scene.robots
        ]
        self.half_width_m = max(bases) + _BESIDE_M - first_m
        """Half the width that should be in view [m]."""
        self.show(0.0)

    def show(self, time_s: float) -> None:
        """Show all tables at a time [s]."""
        with self._server.atomic():
            for bodies, side in zip(self._tables, self._sides, strict=True):
                bodies.show(side.at(time_s))


def client_page() -> str:
    """Return the player, one HTML file that needs nothing else."""
    page = (Path(viser.__file__).parent / _CLIENT).read_text("utf-8")
    return page.replace("</head>", f"{NOTICE_STYLE}</head>", 1)


@contextlib.contextmanager
def _server() -> Iterator[viser.ViserServer]:
    """Hold a hidden page: only a server can serialize a scene."""
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        port = probe.getsockname()[1]
    server = open_server(_HOST, port)
    try:
        yield server
    finally:
        close_server(server)
