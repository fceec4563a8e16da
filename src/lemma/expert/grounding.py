"""From a symbolic sub-task to gripper poses: the oracle's geometry.

Each grounding also says what will be true afterwards and how good it is, which is what
the planner's utility is made of.
"""

import math
from dataclasses import dataclass
from functools import partial

from lemma.core.errors import UnknownNameError
from lemma.core.poses import Pose2
from lemma.expert.free_spots import FreeSpots
from lemma.expert.symbolic_state import TABLE, SymbolicState
from lemma.robots.collision_model import sweep_radius_m
from lemma.robots.reach import reach_of
from lemma.scene.objects import PAD_RADIUS_M
from lemma.scene.spec import SHARED, STICK, RobotPlacement, SceneSpec
from lemma.tasks.drags import (
    Disc,
    Drag,
    find_drag,
    grasp_on_stick,
    stick_discs,
    stick_gap,
    stick_in_grasp,
)
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

_FINGER_CENTRE_M = 0.059
"""Of an open finger from the tool centre point."""
_FINGER_RADIUS_M = 0.014
_ENOUGH_M = 0.008
_CUBE_DISC_M = 0.036
_CUBE_FOOTPRINT_M = 0.028

_HANDLING_S = 5.5
"""What every sub-task takes, wherever it happens: descend, grasp, lift, lower."""
_SWING_RAD_S = 1.6
_RADIAL_M_S = 0.6
_DRAG_M_S = 0.2
_GOOD_MARGIN_M = 0.10


_DragKey = tuple[str, str, bool, Pose2, tuple[Disc, ...]]


@dataclass(frozen=True)
class GroundedOption:
    """A sub-task with poses, its predicted effect and its worth."""

    subtask: SubTask
    grounded: GroundedSubTask
    after: SymbolicState
    quality: float
    """q in [0, 1]: how far inside reach it happens."""
    duration_s: float
    """tau: predicted time [s]."""


class GeometricGrounder:
    """Chooses grasp, place and tool poses from the true state."""

    def __init__(self, spec: SceneSpec) -> None:
        """Prepare for a scene.

        Args:
            spec: The scene; robots do not move their bases.
        """
        self._robots = dict(zip(spec.robot_names, spec.robots, strict=True))
        self._places = FreeSpots(spec.robots)
        self._drags: dict[_DragKey, Drag | None] = {}

    @property
    def robots(self) -> dict[str, RobotPlacement]:
        """The team by name."""
        return self._robots

    def reaches(self, robot: str, pose: Pose2) -> bool:
        """Whether a robot can grasp and carry at a position."""
        placed = self._robots[robot]
        return reach_of(placed.arm).margin(placed.base, pose.x, pose.y) > 0.0

    def ground(self, subtask: SubTask, now: SymbolicState) -> GroundedOption | None:
        """Ground a sub-task, or return None where its robot cannot do it.

        Raises:
            UnknownNameError: No such robot.
        """
        if subtask.primitive is Primitive.STOP:
            return None
        if subtask.robot not in self._robots:
            raise UnknownNameError("robot", subtask.robot, self._robots)
        if subtask.pick not in now.poses:
            return None
        if subtask.primitive is Primitive.MOVE:
            if subtask.pick == STICK:
                return self._pass_stick(subtask, now)
            return self._move(subtask, now)
        if subtask.pick != STICK or subtask.place not in now.supports:
            return None
        if subtask.primitive in (Primitive.PREHOOK, Primitive.PREPOKE):
            return self._prepare(subtask, now)
        return self._drag(subtask, now)

    def _move(self, subtask: SubTask, now: SymbolicState) -> GroundedOption | None:
        cube = subtask.pick
        if cube not in now.supports or now.on_top_of(cube) is not None:
            return None
        start = now.poses[cube]
        if subtask.place == SHARED:
            obstacles = self._discs(now, but=cube)
            if STICK in now.poses:
                obstacles += stick_discs(now.poses[STICK])
            spot = self._places.free_spot(obstacles)
            if spot is None:
                return None
            target, support, label = spot, TABLE, SHARED
        elif subtask.place in now.poses and subtask.place != cube:
            if now.on_top_of(subtask.place) is not None:
                return None
            target, support = now.poses[subtask.place], subtask.place
            label = f"on {support}"
        else:
            return None
        margin = self._margin(subtask.robot, start, target)
        if margin <= 0.0:
            return None
        pick = self._grasp(subtask.robot, cube, now)
        turn = self._bearing(subtask.robot, target) - self._bearing(
            subtask.robot, start
        )
        yaw = pick.yaw + turn
        if support.endswith("_cube"):
            # Faces aligned: quarter turns away from the lower cube.
            yaw = target.yaw + 0.5 * math.pi * round((yaw - target.yaw) * 2 / math.pi)
        place = Pose2(target.x, target.y, yaw)
        resting = Pose2(target.x, target.y, start.yaw + yaw - pick.yaw)
        return GroundedOption(
            subtask,
            GroundedSubTask(subtask.robot, subtask.primitive, pick, place),
            now.moved(cube, resting, support, label),
            min(1.0, margin / _GOOD_MARGIN_M),
            self._duration(subtask.robot, pick, place),
        )

    def _pass_stick(
        self, subtask: SubTask, now: SymbolicState
    ) -> GroundedOption | None:
        if subtask.place != SHARED:
            return None
        pick = grasp_on_stick(now.poses[STICK])
        place = self._places.free_stick(self._discs(now, but=STICK))
        if place is None:
            return None
        margin = self._margin(subtask.robot, pick, place)
        if margin <= 0.0:
            return None
        return GroundedOption(
            subtask,
            GroundedSubTask(subtask.robot, subtask.primitive, pick, place),
            now.moved(STICK, stick_in_grasp(place), TABLE, SHARED),
            min(1.0, margin / _GOOD_MARGIN_M),
            self._duration(subtask.robot, pick, place),
        )

    def _prepare(self, subtask: SubTask, now: SymbolicState) -> GroundedOption | None:
        drag = self._find_drag(subtask, now)
        pick = grasp_on_stick(now.poses[STICK])
        if drag is None or not self.reaches(subtask.robot, pick):
            return None
        return GroundedOption(
            subtask,
            GroundedSubTask(subtask.robot, subtask.primitive, pick, drag.prepared),
            now.moved(
                STICK,
                stick_in_grasp(drag.prepared),
                TABLE,
                f"{subtask.primitive} {subtask.place} {subtask.robot}",
            ),
            min(1.0, self._margin(subtask.robot, pick, pick) / _GOOD_MARGIN_M),
            self._duration(subtask.robot, pick, drag.prepared),
        )

    def _drag(self, subtask: SubTask, now: SymbolicState) -> GroundedOption | None:
        """Ground ``hook`` or ``poke``: the stick lies prepared, pull or push it."""
        pick = grasp_on_stick(now.poses[STICK])
        if not now.is_prepared(subtask.primitive, subtask.place):
            return None
        drag = self._find_drag(subtask, now)
        if drag is None or not self.reaches(subtask.robot, pick):
            return None
        # Along the stick as it lies, which is not to the millimetre where it should.
        length = drag.prepared.distance(drag.end)
        sign = 1.0 if subtask.primitive is Primitive.POKE else -1.0
        end = pick @ Pose2(sign * length, 0.0)
        after = now.moved(
            subtask.place, drag.cube, TABLE, f"{subtask.primitive} {subtask.robot}"
        ).moved(STICK, stick_in_grasp(end), TABLE, f"used {subtask.place}")
        return GroundedOption(
            subtask,
            GroundedSubTask(subtask.robot, subtask.primitive, pick, end),
            after,
            min(1.0, self._margin(subtask.robot, pick, pick) / _GOOD_MARGIN_M),
            self._duration(subtask.robot, pick, end) + length / _DRAG_M_S,
        )

    def _find_drag(self, subtask: SubTask, now: SymbolicState) -> Drag | None:
        """Return the best drag for a cube: into one's own reach, or into another's."""
        cube = subtask.place
        hooking = subtask.primitive in (Primitive.PREHOOK, Primitive.HOOK)
        obstacles = self._discs(now, but=cube)
        receivers = (
            [subtask.robot]
            if hooking
            else [name for name in self._robots if name != subtask.robot]
        )
        for name in receivers:
            placed = self._robots[name]
            reach = reach_of(placed.arm)
            key = (subtask.robot, name, hooking, now.poses[cube], obstacles)
            if key not in self._drags:
                self._drags[key] = find_drag(
                    Primitive.HOOK if hooking else Primitive.POKE,
                    self._robots[subtask.robot],
                    now.poses[cube],
                    partial(reach.margin, placed.base),
                    obstacles,
                )
            if self._drags[key] is not None:
                return self._drags[key]
        return None

    def _grasp(self, robot: str, cube: str, now: SymbolicState) -> Pose2:
        """Return the gripper pose that grasps a cube with most room for the fingers."""
        pose = now.poses[cube]
        natural = self._bearing(robot, pose)
        quarter = 0.5 * math.pi
        first = pose.yaw + quarter * round((natural - pose.yaw) / quarter)
        best = max(
            (first, first + quarter),
            key=lambda yaw: min(
                _ENOUGH_M, self._finger_room(Pose2(pose.x, pose.y, yaw), cube, now)
            ),
        )
        return Pose2(pose.x, pose.y, best)

    def _finger_room(self, grip: Pose2, cube: str, now: SymbolicState) -> float:
        """Return the distance of the open fingers to what stands around [m]."""
        room = math.inf
        for side in (-1.0, 1.0):
            finger = grip @ Pose2(0.0, side * _FINGER_CENTRE_M)
            for name, pose in now.poses.items():
                if name in (cube, now.supports.get(cube)) or name.endswith("_pad"):
                    continue
                if name == STICK:
                    gap = stick_gap(pose, finger.x, finger.y) - 0.015
                else:
                    gap = finger.distance(pose) - _CUBE_FOOTPRINT_M
                room = min(room, gap - _FINGER_RADIUS_M)
        return room

    def _discs(self, now: SymbolicState, but: str) -> tuple[Disc, ...]:
        """Return the bases and every object but one and the stick, as discs."""
        found = [
            (r.base.x, r.base.y, sweep_radius_m(r.arm)) for r in self._robots.values()
        ]
        for name, pose in now.poses.items():
            if name not in (but, STICK):
                radius = PAD_RADIUS_M if name.endswith("_pad") else _CUBE_DISC_M
                found.append((pose.x, pose.y, radius))
        return tuple(found)

    def _margin(self, robot: str, *poses: Pose2) -> float:
        placed = self._robots[robot]
        reach = reach_of(placed.arm)
        return min(reach.margin(placed.base, pose.x, pose.y) for pose in poses)

    def _bearing(self, robot: str, pose: Pose2) -> float:
        base = self._robots[robot].base
        return math.atan2(pose.y - base.y, pose.x - base.x)

    def _duration(self, robot: str, pick: Pose2, place: Pose2) -> float:
        """Predict how long a robot takes: there from where it waits, over, and back."""
        base = self._robots[robot].base
        local = [base.inverse() @ pose for pose in (pick, place)]
        bearings = [math.atan2(p.y, p.x) for p in local]
        radii = [math.hypot(p.x, p.y) for p in local]
        park = 2.0
        swing = (
            abs(park - bearings[0])
            + abs(bearings[1] - bearings[0])
            + abs(park - bearings[1])
        )
        stretch = abs(radii[1] - radii[0])
        return _HANDLING_S + swing / _SWING_RAD_S / 2.0 + stretch / _RADIAL_M_S
