"""Geometry of a scene for grounding: reach, grasps, drags, free places.

Ground functions of :class:`lemma.planning.primitives.PrimitiveSpec` get a
:class:`SceneGeometry` as argument.
"""

import math
from dataclasses import dataclass

from lemma.core.poses import Pose2
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.collision_model import sweep_radius_m
from lemma.robots.gripper import FINGER_CENTER_M, FINGER_DISC_M
from lemma.robots.reach import reach_of
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M, STICK_SECTION_M
from lemma.scene.regions import EDGE_M, spots_of
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.scene.table import Gap, lies_on_table
from lemma.tasks.drags import (
    HAND_CLEARANCE_M,
    LARGEST_HEADING_RAD,
    Disc,
    Drag,
    find_drag,
    heading_from,
    is_turned_too_far,
    stick_gap,
    stick_in_grasp,
)
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

_CLEARANCE_M = 0.065
"""Smallest distance from a cube's centre to other objects, so that fingers fit."""
_GOOD_CLEARANCE_M = 0.12
_STICK_CLEARANCE_M = STICK_SECTION_M / 2 + 0.02
_STICK_GRID = 3
_STICK_YAWS = 24

_StickKey = tuple[tuple[Disc, ...], Pose2, Pose2]


class FreeSpots:
    """Chooses places in a region from which other robots can pick objects up."""

    def __init__(
        self, robots: tuple[RobotPlacement, ...], gap_m: Gap | None = None
    ) -> None:
        """Compute the positions that all robots of a region reach.

        Args:
            robots: The robots of the region.
            gap_m: The gap in the table; None without one.
        """
        self._gap_m = gap_m
        self._spots = spots_of(tuple((r.arm, r.base) for r in robots), gap_m)
        self._bases = tuple(robot.base for robot in robots)
        self._stick_places: dict[_StickKey, Pose2 | None] = {}

    def free_spot(
        self, obstacles: tuple[Disc, ...], wider_m: float = 0.0
    ) -> Pose2 | None:
        """Return the best free place for an object, by reach margin and clearance.

        Args:
            obstacles: Discs (x, y, radius) of the objects around [m].
            wider_m: Radius of the object beyond that of a cube [m].

        Returns:
            The place with yaw 0, or None if none is free.
        """
        best, best_score = None, -math.inf
        for x, y, margin in self._spots:
            if margin + _GOOD_CLEARANCE_M <= best_score:
                break
            clearance = _GOOD_CLEARANCE_M
            for ox, oy, radius in obstacles:
                gap = math.hypot(ox - x, oy - y) - radius - wider_m
                if gap < clearance:
                    clearance = gap
                    if clearance < _CLEARANCE_M:
                        break
            else:
                if margin + clearance > best_score:
                    best, best_score = Pose2(x, y), margin + clearance
        return best

    def free_stick(
        self, obstacles: tuple[Disc, ...], base: Pose2, pick: Pose2
    ) -> Pose2 | None:
        """Return the best gripper pose to put the stick down for another robot.

        Args:
            obstacles: Discs (x, y, radius) of the objects around [m].
            base: World from base of the robot that brings the stick.
            pick: Gripper pose at which that robot grasps it.

        Returns:
            World from gripper, or None if no place is free.
        """
        key = (obstacles, base, pick)
        if key not in self._stick_places:
            self._stick_places[key] = next(
                (
                    grip
                    for x, y, _ in self._spots[::_STICK_GRID]
                    for grip in self._stick_poses(x, y)
                    if not is_turned_too_far(base, pick, grip)
                    and _stick_is_free(grip, obstacles, self._gap_m)
                ),
                None,
            )
        return self._stick_places[key]

    def _stick_poses(self, x: float, y: float) -> list[Pose2]:
        """Return gripper poses at a place that every robot can use, best first."""

        def worst(grip: Pose2) -> float:
            stick = stick_in_grasp(grip)
            return max(heading_from(base, stick) for base in self._bases)

        poses = [Pose2(x, y, math.tau * k / _STICK_YAWS) for k in range(_STICK_YAWS)]
        able = [pose for pose in poses if worst(pose) <= LARGEST_HEADING_RAD]
        return sorted(able, key=worst)


def _stick_is_free(grip: Pose2, obstacles: tuple[Disc, ...], gap_m: Gap | None) -> bool:
    stick = stick_in_grasp(grip)
    for corner in (
        stick,
        stick @ Pose2(HANDLE_LENGTH_M, 0.0),
        stick @ Pose2(HANDLE_LENGTH_M, HOOK_LENGTH_M),
    ):
        if not lies_on_table(gap_m, corner, EDGE_M):
            return False
    return all(
        stick_gap(stick, x, y) > radius + _STICK_CLEARANCE_M
        and math.hypot(x - grip.x, y - grip.y) > radius + HAND_CLEARANCE_M
        for x, y, radius in obstacles
    )


_ENOUGH_M = 0.008
_FLAT_M = 0.01
"""Objects lower than this do not obstruct the fingers at a grasp."""

_HANDLING_S = 5.5
"""Part of the duration of every sub-task that is independent of its poses: descend,
grasp, lift, lower [s]."""
_SWING_RAD_S = 1.6
_RADIAL_M_S = 0.6
_GOOD_MARGIN_M = 0.10


_DragKey = tuple[str, str, bool, Pose2, tuple[Disc, ...]]


@dataclass(frozen=True)
class GroundedOption:
    """A grounded sub-task with its predicted effect, quality and duration."""

    subtask: SubTask
    grounded: GroundedSubTask
    after: SymbolicState
    quality: float
    """q in [0, 1], from the reach margin of its poses."""
    duration_s: float
    """tau, the predicted duration [s]."""
    reluctance_s: float = 0.0
    """Penalty that is added to the duration when plans are compared [s]."""
    theirs: GroundedSubTask | None = None
    """The part of the partner in a joint sub-task; None for other sub-tasks."""

    @property
    def partner(self) -> str:
        """The second robot of a joint sub-task; empty for other sub-tasks."""
        return "" if self.theirs is None else self.theirs.robot


class SceneGeometry:
    """Reach, grasps, drags and free places of a scene, from the true state."""

    def __init__(self, spec: SceneSpec) -> None:
        """Compute the free places of all regions.

        Args:
            spec: The scene.
        """
        self._robots = dict(zip(spec.robot_names, spec.robots, strict=True))
        self.regions = {
            name: FreeSpots(tuple(spec.robots[i] for i in robots), spec.gap_m)
            for name, robots in spec.regions.items()
        }
        """Free places by region, where robots can put objects down for each other."""
        self._gap_m = spec.gap_m
        self._placed = {placed.name: placed for placed in spec.objects}
        self._kinds = {placed.name: kind_of(placed.name) for placed in spec.objects}
        self._drags: dict[_DragKey, Drag | None] = {}

    @property
    def robots(self) -> dict[str, RobotPlacement]:
        """The robots by name."""
        return self._robots

    def reaches(self, robot: str, pose: Pose2) -> bool:
        """Return whether a robot can grasp and carry at a position."""
        placed = self._robots[robot]
        return reach_of(placed.arm).margin(placed.base, pose.x, pose.y) > 0.0

    def overload(self, robot: str, item: str) -> str:
        """Return why an object is too heavy for a robot; empty if it is not."""
        return self._robots[robot].overload(robot, self._placed[item])

    def drag(self, subtask: SubTask, now: SymbolicState) -> Drag | None:
        """Return the best drag for a cube, or None if there is none.

        Args:
            subtask: ``hook``, ``poke``, or the preparation of either.
            now: The present state.
        """
        cube = subtask.place
        hooking = subtask.primitive in (Primitive.PREHOOK, Primitive.HOOK)
        obstacles = self.discs(now, but=cube)
        receivers = (
            [subtask.robot]
            if hooking
            else [name for name in self._robots if name != subtask.robot]
        )
        for name in receivers:
            key = (subtask.robot, name, hooking, now.poses[cube], obstacles)
            if key not in self._drags:
                self._drags[key] = find_drag(
                    Primitive.HOOK if hooking else Primitive.POKE,
                    self._robots[subtask.robot],
                    self._robots[name],
                    now.poses[cube],
                    obstacles,
                    kind_of(cube),
                    self._gap_m,
                )
            if self._drags[key] is not None:
                return self._drags[key]
        return None

    def grasp(self, robot: str, cube: str, now: SymbolicState) -> Pose2 | None:
        """Return the grasp of a cube with the largest clearance of the fingers.

        Args:
            robot: Name of the robot.
            cube: Name of the object.
            now: The present state.

        Returns:
            World from gripper; None for a kind that no gripper can hold.
        """
        pose, grasp = now.poses[cube], kind_of(cube).grasp
        if grasp is None:
            return None
        natural = self.bearing(robot, pose)
        first, turn = natural, 0.5 * math.pi
        if grasp.turn_rad:
            turn, yaw = grasp.turn_rad, pose.yaw + grasp.at.yaw
            first = yaw + turn * round((natural - yaw) / turn)
        best = max(
            (first, first + turn),
            key=lambda yaw: min(
                _ENOUGH_M, self._finger_room(Pose2(pose.x, pose.y, yaw), cube, now)
            ),
        )
        return Pose2(pose.x, pose.y, best)

    def _finger_room(self, grip: Pose2, cube: str, now: SymbolicState) -> float:
        """Return the clearance of the open fingers to surrounding objects [m]."""
        room, left_out = math.inf, (cube, now.supports.get(cube))
        fingers = [grip @ Pose2(0.0, side * FINGER_CENTER_M) for side in (-1.0, 1.0)]
        for name, pose in now.poses.items():
            kind = self._kinds[name]
            if kind.height_m < _FLAT_M or name in left_out:
                continue
            for finger in fingers:
                if name == STICK:
                    gap = stick_gap(pose, finger.x, finger.y) - STICK_SECTION_M / 2
                else:
                    gap = finger.distance(pose) - kind.side_m
                room = min(room, gap - FINGER_DISC_M)
        return room

    def discs(self, now: SymbolicState, but: str) -> tuple[Disc, ...]:
        """Return discs of bases and objects, except one object and the stick [m]."""
        found = [
            (r.base.x, r.base.y, sweep_radius_m(r.arm)) for r in self._robots.values()
        ]
        for name, pose in now.poses.items():
            if name not in (but, STICK):
                found.append((pose.x, pose.y, self._kinds[name].disc_m))
        return tuple(found)

    def margin(self, robot: str, *poses: Pose2) -> float:
        """Return a robot's smallest reach margin over poses [m]; negative outside."""
        placed = self._robots[robot]
        reach = reach_of(placed.arm)
        return min(reach.margin(placed.base, pose.x, pose.y) for pose in poses)

    def quality(self, robot: str, *poses: Pose2) -> float:
        """Return q in [0, 1]: a robot's reach margin over poses, scaled and capped."""
        return min(1.0, self.margin(robot, *poses) / _GOOD_MARGIN_M)

    def bearing(self, robot: str, pose: Pose2) -> float:
        """Return the direction of a pose from a robot's base [rad]."""
        base = self._robots[robot].base
        return math.atan2(pose.y - base.y, pose.x - base.x)

    def duration_s(self, robot: str, pick: Pose2, place: Pose2) -> float:
        """Predict the duration of a sub-task, including the way back home [s].

        Args:
            robot: Name of the robot.
            pick: Pose of the grasp.
            place: Pose of the release.
        """
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
