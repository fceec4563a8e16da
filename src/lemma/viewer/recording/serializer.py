"""Files of the page's own player: a scene, and how its bodies move."""

import contextlib
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

import viser

from lemma.viewer.recording.tables import Tables
from lemma.viewer.recording.track import FRAME_S, Track
from lemma.viewer.scene.viewpoint import Viewpoint
from lemma.viewer.server import close_server, open_server

LAST_S = 1.5
"""How long the end stays before the player begins again [s]."""
_ASPECTS = 1.6, 2.1
"""Of windows on one table and on two."""
_HOST = "127.0.0.1"
_CLIENT = "client/build/index.html"


def serialize(tracks: Sequence[Track]) -> bytes:
    """Return tracks side by side, as the content of a ``.viser`` file.

    Args:
        tracks: What happened on each table, from left to right.
    """
    with _server() as server:
        tables = Tables(server, tracks)
        Viewpoint(server, tables.half_width_m, _ASPECTS[len(tracks) > 1])
        serializer = server.get_scene_serializer()
        times = sorted({time_s for track in tracks for time_s in track.times})
        before_s = 0.0
        for time_s in times:
            # Two tracks' clocks may differ by less than anybody sees.
            if time_s - before_s > 0.5 * FRAME_S:
                serializer.insert_sleep(time_s - before_s)
                before_s = time_s
                tables.show(time_s)
        serializer.insert_sleep(LAST_S)
        return serializer.serialize()


def client_page() -> str:
    """Return the player, one HTML file that needs nothing else."""
    return (Path(viser.__file__).parent / _CLIENT).read_text("utf-8")


@contextlib.contextmanager
def _server() -> Iterator[viser.ViserServer]:
    """Hold a page that nobody opens: only from one can a scene be serialized."""
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        port = probe.getsockname()[1]
    server = open_server(_HOST, port)
    try:
        yield server
    finally:
        close_server(server)
