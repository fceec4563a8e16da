"""One or two tables beside each other in a page, each with an episode on it."""

from collections.abc import Sequence

import viser

from lemma.scene.scene import Scene
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.viewer.scene.bodies import Bodies, light_room, name_bodies
from lemma.viz.recording import Recording

_APART_M = 2.0 * TABLE_HALF_X_M + 0.2
_BESIDE_M = 0.9
_TITLE_M = (0.0, TABLE_HALF_Y_M, 0.0)


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
