"""Where the stick must be to drag a cube: geometry that obeys its own promises."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from lemma.core.poses import Pose2, wrap
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.objects.cube import CUBE, CUBE_EDGE_M
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M, STICK_SECTION_M
from lemma.scene.spec import RobotPlacement
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M, Gap
from lemma.tasks.drags import (
    MAX_DRAG_M,
    MIN_DRAG_M,
    Disc,
    Drag,
    find_drag,
    grasp_on_stick,
    heading_from,
    is_prepared,
    stick_discs,
    stick_gap,
    stick_in_grasp,
    withdrawn,
)
from lemma.tasks.subtask import Primitive

BASE = Pose2(-0.9, 0.05, 0.1)
DRAGS = (Primitive.HOOK, Primitive.POKE)
arms = st.sampled_from(["ur5", "ur10"])
drags = st.sampled_from(DRAGS)
poses = st.builds(
    Pose2, st.floats(-1.5, 1.5), st.floats(-1.1, 1.1), st.floats(-math.pi, math.pi)
)
discs = st.lists(
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.03, 0.07)), max_size=4
)


def near(a: Pose2, b: Pose2, tolerance: float = 1e-9) -> bool:
    return a.distance(b) < tolerance and abs(wrap(a.yaw - b.yaw)) < tolerance


def robot(arm: str) -> RobotPlacement:
    """The robot that drags; its base has room ahead for the longest drags."""
    return RobotPlacement(arm, "red", BASE)


def receiver(primitive: Primitive, arm: str) -> RobotPlacement:
    """The robot whose reach the cube shall come into.

    A partner stands so far away that a cube fits between them that neither could touch.
    """
    if primitive is Primitive.HOOK:
        return robot(arm)
    apart = 2.0 * could_of(arm).touch_m + 0.15
    return RobotPlacement(arm, "white", BASE @ Pose2(apart, 0.0, math.pi))


def cube_beyond(arm: str, beyond_m: float, bearing: float, yaw: float) -> Pose2:
    """A cube so far out of the arm's grasp, in a direction."""
    away = reach_of(arm).grasp_m + beyond_m
    return BASE @ Pose2(away * math.cos(bearing), away * math.sin(bearing), yaw)


def find(
    primitive: Primitive,
    arm: str,
    cube: Pose2,
    obstacles: list[Disc] | None = None,
    gap_m: Gap | None = None,
) -> Drag | None:
    return find_drag(
        primitive,
        robot(arm),
        receiver(primitive, arm),
        cube,
        obstacles or [],
        gap_m=gap_m,
    )


@given(poses)
def test_grasp_and_stick_are_each_others_inverse(pose: Pose2) -> None:
    assert near(stick_in_grasp(grasp_on_stick(pose)), pose)
    assert near(grasp_on_stick(stick_in_grasp(pose)), pose)
    assert grasp_on_stick(pose).distance(pose) == pytest.approx(0.05)


@given(poses, poses)
def test_heading_is_seen_from_the_base(base: Pose2, stick: Pose2) -> None:
    grasp = grasp_on_stick(stick)
    heading = heading_from(base, stick)
    assert 0.0 <= heading <= math.pi
    ahead = grasp @ Pose2(1e-4, 0.0)
    if base.distance(grasp) > 0.05:
        closer = base.distance(grasp) - base.distance(ahead)
        assert closer == pytest.approx(-1e-4 * math.cos(heading), abs=1e-6)


# --- Distance to the stick ---------------------------------------------------------


@given(poses, st.floats(-0.3, 1.05), st.floats(-0.4, 0.5))
def test_gap_is_the_distance_to_the_nearest_point_of_handle_and_hook(
    stick: Pose2, u: float, v: float
) -> None:
    at = stick @ Pose2(u, v)
    bar, end = (
        HANDLE_LENGTH_M - STICK_SECTION_M / 2,
        HOOK_LENGTH_M - STICK_SECTION_M / 2,
    )
    handle = [math.hypot(u - HANDLE_LENGTH_M * k / 1500, v) for k in range(1501)]
    hook = [math.hypot(u - bar, v - end * k / 1000) for k in range(1001)]
    found = stick_gap(stick, at.x, at.y)
    assert found == pytest.approx(min(handle + hook), abs=3e-4)


@given(poses, poses, poses)
def test_gap_moves_with_the_table(frame: Pose2, stick: Pose2, at: Pose2) -> None:
    moved = frame @ at
    assert stick_gap(frame @ stick, moved.x, moved.y) == pytest.approx(
        stick_gap(stick, at.x, at.y), abs=1e-9
    )


@given(poses)
def test_discs_cover_the_stick(stick: Pose2) -> None:
    found = stick_discs(stick)
    for x, y, radius in found:
        assert stick_gap(stick, x, y) <= 0.5 * STICK_SECTION_M + 1e-9
        assert radius == pytest.approx(STICK_SECTION_M / 2)
    for k in range(51):
        for at in (
            Pose2(HANDLE_LENGTH_M * k / 50, 0.0),
            Pose2(HANDLE_LENGTH_M - 0.015, (HOOK_LENGTH_M - 0.015) * k / 50),
        ):
            point = stick @ at
            assert any(
                math.hypot(x - point.x, y - point.y) <= 0.03 for x, y, _ in found
            )


# --- Drags -------------------------------------------------------------------------


@given(
    drags, arms, st.floats(0.03, 0.40), st.floats(-1.0, 1.0), st.floats(-3, 3), discs
)
def test_a_drag_keeps_margins_and_clearances(
    primitive: Primitive,
    arm: str,
    beyond: float,
    bearing: float,
    yaw: float,
    obstacles: list[Disc],
) -> None:
    cube = cube_beyond(arm, beyond, bearing, yaw)
    drag = find(primitive, arm, cube, obstacles)
    assume(drag is not None)
    assert drag is not None
    reach, goal = reach_of(arm), receiver(primitive, arm).base
    assert drag.primitive is primitive
    # The hand picks the stick up and leaves it where it surely works, and moves it
    # where it surely holds it; the cube ends well inside reach.
    for grip in (drag.prepared, drag.left):
        assert reach.margin(BASE, grip.x, grip.y) >= 0.015 - 1e-9
    for k in range(11):
        at = drag.prepared.inverse() @ drag.end
        grip = drag.prepared @ Pose2(at.x * k / 10, at.y * k / 10)
        assert reach.hold_margin(BASE, grip.x, grip.y) >= 0.015 - 1e-9
    assert reach.margin(goal, drag.cube.x, drag.cube.y) >= 0.05 - 1e-9
    # The hand goes straight along the stick, as far as the cube and the gap before it.
    assert drag.prepared.yaw == drag.end.yaw
    way = drag.prepared.inverse() @ drag.end
    sign = 1.0 if primitive is Primitive.POKE else -1.0
    assert way.y == pytest.approx(0.0, abs=1e-9)
    travelled = cube.distance(drag.cube)
    assert MIN_DRAG_M - 1e-9 <= travelled <= MAX_DRAG_M + 1e-9
    assert sign * way.x == pytest.approx(travelled + 0.02)
    # The stick is left off the cube: a hook beyond it, a head before it.
    off = drag.end.inverse() @ drag.left
    assert off.y == pytest.approx(0.0, abs=1e-9)
    assert 0.03 - 1e-9 <= -sign * off.x <= 0.15 + 1e-9
    # A cube is never off the table.
    for at in (cube, drag.cube):
        assert abs(at.x) < TABLE_HALF_X_M
        assert abs(at.y) < TABLE_HALF_Y_M
    # Nothing is met at the six places of the way that are looked at.
    for k in range(6):
        t = k / 5
        stick = stick_in_grasp(drag.prepared @ Pose2(t * way.x, 0.0))
        x = cube.x + t * (drag.cube.x - cube.x)
        y = cube.y + t * (drag.cube.y - cube.y)
        for ox, oy, radius in obstacles:
            assert stick_gap(stick, ox, oy) > radius + STICK_SECTION_M / 2 + 0.0119
            assert math.hypot(ox - x, oy - y) > radius + CUBE.disc_m + 0.0099


@given(drags, arms, st.floats(0.03, 0.35), st.floats(-0.6, 0.6))
def test_a_prepared_stick_lies_next_to_the_cube(
    primitive: Primitive, arm: str, beyond: float, bearing: float
) -> None:
    cube = cube_beyond(arm, beyond, bearing, 0.3)
    drag = find(primitive, arm, cube)
    assume(drag is not None)
    assert drag is not None
    stick = stick_in_grasp(drag.prepared)
    assert is_prepared(primitive, stick, cube)
    (other,) = set(DRAGS) - {primitive}
    assert not is_prepared(other, stick, cube)
    # A cube turned by 45 degrees still fits between hook and handle.
    clear = stick_gap(stick, cube.x, cube.y) - STICK_SECTION_M / 2
    assert clear > CUBE_EDGE_M / math.sqrt(2)
    # At the end the stick touches the cube, whose faces are along it.
    end = stick_in_grasp(drag.end)
    assert stick_gap(end, drag.cube.x, drag.cube.y) == pytest.approx(
        (CUBE_EDGE_M + STICK_SECTION_M) / 2
    )


@pytest.mark.parametrize("primitive", DRAGS)
@pytest.mark.parametrize("arm", ["ur5", "ur10"])
def test_there_is_a_drag_straight_ahead(primitive: Primitive, arm: str) -> None:
    """Where neither could touch the cube, either of them drags it home or across."""
    out = could_of(arm).touch_m + 0.07 - reach_of(arm).grasp_m
    drag = find(primitive, arm, cube_beyond(arm, out, 0.0, 0.0))
    assert drag is not None
    # So far from what anyone could touch to where one surely works.
    assert drag.cube.distance(cube_beyond(arm, out, 0.0, 0.0)) > 0.3


@pytest.mark.parametrize("primitive", DRAGS)
def test_there_is_none_where_the_stick_is_too_short(primitive: Primitive) -> None:
    assert find(primitive, "ur5", cube_beyond("ur5", 0.75, 0.0, 0.0)) is None


def test_there_is_none_through_a_wall() -> None:
    cube = cube_beyond("ur5", 0.1, 0.0, 0.0)
    assert find(Primitive.HOOK, "ur5", cube) is not None
    middle = BASE @ Pose2(reach_of("ur5").travel_m - 0.1, 0.0, 0.0)
    wall = [(middle @ Pose2(0.0, y)) for y in (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)]
    discs = [(pose.x, pose.y, 0.05) for pose in wall]
    assert find(Primitive.HOOK, "ur5", cube, discs) is None


@pytest.mark.parametrize("arm", ["ur5", "ur10"])
def test_nothing_is_dragged_across_a_gap(arm: str) -> None:
    """A cube that is pulled over the edge falls; one beyond it is pushed away."""
    out = could_of(arm).touch_m + 0.07 - reach_of(arm).grasp_m
    cube = cube_beyond(arm, out, 0.0, 0.0)
    before = (cube.x - 0.25, cube.x - 0.05)
    assert find(Primitive.HOOK, arm, cube, gap_m=before) is None
    across = find(Primitive.POKE, arm, cube, gap_m=before)
    assert across == find(Primitive.POKE, arm, cube)
    behind = (cube.x + 0.05, cube.x + 0.25)
    assert find(Primitive.POKE, arm, cube, gap_m=behind) is None
    assert find(Primitive.HOOK, arm, cube, gap_m=behind) is not None


def test_nothing_is_dragged_off_the_table() -> None:
    """The same drag, with the table's edge in the way."""
    at = RobotPlacement("ur5", "red", Pose2(0.0, TABLE_HALF_Y_M - 0.6, math.pi / 2))
    on = RobotPlacement("ur5", "red", Pose2(0.0, 0.2, math.pi / 2))
    for placed in (at, on):
        cube = placed.base @ Pose2(0.5, 0.2)
        to = RobotPlacement("ur5", "white", placed.base @ Pose2(1.4, 0.2, math.pi))
        drag = find_drag(Primitive.POKE, placed, to, cube, [])
        assert (drag is None) == (placed is at)


@given(
    drags, arms, st.floats(0.3, 1.4), st.floats(-math.pi, math.pi), st.floats(-0.5, 0.5)
)
def test_a_stick_is_withdrawn_to_where_it_can_be_picked_up_again(
    primitive: Primitive, arm: str, away: float, bearing: float, turn: float
) -> None:
    end = BASE @ Pose2(0.0, 0.0, bearing) @ Pose2(away, 0.0, turn)
    left = withdrawn(primitive, robot(arm), end)
    off = end.inverse() @ left
    assert off.y == pytest.approx(0.0, abs=1e-9)
    back = off.x if primitive is Primitive.HOOK else -off.x
    reach = reach_of(arm)
    if primitive is Primitive.HOOK:
        assert back == pytest.approx(0.03)
    elif reach.margin(BASE, left.x, left.y) < 0.015:
        assert back >= 0.15 - 1e-9  # As far as it goes, and still out of reach.
    elif back > 0.03 + 1e-9:
        nearer = end @ Pose2(0.01 - back, 0.0)
        assert reach.margin(BASE, nearer.x, nearer.y) < 0.015


def aim_of(drag: Drag, cube: Pose2, receiver: Pose2) -> tuple[float, float]:
    """How far aside of the receiver's base a cube is led [rad], and how far [m]."""
    ahead = math.atan2(cube.y - receiver.y, cube.x - receiver.x)
    if drag.primitive is Primitive.POKE:
        ahead += math.pi
    return wrap(drag.cube.yaw - ahead), cube.distance(drag.cube)


QUARTERS = [Pose2(0.0, 0.0, quarter * math.pi / 2) for quarter in (1, 2, 3)]


@given(
    drags,
    arms,
    st.floats(0.03, 0.35),
    st.floats(-0.6, 0.6),
    discs,
    st.sampled_from(QUARTERS),
)
def test_turning_everything_turns_the_drag(
    primitive: Primitive,
    arm: str,
    beyond: float,
    bearing: float,
    obstacles: list[Disc],
    turn: Pose2,
) -> None:
    """The table is a square: quarters of a turn about its middle change nothing."""
    cube = cube_beyond(arm, beyond, bearing, 0.3)
    drag = find(primitive, arm, cube, obstacles)
    to = receiver(primitive, arm)
    moved = find_drag(
        primitive,
        RobotPlacement(arm, "red", turn @ BASE),
        RobotPlacement(arm, "red", turn @ to.base),
        turn @ cube,
        [(*(turn @ Pose2(x, y)).xy, radius) for x, y, radius in obstacles],
    )
    assert (moved is None) == (drag is None)
    if drag is None or moved is None:
        return
    assert moved.score == pytest.approx(drag.score, abs=1e-6)
    aside, length = aim_of(drag, cube, to.base)
    other_aside, other_length = aim_of(moved, turn @ cube, turn @ to.base)
    assert other_length == pytest.approx(length)
    assert abs(other_aside) == pytest.approx(abs(aside), abs=1e-9)
    if other_aside * aside < -1e-9:
        # The same angle to the other side, and as deep: rounding chooses, but only
        # where the depth counts in full.
        assert drag.score + 0.15 * length + 0.03 * abs(aside) < 0.10
        return
    assert near(moved.cube, turn @ drag.cube, 1e-6)
    assert near(moved.prepared, turn @ drag.prepared, 1e-6)
    assert near(moved.end, turn @ drag.end, 1e-6)
    assert near(moved.left, turn @ drag.left, 1e-6)


@given(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06), drags)
def test_prepared_has_a_tolerance(du: float, dv: float, primitive: Primitive) -> None:
    cube = cube_beyond("ur10", 0.25, 0.0, 0.0)
    drag = find(primitive, "ur10", cube)
    assert drag is not None
    stick = stick_in_grasp(drag.prepared)
    slipped = Pose2(cube.x, cube.y, stick.yaw) @ Pose2(du, dv)
    inside = max(abs(du), abs(dv)) < 0.025
    if abs(max(abs(du), abs(dv)) - 0.025) > 1e-6:
        assert is_prepared(primitive, stick, slipped) == inside
