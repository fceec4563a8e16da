"""One or two tables beside each other in a page, each with an episode on it."""

from collections.abc import Sequence

import numpy as np
import viser

from lemma.scene.scene import Scene
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.viewer.recording.track import Track
from lemma.viewer.scene.bodies import Bodies, light_room, name_bodies

_APART_M = 2.0 * TABLE_HALF_X_M + 0.2
_BESIDE_M = 0.9
_TITLE_M = (0.0, TABLE_HALF_Y_M, 0.0)


class Tables:
    """Nodes of tracks that are looked at together."""

    def __init__(self, server: viser.ViserServer, tracks: Sequence[Track]) -> None:
        """Draw the first states, from left to right.

        Args:
            server: The page; whatever was on it goes.
            tracks: What happened on each table.
        """
        self._server, self._tracks = server, tuple(tracks)
        server.scene.reset()
        light_room(server)
        first_m = -0.5 * _APART_M * (len(self._tracks) - 1)
        self._tables = []
        for number, track in enumerate(self._tracks):
            root = f"/table_{number}"
            at_m = (first_m + number * _APART_M, 0.0, 0.0)
            bodies = Bodies(server, Scene(track.instance.scene), root, at_m, number > 0)
            name_bodies(server, track.instance, root)
            if len(self._tracks) > 1:
                server.scene.add_label(f"{root}/title", track.title, position=_TITLE_M)
            self._tables.append(bodies)
        bases = [
            abs(robot.base.x)
            for track in self._tracks
            for robot in track.instance.scene.robots
        ]
        self.half_width_m = max(bases) + _BESIDE_M - first_m
        """What shall be seen to the left and right [m]."""
        self.show(0.0)

    def show(self, time_s: float) -> None:
        """Show all tables at a time [s]."""
        with self._server.atomic():
            for bodies, track in zip(self._tables, self._tracks, strict=True):
                bodies.show(np.asarray(track.at(time_s)))
