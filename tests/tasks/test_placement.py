"""The placer: zones by what robots could do, places that fit, colors that run out."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from lemma.core.errors import SamplingError
from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_KIND,
    STICK_SECTION_M,
)
from lemma.scene.spec import ObjectPlacement, RobotPlacement
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.tasks.drags import (
    LARGEST_HEADING_RAD,
    find_drag,
    grasp_on_stick,
    heading_from,
)
from lemma.tasks.goal import Goal
from lemma.tasks.placement import ObjectPlacer, PlacementError
from lemma.tasks.subtask import Primitive
from lemma.tasks.zones import OUTSIDE_M, REMOTE_M, Territory, Zone

TEAM = (
    RobotPlacement("ur5", "red", Pose2(-0.9, 0.0, 0.0)),
    RobotPlacement("ur10", "white", Pose2(0.9, 0.0, math.pi)),
)
ROUNDED_M = 0.05e-3 * (math.sqrt(2.0) + HANDLE_LENGTH_M)
"""Poses are rounded to 0.1 mm and 0.1 mrad after they are checked, so a point on the
stick may be this far beyond a bound that has a margin of 20 mm or more."""
SEEDS = st.integers(0, 10_000)
KINDS = st.sampled_from([CUBE, PAD, STICK_KIND])
ON_TABLE = st.builds(
    Pose2, st.floats(-1.7, 1.7), st.floats(-1.7, 1.7), st.floats(-math.pi, math.pi)
)
AROUND_TABLE = st.builds(
    Pose2, st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-math.pi, math.pi)
)


def placer(seed: int = 0, team: tuple[RobotPlacement, ...] = TEAM) -> ObjectPlacer:
    return ObjectPlacer(team, stream("test", "placer", seed))


def distance(robot: int, pose: Pose2) -> float:
    return TEAM[robot].base.distance(pose)


def works(robot: int, pose: Pose2, within_m: float = 0.03) -> bool:
    """Whether a robot surely works there, written out."""
    reach, away = reach_of(TEAM[robot].arm), distance(robot, pose)
    return reach.inner_m + within_m <= away <= reach.travel_m - within_m


def cannot(robot: int, kind: ObjectKind, pose: Pose2, by_m: float = OUTSIDE_M) -> bool:
    """Whether a robot could do nothing there, written out."""
    could, away = could_of(TEAM[robot].arm), distance(robot, pose)
    put = could.place_m + (kind.support_m or 0.0)
    return away >= max(could.touch_m + kind.disc_m, put) + by_m


def sifts(zone: Zone, kind: ObjectKind, pose: Pose2) -> bool:
    return bool(zone.sift(kind, np.array([pose.x]), np.array([pose.y]))[0])


@given(ON_TABLE, KINDS)
def test_between_what_works_and_what_could_lies_a_wide_strip(
    pose: Pose2, kind: ObjectKind
) -> None:
    territory = Territory(TEAM)
    at = np.array([pose.x]), np.array([pose.y])
    for robot in (0, 1):
        inside, outside = works(robot, pose), cannot(robot, kind, pose)
        assert territory.works(robot, *at).tolist() == [inside]
        assert territory.cannot(robot, kind, *at).tolist() == [outside]
        assert not (inside and outside)
        if inside:
            # The bound of touch lies at least this far outside of the works-set.
            away = could_of(TEAM[robot].arm).touch_m - distance(robot, pose)
            assert away > 0.25


@given(ON_TABLE, KINDS)
def test_zones_say_who_could_do_what(pose: Pose2, kind: ObjectKind) -> None:
    table = placer()
    can = [works(robot, pose) for robot in (0, 1)]
    never = [cannot(robot, kind, pose) for robot in (0, 1)]
    far = [cannot(robot, kind, pose, REMOTE_M) for robot in (0, 1)]
    assert sifts(table.only(0), kind, pose) == (can[0] and far[1])
    assert sifts(table.only(1), kind, pose) == (can[1] and far[0])
    assert sifts(table.nobody(), kind, pose) == all(never)
    assert sifts(table.anywhere(), kind, pose) == all(
        a or b for a, b in zip(can, never, strict=True)
    )
    zones = (table.only(0), table.only(1), table.nobody())
    assert sum(sifts(zone, kind, pose) for zone in zones) < 2


@given(AROUND_TABLE, st.floats(-1.2, 1.0), st.floats(0.0, 0.3))
def test_on_the_table_is_on_one_of_its_tops(
    pose: Pose2, left: float, edge_m: float
) -> None:
    x, y = np.array([pose.x]), np.array([pose.y])
    whole, parted = Territory(TEAM), Territory(TEAM, (left, left + 0.2))
    rims = [TABLE_HALF_X_M - abs(pose.x), TABLE_HALF_Y_M - abs(pose.y)]
    gap = [abs(pose.x - left), abs(pose.x - left - 0.2)]
    # On the line itself, rounding decides.
    assume(all(abs(away - edge_m) > 1e-9 for away in (*rims, *gap)))
    on_table = min(rims) >= edge_m
    assert whole.on_table(x, y, edge_m).tolist() == [on_table]
    beside = not left < pose.x < left + 0.2 and min(*rims, *gap) >= edge_m
    assert parted.on_table(x, y, edge_m).tolist() == [beside]


@given(SEEDS)
@settings(max_examples=20)
def test_what_is_put_lies_in_its_zone_and_has_a_color_of_its_own(seed: int) -> None:
    table = placer(seed)
    names = [table.cube(table.only(0)), table.cube(table.only(1))]
    names += [table.pad(table.only(1)), table.pad(table.anywhere())]
    assert len(set(names)) == 4
    assert [placed.name for placed in table.objects] == names
    assert [name.rsplit("_", 1)[1] for name in names] == ["cube"] * 2 + ["pad"] * 2
    places = [placed.pose for placed in table.objects]
    owners = ((0, CUBE), (1, CUBE), (1, PAD))
    for (owner, kind), place in zip(owners, places, strict=False):
        assert works(owner, place, 0.03 - ROUNDED_M)
        assert cannot(1 - owner, kind, place, OUTSIDE_M - ROUNDED_M)
    for i, a in enumerate(places):
        for b in places[i + 1 :]:
            assert a.distance(b) >= 0.125


@given(SEEDS)
@example(1924)
@settings(max_examples=20)
def test_no_point_of_the_stick_is_another_robots(seed: int) -> None:
    for which in (0, 1):
        table = placer(seed)
        assert table.stick(which) == STICK
        pose = table.objects[0].pose
        assert works(which, grasp_on_stick(pose), 0.03 - ROUNDED_M)
        assert heading_from(TEAM[which].base, pose) <= LARGEST_HEADING_RAD
        half = STICK_SECTION_M / 2
        handle = [(HANDLE_LENGTH_M * k / 30, 0.0) for k in range(31)]
        tip = HOOK_LENGTH_M - half
        hook = [(HANDLE_LENGTH_M - half, tip * k / 10) for k in range(11)]
        for u, v in (*handle, *hook):
            at = pose @ Pose2(u, v)
            nearest = distance(1 - which, at) - half
            assert nearest > could_of(TEAM[1 - which].arm).touch_m + 0.02
            assert abs(at.x) < TABLE_HALF_X_M - 0.03
            assert abs(at.y) < TABLE_HALF_Y_M - 0.03


def test_robots_play_their_roles_in_either_order() -> None:
    orders = {placer(seed).order for seed in range(20)}
    assert orders == {(0, 1), (1, 0)}


def test_colors_come_in_another_order_each_time() -> None:
    def anywhere(pose: Pose2) -> bool:
        return True

    firsts = {placer(seed).cube(anywhere) for seed in range(60)}
    assert firsts == {f"{color}_cube" for color in OBJECT_COLORS}


def test_colors_run_out() -> None:
    table = placer()
    for _ in OBJECT_COLORS:
        assert table.has_colors("pad")
        table.pad(table.anywhere())
    assert not table.has_colors("pad")
    assert table.has_colors("cube")
    with pytest.raises(SamplingError, match="more than 5 pads"):
        table.pad(table.anywhere())


def test_a_zone_without_room_gives_the_attempt_up() -> None:
    table = placer()
    with pytest.raises(PlacementError):
        table.cube(lambda pose: False)
    assert table.objects == []


def test_a_stick_that_nobody_else_leaves_room_for_gives_the_attempt_up() -> None:
    """Both robots at one side reach the same places: none is one robot's alone."""
    twins = (TEAM[1], RobotPlacement("ur10", "red", Pose2(0.9, 0.05, math.pi)))
    with pytest.raises(PlacementError, match="stick"):
        placer(0, twins).stick(0)


def drag_of(table: ObjectPlacer, primitive: Primitive, by: int, to: int) -> bool:
    """Whether the stick brings the first thing on a table home."""
    pose = table.objects[0].pose
    discs = table.discs(but=table.objects[0].name)
    drag = find_drag(primitive, TEAM[by], TEAM[to], pose, discs, gap_m=table.gap_m)
    return drag is not None


@given(SEEDS)
@settings(max_examples=10)
def test_what_is_put_for_hooking_can_be_hooked_in_one_way_only(seed: int) -> None:
    table = placer(seed)
    robot, partner = table.order
    table.cube(table.tool_only(Primitive.HOOK, robot, partner))
    assert all(cannot(which, CUBE, table.objects[0].pose) for which in (0, 1))
    assert drag_of(table, Primitive.HOOK, robot, robot)
    assert not drag_of(table, Primitive.HOOK, partner, partner)
    assert not drag_of(table, Primitive.POKE, robot, partner)
    assert not drag_of(table, Primitive.POKE, partner, robot)


@given(SEEDS)
@settings(max_examples=10)
def test_what_one_alone_can_hook_is_farther_than_a_stick_from_the_other(
    seed: int,
) -> None:
    table = placer(seed)
    robot, partner = table.order
    table.cube(table.tool_only(Primitive.HOOK, robot, partner, alone=True))
    pose = table.objects[0].pose
    assert drag_of(table, Primitive.HOOK, robot, robot)
    assert cannot(robot, CUBE, pose)
    # Even held at its very end, at the farthest posture of any orientation.
    stick_m = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M)
    farthest = could_of(TEAM[partner].arm).place_m + stick_m
    assert distance(partner, pose) - CUBE.disc_m > farthest


def test_check_finds_what_was_put_in_the_way_later() -> None:
    table = placer(1)
    robot, partner = 1, 0
    cube_name = table.cube(table.tool_only(Primitive.HOOK, robot, partner))
    pad_name = table.pad(table.only(partner))
    goal = Goal.from_pairs(((cube_name, pad_name),))
    cube = table.objects[0].pose
    table.check(goal)
    base = TEAM[robot].base
    # A ring of pads around the cube leaves no way for the stick.
    colors = list(OBJECT_COLORS)
    for k, color in enumerate(colors):
        away = Pose2(cube.x, cube.y, math.tau * k / len(colors)) @ Pose2(0.11, 0.0)
        table.objects.append(ObjectPlacement("pad", color, away))
    assert base.distance(cube) > reach_of("ur10").grasp_m
    with pytest.raises(PlacementError, match="hook"):
        table.check(goal)


def straight_ahead(radius_m: float) -> Zone:
    """A place before the first robot, where the second alone works."""
    base = TEAM[0].base
    around = Zone.where(lambda pose: abs(base.distance(pose) - radius_m) < 0.01)
    return Zone(around.sift, around.check, barred=(0,))


@pytest.mark.parametrize(
    ("beyond_m", "spare", "ok"),
    [(0.05, False, True), (0.05, True, False), (0.40, True, True)],
)
def test_check_finds_a_tower_that_could_be_pushed(
    beyond_m: float, spare: bool, ok: bool
) -> None:
    far_m = could_of(TEAM[0].arm).touch_m + PAD.disc_m + beyond_m
    table = placer(3)
    goal = Goal.from_pairs(
        ((table.cube(table.only(0)), table.pad(straight_ahead(far_m))),)
    )
    if spare:
        table.cube(table.only(0))
    if ok:
        table.check(goal)
        return
    with pytest.raises(PlacementError, match="tower"):
        table.check(goal)


def test_a_spare_cube_of_the_other_robot_builds_no_tower() -> None:
    far_m = could_of(TEAM[0].arm).touch_m + PAD.disc_m + 0.05
    table = placer(3)
    goal = Goal.from_pairs(
        ((table.cube(table.only(0)), table.pad(straight_ahead(far_m))),)
    )
    table.cube(table.only(1))
    table.check(goal)


def test_discs_cover_bases_and_objects_but_not_the_stick() -> None:
    table = placer(2)
    cube = table.cube(table.only(0))
    table.stick(1)
    discs = table.discs()
    assert len(discs) == 3
    assert [(x, y) for x, y, _ in discs[:2]] == [robot.base.xy for robot in TEAM]
    assert discs[2][:2] == table.objects[0].pose.xy
    assert len(table.discs(but=cube)) == 2
