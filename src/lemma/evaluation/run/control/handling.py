"""Records of contacts and grasps in an episode at control level."""

from typing import Any

from lemma.env.episode import Episode
from lemma.scene.objects.entity import STICK


class HandlingWatch:
    """Takes note of what is grasped and let go, and of what a hand or tool touches.

    It looks once per control step, which changes nothing.
    """

    def __init__(self, episode: Episode) -> None:
        """Begin with nothing in any hand."""
        self._episode = episode
        scene = episode.simulation.scene
        self._data = scene.data
        self._owners = [
            scene.entity_of_body(int(scene.model.geom_bodyid[geom]))
            or scene.model.geom(geom).name.partition("/")[0]
            for geom in range(scene.model.ngeom)
        ]
        """The entity or robot that each geom belongs to."""
        self._hands = {*episode.simulation.arms, STICK}
        self._held: dict[str, str] = {}
        self._events: list[dict[str, Any]] = []
        self._touched: set[str] = set()

    def look(self) -> None:
        """Look at the present moment."""
        held = self._episode.simulation.held()
        if held != self._held:
            self._note(held)
        for contact in self._data.contact[: self._data.ncon]:
            one, other = (self._owners[geom] for geom in contact.geom)
            for hand, thing in ((one, other), (other, one)):
                if hand in self._hands and thing not in self._hands:
                    self._touched.add(thing)

    def _note(self, held: dict[str, str]) -> None:
        for robot in self._episode.simulation.arms:
            before, now = self._held.get(robot), held.get(robot)
            for name, what in ((before, "released"), (now, "grasped")):
                if name is not None and before != now:
                    self._events.append(
                        {
                            "time_s": round(self._episode.elapsed_s, 3),
                            "robot": robot,
                            "event": what,
                            "object": name,
                        }
                    )
        self._held = dict(held)

    def told(self) -> dict[str, Any]:
        """Return it as plain data, ready for JSON."""
        tops = {on.top for on in self._episode.instance.goal.conjuncts}
        return {
            "events": self._events,
            "touched": sorted(tops & self._touched),
            "fallen": list(self._episode.fallen),
        }
