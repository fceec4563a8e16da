"""Sampled tables: nothing overlaps, all is seen, nobody can do another's part.

Reachable sets are computed here from the bound alone, without the code that samples.
"""

import math
from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from tiers import slow_but

from lemma.core.errors import SamplingError
from lemma.core.poses import Pose2
from lemma.robots.collision_model import sweep_radius_m
from lemma.robots.could import could_of
from lemma.robots.reach import GRASP_HEIGHT_M, TRAVEL_HEIGHT_M, can_hold, reach_of
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX, camera_mount
from lemma.scene.cameras import Camera, CameraIntrinsics
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.pad import PAD_RADIUS_M
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M, STICK_SECTION_M
from lemma.scene.raster import RASTER
from lemma.scene.spec import ObjectPlacement, RobotPlacement
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.tasks.drags import grasp_on_stick
from lemma.tasks.goal import Goal
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.names import FAMILIES
from lemma.tasks.placement import ObjectPlacer, PlacementError
from lemma.tasks.sampling import sample
from lemma.tasks.suite import SUITE, TASKS, load_instance
from lemma.tasks.task import TEAMS, Task

TABLES = (*SUITE, *FAMILIES)
Box = tuple[Pose2, float, float]
"""Centre and half sizes of a rectangle on the table."""


def of_test_split(task: str) -> list[Instance]:
    return [load_instance(task, "test", index) for index in range(SPLITS["test"])]


# --- Nothing overlaps --------------------------------------------------------------


def boxes(placed: ObjectPlacement) -> list[Box]:
    """Outline of the stick, or of what is made of boxes."""
    half = STICK_SECTION_M / 2
    if placed.kind != "stick":
        parts = placed.entity.kind.parts
        at = [(placed.pose @ Pose2(*p.position_m[:2]), p.size_m) for p in parts]
        return [(pose, size[0], size[1]) for pose, size in at]
    hook_u, hook_v = HANDLE_LENGTH_M - half, HOOK_LENGTH_M / 2 - half
    return [
        (placed.pose @ Pose2(HANDLE_LENGTH_M / 2, 0.0), HANDLE_LENGTH_M / 2, half),
        (placed.pose @ Pose2(hook_u, hook_v), half, HOOK_LENGTH_M / 2),
    ]


@cache
def outline(placed: ObjectPlacement) -> list[tuple[float, float]]:
    """Points on an object's rim, a few millimetres apart."""
    if placed.kind == "pad":
        turns = (math.tau * k / 64 for k in range(64))
        rim = (
            Pose2(PAD_RADIUS_M * math.cos(a), PAD_RADIUS_M * math.sin(a)) for a in turns
        )
        return [(placed.pose @ point).xy for point in rim]
    points = []
    for centre, half_u, half_v in boxes(placed):
        for u in np.linspace(-half_u, half_u, 41):
            points += [(centre @ Pose2(float(u), s * half_v)).xy for s in (-1, 1)]
        for v in np.linspace(-half_v, half_v, 41):
            points += [(centre @ Pose2(s * half_u, float(v))).xy for s in (-1, 1)]
    return points


def extent(rim: NDArray[np.float64]) -> float:
    """How far from its middle a rim goes [m]."""
    return float(np.linalg.norm(rim - rim.mean(0), axis=1).max())


def gap(a: ObjectPlacement, b: ObjectPlacement) -> float:
    """The least distance between two rims [m]; they are never one in the other.

    Of two that are far apart, a lower bound.
    """
    first, second = np.array(outline(a)), np.array(outline(b))
    middles = first.mean(0), second.mean(0)
    apart = math.dist(*middles) - extent(first) - extent(second)
    if apart > 0.1:
        return apart
    between = first[:, None] - second[None]
    return float(np.hypot(between[..., 0], between[..., 1]).min())


def on_the_table(instance: Instance) -> list[ObjectPlacement]:
    """All objects but those that begin on a tray."""
    scene = instance.scene
    return [placed for placed in scene.objects if not scene.rests_m(placed)]


@pytest.mark.parametrize("task", slow_but(TABLES, "pass", "hook_stack", "relay"))
def test_nothing_overlaps(task: str) -> None:
    for instance in of_test_split(task):
        for a, b in combinations(on_the_table(instance), 2):
            assert a.pose.distance(b.pose) > 0.05 or STICK in (a.name, b.name)
            # Fingers, 16 mm thick, fit between a cube and what is next to it.
            assert gap(a, b) > (0.015 if "cube" in (a.kind, b.kind) else 0.005)


@pytest.mark.parametrize("task", TABLES)
def test_everything_lies_on_the_table_and_clear_of_the_robots(task: str) -> None:
    for instance in of_test_split(task):
        for placed in instance.scene.objects:
            rim = outline(placed)
            assert max(abs(x) for x, _ in rim) < TABLE_HALF_X_M
            assert max(abs(y) for _, y in rim) < TABLE_HALF_Y_M
            if edges := instance.scene.gap_m:
                xs = [x for x, _ in rim]
                assert max(xs) < edges[0] or min(xs) > edges[1]
            for robot in instance.scene.robots:
                near = min(math.dist(point, robot.base.xy) for point in rim)
                assert near > sweep_radius_m(robot.arm)


# --- Everything is seen ------------------------------------------------------------


@pytest.mark.parametrize("task", slow_but(TABLES, "pass", "hook_stack", "relay"))
def test_some_camera_sees_every_object(task: str) -> None:
    for instance in of_test_split(task):
        cameras = []
        for robot in instance.scene.robots:
            mount, fovy = camera_mount(robot)
            lens = CameraIntrinsics.from_fovy(fovy, CAMERA_WIDTH_PX, CAMERA_HEIGHT_PX)
            cameras.append(Camera("camera", mount, lens))
        for placed in instance.scene.objects:
            rim = np.array([(x, y, 0.0) for x, y in outline(placed)])
            assert (np.abs(rim[:, 0]) < 0.5 * RASTER.size_m[0]).all()
            assert (np.abs(rim[:, 1]) < 0.5 * RASTER.size_m[1]).all()
            seen = np.zeros(len(rim), bool)
            for camera in cameras:
                u, v = camera.project(rim)[0].T
                seen |= (
                    (u >= 0) & (u < CAMERA_WIDTH_PX) & (v >= 0) & (v < CAMERA_HEIGHT_PX)
                )
            # At the border of the images a rim may be cut.
            assert seen.mean() > 0.7, f"{instance.key} {placed.name}"


# --- One answer to who could do what -----------------------------------------------


def handle(instance: Instance, name: str) -> Pose2:
    """Where an object is grasped."""
    pose = instance.scene.placement(name).pose
    return grasp_on_stick(pose) if name == STICK else pose


def works(robot: RobotPlacement, at: Pose2) -> bool:
    """Whether a robot surely works at a position."""
    reach, away = reach_of(robot.arm), robot.base.distance(at)
    return reach.inner_m + 0.03 <= away <= reach.travel_m - 0.03


def cannot(robot: RobotPlacement, placed: ObjectPlacement) -> bool:
    """Whether no posture of a robot touches a thing, nor puts anything on it."""
    could = could_of(robot.arm)
    rim = min(math.dist(point, robot.base.xy) for point in outline(placed))
    # An object on a pad or a cube has its middle above it.
    support = {"pad": PAD_RADIUS_M, "cube": CUBE_EDGE_M / 2}.get(placed.kind, 0.0)
    middle = robot.base.distance(placed.pose) if support else math.inf
    # 3 cm of margin, of which discs around what is square take nothing away.
    return rim >= could.touch_m + 0.029 and middle - support >= could.place_m + 0.019


def able(instance: Instance, name: str) -> list[int]:
    """Which robots work where an object lies; fails where others could do anything."""
    placed, at = instance.scene.placement(name), handle(instance, name)
    found = []
    for which, robot in enumerate(instance.scene.robots):
        if works(robot, at):
            found.append(which)
        else:
            assert cannot(robot, placed), f"{instance.key}: {robot.arm} and {name}"
    return found


@pytest.mark.parametrize("task", TABLES)
def test_each_robot_either_works_with_a_thing_or_could_not_touch_it(task: str) -> None:
    for instance in of_test_split(task):
        for placed in on_the_table(instance):
            # Of trays and racks, tests of carry say the same about both handles.
            if placed.kind not in ("tray", "rack"):
                able(instance, placed.name)


@pytest.mark.parametrize("task", SUITE)
def test_kinematics_agree_about_who_works_where(task: str) -> None:
    """The ring that stands for reach is what inverse kinematics says, in 80 cases."""
    for instance in of_test_split(task)[:10]:
        for name in instance.goal.entities:
            x, y = handle(instance, name).xy
            for which, robot in enumerate(instance.scene.robots):
                low = can_hold(robot.arm, robot.base, x, y, GRASP_HEIGHT_M)
                high = can_hold(robot.arm, robot.base, x, y, TRAVEL_HEIGHT_M)
                assert (low and high) == (which in able(instance, name))
                assert low == high


@pytest.mark.parametrize("task", ["pass", "stack", "hook", "hook_stack"])
def test_who_has_the_top_cannot_push_it_to_its_bottom_on_another_cube(
    task: str,
) -> None:
    towers = 0
    for instance in of_test_split(task):
        ((top, bottom),) = instance.goal.pairs
        with_stick = task.startswith("hook")
        (user,) = able(instance, STICK if with_stick else top)
        robot = instance.scene.robots[user]
        farthest_m = could_of(robot.arm).touch_m
        farthest_m += HANDLE_LENGTH_M if with_stick else 0.0

        def away_m(placed: ObjectPlacement, base: Pose2 = robot.base) -> float:
            return base.distance(placed.pose)

        spare = [
            placed
            for placed in instance.scene.objects
            if placed.kind == "cube"
            and placed.name not in (top, bottom)
            and away_m(placed) < farthest_m + CUBE_EDGE_M / 2
        ]
        target = instance.scene.placement(bottom)
        half_m = CUBE_EDGE_M / 2 if target.kind == "cube" else PAD_RADIUS_M
        # A row of them is pushed until it slides on by itself. Its first carries the
        # top, which stands out by half of itself.
        row_m = len(spare) * CUBE_EDGE_M + CUBE_EDGE_M / 2
        towers += bool(spare)
        if spare:
            assert away_m(target) - half_m > farthest_m + row_m + 0.15
    assert towers


@pytest.mark.parametrize("task", ["pass", "pass2", "stack", "stack2"])
def test_two_robots_are_needed_in_both_directions_where_there_are_two(
    task: str,
) -> None:
    for instance in of_test_split(task):
        tops = [able(instance, top) for top, _ in instance.goal.pairs]
        bottoms = [able(instance, bottom) for _, bottom in instance.goal.pairs]
        for top, bottom in zip(tops, bottoms, strict=True):
            assert sorted([top, bottom]) == [[0], [1]]
        assert len(tops) == 1 or sorted(tops) == [[0], [1]]


def stick_points(instance: Instance) -> list[tuple[float, float]]:
    return outline(instance.scene.placement(STICK))


@pytest.mark.parametrize("task", ["poke", "poke_stack", "hook", "hook_stack"])
def test_nobody_reaches_the_cubes_of_tool_tasks(task: str) -> None:
    for instance in of_test_split(task):
        (user,) = able(instance, STICK)
        for name in instance.goal.entities:
            if name.endswith("_cube"):
                assert able(instance, name) == []
            else:
                assert able(instance, name) == [1 - user]


@pytest.mark.parametrize("task", ["poke", "poke_stack", "hook", "hook_stack"])
def test_no_point_of_the_stick_is_within_the_other_robots_possibilities(
    task: str,
) -> None:
    for instance in of_test_split(task):
        (user,) = able(instance, STICK)
        other = instance.scene.robots[1 - user]
        nearest = min(math.dist(p, other.base.xy) for p in stick_points(instance))
        assert nearest > could_of(other.arm).touch_m + 0.01


@pytest.mark.parametrize("task", ["poke", "poke_stack"])
def test_a_gap_is_between_the_tool_user_and_all_that_it_must_not_touch(
    task: str,
) -> None:
    for instance in of_test_split(task):
        (user,) = able(instance, STICK)
        robot, gap = instance.scene.robots[user], instance.scene.gap_m
        assert gap is not None
        assert gap[1] - gap[0] == pytest.approx(0.20)
        # Seen from the tool user: where its table top ends, and where the other begins.
        ends, begins = sorted(abs(edge - robot.base.x) for edge in gap)
        assert ends < could_of(robot.arm).place_m < begins - 0.02
        assert (robot.base.x < gap[0]) == (user == 0)
        for name in instance.goal.entities:
            placed = instance.scene.placement(name)
            beyond = (min if user == 0 else max)(x for x, _ in outline(placed))
            assert abs(beyond - robot.base.x) > begins
        # The stick lies on its user's side, and so does no goal.
        assert all(
            abs(x - robot.base.x) < ends or (x < robot.base.x) == (user == 0)
            for x, _ in stick_points(instance)
        )


def test_each_cube_of_hook_stack_is_hooked_by_one_robot_alone() -> None:
    """The other could not even touch it with the whole stick in its outmost hand."""
    stick_m = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M)
    for instance in of_test_split("hook_stack"):
        nearest = []
        for name in instance.goal.entities:
            cube = instance.scene.placement(name)
            out = []
            for robot in instance.scene.robots:
                rim = min(math.dist(p, robot.base.xy) for p in outline(cube))
                out.append(rim - could_of(robot.arm).place_m - stick_m)
            nearest.append([which for which in (0, 1) if out[which] < 0.0])
        assert sorted(nearest) == [[0], [1]]


@pytest.mark.parametrize("task", SUITE)
def test_robots_face_each_other_and_share_a_region_or_leave_a_gap(task: str) -> None:
    shared = set()
    for instance in of_test_split(task):
        left, right = instance.scene.robots
        assert left.base.x < 0.0 < right.base.x
        assert abs(left.base.y - right.base.y) <= 0.1001
        assert abs(left.base.yaw) <= 0.1001
        assert abs(right.base.yaw - math.pi) <= 0.1001
        reaches = [reach_of(robot.arm) for robot in (left, right)]
        apart = right.base.x - left.base.x
        width = sum(reach.travel_m for reach in reaches) - apart
        shared.add(width > 0.0)
        if width > 0.0:
            assert 0.15 <= width <= 0.31
        else:
            # A cube lies between what the two could touch.
            could = sum(could_of(robot.arm).touch_m for robot in (left, right))
            assert apart > could + CUBE_EDGE_M
        assert (instance.scene.gap_m is None) == (width > 0.0)
    # Only a poke bridges a gap.
    assert shared == {task not in ("poke", "poke_stack")}


# --- The sampler -------------------------------------------------------------------


@pytest.mark.parametrize("task", ["pass2", "stack", "hook"])
def test_a_draw_is_a_function_of_its_key(task: str) -> None:
    record = TASKS[task]
    first = sample(record, "free", 5)
    for other in (
        sample(record, "free", 6),
        sample(record, "train", 5),
        sample(record, "free", 5, attempt=1),
    ):
        assert other.instance.scene != first.instance.scene
    assert sample(record, "free", 5) == first


@pytest.mark.parametrize("team", [pair for t in TEAMS for pair in (t, t[::-1])])
def test_a_team_can_be_asked_for(team: tuple[str, str]) -> None:
    instance = sample(TASKS["hook"], "free", 2, team=team).instance
    assert tuple(robot.arm for robot in instance.scene.robots) == team


def test_a_task_that_no_table_satisfies_says_so() -> None:
    def arrange(placer: ObjectPlacer) -> Goal:
        raise PlacementError("cube")

    impossible = Task(
        name="impossible",
        summary="",
        subtasks=2,
        distractors=(0, 0),
        arrange=arrange,
        language=TASKS["stack"].language,
    )
    with pytest.raises(SamplingError) as caught:
        sample(impossible, "free", 0, team=("ur5", "ur10"))
    message = str(caught.value)
    assert "'impossible'" in message
    assert "ur5+ur10" in message
    assert "Loosen" in message


def test_objects_are_listed_in_no_telling_order() -> None:
    """The place in the list does not give away what the goal needs."""
    places = [
        instance.scene.object_names.index(instance.goal.entities[0])
        for instance in of_test_split("pass2")
    ]
    assert len(set(places)) > 4
    assert any(a > b for a, b in pairwise(places))
