"""The board: zones by reach, places that fit, colors that run out."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lemma.core.errors import SamplingError
from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.robots.reach import reach_of
from lemma.scene.objects.entity import STICK
from lemma.scene.palette import OBJECT_COLORS
from lemma.scene.spec import ObjectPlacement, RobotPlacement
from lemma.tasks.drags import LARGEST_HEADING_RAD, grasp_on_stick, heading_from
from lemma.tasks.placement import Board, PlacementError
from lemma.tasks.subtask import Primitive

TEAM = (
    RobotPlacement("ur5", "red", Pose2(-0.9, 0.0, 0.0)),
    RobotPlacement("ur10", "white", Pose2(0.9, 0.0, math.pi)),
)
SEEDS = st.integers(0, 10_000)
ON_TABLE = st.builds(
    Pose2, st.floats(-1.5, 1.5), st.floats(-1.1, 1.1), st.floats(-math.pi, math.pi)
)


def board(seed: int = 0, team: tuple[RobotPlacement, ...] = TEAM) -> Board:
    return Board(team, stream("test", "board", seed))


def distance(robot: int, pose: Pose2) -> float:
    return TEAM[robot].base.distance(pose)


@given(ON_TABLE)
def test_between_reach_and_no_reach_lies_a_strip_that_is_neither(pose: Pose2) -> None:
    table = board()
    for robot, placed in enumerate(TEAM):
        reach, away = reach_of(placed.arm), distance(robot, pose)
        inside = reach.inner_m + 0.03 <= away <= reach.travel_m - 0.03
        assert table.reaches(robot, pose) == inside
        outside = away >= reach.grasp_m + 0.025 or away <= 0.5 * reach.inner_m - 0.025
        assert table.cannot(robot, pose) == outside
        assert not (inside and outside)


@given(ON_TABLE)
def test_zones_say_who_reaches(pose: Pose2) -> None:
    table = board()
    can = [table.reaches(robot, pose) for robot in (0, 1)]
    cannot = [table.cannot(robot, pose) for robot in (0, 1)]
    assert table.only(0)(pose) == (can[0] and cannot[1])
    assert table.only(1)(pose) == (can[1] and cannot[0])
    assert table.nobody()(pose) == all(cannot)
    assert table.anywhere()(pose) == all(
        a or b for a, b in zip(can, cannot, strict=True)
    )
    assert (
        sum(zone(pose) for zone in (table.only(0), table.only(1), table.nobody())) < 2
    )


@given(SEEDS)
@settings(max_examples=20)
def test_what_is_put_lies_in_its_zone_and_has_a_color_of_its_own(seed: int) -> None:
    table = board(seed)
    names = [table.cube(table.only(0)), table.cube(table.only(1))]
    names += [table.pad(table.only(1)), table.pad(table.anywhere())]
    assert len(set(names)) == 4
    assert [placed.name for placed in table.objects] == names
    assert [name.rsplit("_", 1)[1] for name in names] == ["cube"] * 2 + ["pad"] * 2
    places = [placed.pose for placed in table.objects]
    assert table.only(0)(places[0])
    assert table.only(1)(places[1])
    assert table.only(1)(places[2])
    for i, a in enumerate(places):
        for b in places[i + 1 :]:
            assert a.distance(b) >= 0.125


@given(SEEDS)
@settings(max_examples=20)
def test_the_stick_lies_where_one_robot_can_swing_it_out(seed: int) -> None:
    table = board(seed)
    for which in table.order:
        fresh = board(seed)
        assert fresh.stick(which) == STICK
        pose = fresh.objects[0].pose
        assert fresh.only(which)(grasp_on_stick(pose))
        assert heading_from(TEAM[which].base, pose) <= LARGEST_HEADING_RAD


def test_robots_play_their_roles_in_either_order() -> None:
    orders = {board(seed).order for seed in range(20)}
    assert orders == {(0, 1), (1, 0)}


def test_colors_come_in_another_order_each_time() -> None:
    def anywhere(pose: Pose2) -> bool:
        return True

    firsts = {board(seed).cube(anywhere) for seed in range(60)}
    assert firsts == {f"{color}_cube" for color in OBJECT_COLORS}


def test_colors_run_out() -> None:
    table = board()
    for _ in OBJECT_COLORS:
        assert table.has_colors("pad")
        table.pad(table.anywhere())
    assert not table.has_colors("pad")
    assert table.has_colors("cube")
    with pytest.raises(SamplingError, match="more than 5 pads"):
        table.pad(table.anywhere())


def test_a_zone_without_room_gives_the_attempt_up() -> None:
    table = board()
    with pytest.raises(PlacementError):
        table.cube(lambda pose: False)
    assert table.objects == []


def test_a_stick_that_nobody_else_leaves_room_for_gives_the_attempt_up() -> None:
    """Both robots at one side reach the same places: none is one robot's alone."""
    twins = (TEAM[1], RobotPlacement("ur10", "red", Pose2(0.9, 0.05, math.pi)))
    with pytest.raises(PlacementError, match="stick"):
        board(0, twins).stick(0)


@given(SEEDS)
@settings(max_examples=10)
def test_what_is_put_for_hooking_can_be_hooked_in_one_way_only(seed: int) -> None:
    table = board(seed)
    robot, partner = table.order
    try:
        table.cube(table.tool_only(Primitive.HOOK, robot, partner))
    except PlacementError:
        return  # This team cannot; another attempt would have another.
    pose = table.objects[0].pose
    discs = table.discs(but=table.objects[0].name)
    assert table.nobody()(pose)
    assert table.can_drag(Primitive.HOOK, robot, robot, pose, discs)
    assert not table.can_drag(Primitive.HOOK, partner, partner, pose, discs)
    assert not table.can_drag(Primitive.POKE, robot, partner, pose, discs)
    assert not table.can_drag(Primitive.POKE, partner, robot, pose, discs)


def test_check_finds_what_was_put_in_the_way_later() -> None:
    table = board(1)
    robot, partner = 1, 0
    table.cube(table.tool_only(Primitive.HOOK, robot, partner))
    cube = table.objects[0].pose
    table.check()
    base = TEAM[robot].base
    # A ring of pads around the cube leaves no way for the stick.
    colors = list(OBJECT_COLORS)
    for k, color in enumerate(colors):
        away = Pose2(cube.x, cube.y, math.tau * k / len(colors)) @ Pose2(0.11, 0.0)
        table.objects.append(ObjectPlacement("pad", color, away))
    assert base.distance(cube) > reach_of("ur10").grasp_m
    with pytest.raises(PlacementError, match="hook"):
        table.check()


def test_discs_cover_bases_and_objects_but_not_the_stick() -> None:
    table = board(2)
    cube = table.cube(table.only(0))
    table.stick(1)
    discs = table.discs()
    assert len(discs) == 3
    assert [(x, y) for x, y, _ in discs[:2]] == [robot.base.xy for robot in TEAM]
    assert discs[2][:2] == table.objects[0].pose.xy
    assert len(table.discs(but=cube)) == 2
