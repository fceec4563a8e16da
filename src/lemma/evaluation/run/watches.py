"""Observers of an episode: clearance between arms, contacts, grasps.

They read the state and do not change it.
"""

import math
from itertools import combinations
from typing import Any

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.robots.collision_model import envelope_of, place_capsules, segment_distance
from lemma.robots.ur.kinematics import frames
from lemma.scene.build import TICK_S
from lemma.scene.objects.entity import STICK
from lemma.scene.scene import RobotIndex

PERIOD_S = 0.1
"""Simulated time between two measurements [s]."""
_TICKS = round(PERIOD_S / TICK_S)


class ClearanceWatch:
    """Measures the smallest distance between any two arms of a simulation.

    An arm is the capsules around its links and gripper, without a held object, at the
    measured joint angles. The distance is signed: at 0 or less two capsules touch or
    overlap, although the links inside of them may not.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Measure once, and subscribe to the simulation's ticks."""
        self._qpos = simulation.scene.data.qpos
        arms = [_Arm(robot) for robot in simulation.scene.robots]
        self._pairs = list(combinations(arms, 2))
        self._ticks = 0
        self.least_m = math.inf
        """Smallest distance so far [m]; infinity for one arm."""
        self._look()
        simulation.observers.append(self._tick)

    def _tick(self) -> None:
        self._ticks += 1
        if self._ticks % _TICKS == 0:
            self._look()

    def _look(self) -> None:
        for first, second in self._pairs:
            self.least_m = _nearest(
                first.place(self._qpos), second.place(self._qpos), self.least_m
            )


class ContactWatch:
    """Measures the time of contact between arms, in every servo tick."""

    def __init__(self, simulation: Simulation) -> None:
        """Subscribe to the simulation's ticks."""
        self._data, self._parts = simulation.scene.data, simulation.scene.parts
        self.touched_s = 0.0
        """Time with contact between any two arms [s]."""
        simulation.observers.append(self._tick)

    def _tick(self) -> None:
        robots = self._parts[self._data.contact.geom, 0]
        if ((robots[:, 0] != robots[:, 1]) & (robots.min(axis=1) >= 0)).any():
            self.touched_s += TICK_S


class _Arm:
    """The capsules of one arm, with buffers for their positions."""

    def __init__(self, robot: RobotIndex) -> None:
        envelope = envelope_of(robot.arm.name)
        self._robot = robot
        self._links = envelope.capsule_links
        self._capsules = envelope.capsules
        self._frames = np.empty((7, 4, 4))
        self._placed = np.empty((len(envelope.capsules), 7))

    def place(self, qpos: FloatArray) -> FloatArray:
        """Return the capsules at the present joint angles, (n, 7) [m]."""
        robot = self._robot
        frames(robot.arm.dh, robot.world_from_base, qpos[robot.qpos], self._frames)
        place_capsules(self._frames, self._links, self._capsules, self._placed)
        return self._placed


@kernel
def _nearest(first: FloatArray, second: FloatArray, least: float) -> float:
    """Return the smaller of ``least`` and the gap between capsules of two arms [m]."""
    for i in range(first.shape[0]):
        for j in range(second.shape[0]):
            # A cheap lower bound from bounding spheres, which mostly suffices.
            gap = _ball_gap(first[i], second[j])
            if gap < least:
                radii = first[i, 6] + second[j, 6]
                least = min(least, segment_distance(first[i], second[j]) - radii)
    return least


@kernel
def _ball_gap(a: FloatArray, b: FloatArray) -> float:
    """Return a lower bound of the gap between two capsules [m]."""
    middle = length_a = length_b = 0.0
    for i in range(3):
        middle += (a[i] + a[3 + i] - b[i] - b[3 + i]) ** 2
        length_a += (a[3 + i] - a[i]) ** 2
        length_b += (b[3 + i] - b[i]) ** 2
    lengths = math.sqrt(length_a) + math.sqrt(length_b)
    gap: float = 0.5 * (math.sqrt(middle) - lengths) - a[6] - b[6]
    return gap


class HandlingWatch:
    """Records grasps, releases, and cubes that a hand or tool touches.

    It measures once per control step of an episode at control level.
    """

    def __init__(self, episode: Episode) -> None:
        """Begin without grasps."""
        self._episode = episode
        scene = episode.simulation.scene
        self._data = scene.data
        self._owners = [
            scene.entity_of_body(int(scene.model.geom_bodyid[geom]))
            or scene.model.geom(geom).name.partition("/")[0]
            for geom in range(scene.model.ngeom)
        ]
        """The entity or robot of each geom."""
        self._hands = {*episode.simulation.arms, STICK}
        self._held: dict[str, str] = {}
        self._events: list[dict[str, Any]] = []
        self._touched: set[str] = set()

    def look(self) -> None:
        """Record changes since the last call."""
        held = self._episode.simulation.held()
        if held != self._held:
            self._note(held)
        for contact in self._data.contact[: self._data.ncon]:
            one, other = (self._owners[geom] for geom in contact.geom)
            for hand, thing in ((one, other), (other, one)):
                if hand in self._hands and thing not in self._hands:
                    self._touched.add(thing)

    def _note(self, held: dict[str, str]) -> None:
        time_s = round(self._episode.elapsed_s, 3)
        for robot in self._episode.simulation.arms:
            before, now = self._held.get(robot), held.get(robot)
            for name, event in ((before, "released"), (now, "grasped")):
                if name is not None and before != now:
                    fields = {"robot": robot, "event": event, "object": name}
                    self._events.append({"time_s": time_s, **fields})
        self._held = dict(held)

    def fields(self) -> dict[str, Any]:
        """Return the record as plain data, ready for JSON."""
        tops = {on.top for on in self._episode.instance.goal.conjuncts}
        return {
            "events": self._events,
            "touched": sorted(tops & self._touched),
            "fallen": list(self._episode.fallen),
        }
