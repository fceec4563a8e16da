"""Elementary motions: they arrive, go straight where they must, and give up."""

import math

import numpy as np
import pytest
from small_tables import ARM_NAMES, cube, facing
from tiers import slow_but

from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.env.simulation import Simulation
from lemma.motion.moves import FLY_BY_M, Motion, Moves, Stand
from lemma.motion.outcome import Outcome, SkillFailure
from lemma.robots.reach import reach_of
from lemma.robots.ur.kinematics import top_down

ROBOT = "robot_0"
HERE = (-0.1, 0.15)


@pytest.fixture(params=slow_but(ARM_NAMES, "ur5"))
def simulation(request: pytest.FixtureRequest) -> Simulation:
    return Simulation(facing(request.param, cube("red", *HERE, 0.3)))


@pytest.fixture
def moves(simulation: Simulation) -> Moves:
    return Moves(simulation.arms[ROBOT])


def drive(simulation: Simulation, motion: Motion) -> FloatArray:
    """Carry a motion out; return where the tool centre point went, (n, 3)."""
    arm = simulation.arms[ROBOT]
    passed = [arm.tcp_pose()[:3, 3]]
    for _ in motion:
        simulation.tick((ROBOT,))
        passed.append(arm.tcp_pose()[:3, 3])
    return np.array(passed)


def stand_of(simulation: Simulation) -> tuple[float, float, float, float]:
    pose = simulation.arms[ROBOT].tcp_pose()
    x, y, z = (float(v) for v in pose[:3, 3])
    return x, y, z, math.atan2(pose[1, 0], pose[0, 0])


def off(simulation: Simulation, stand: Stand) -> tuple[float, float]:
    found = stand_of(simulation)
    return math.dist(found[:3], stand[:3]), abs(wrap(found[3] - stand[3]))


def test_to_fly_by_ends_sooner_and_near(simulation: Simulation, moves: Moves) -> None:
    kept = simulation.snapshot()
    stand = (-0.05, -0.2, 0.25, 0.8)
    exact = len(drive(simulation, moves.to(stand)))
    simulation.restore(kept)
    near = len(drive(simulation, moves.to(stand, fly_by=True)))
    assert near < exact
    assert off(simulation, stand)[0] < FLY_BY_M


def test_to_where_the_arm_cannot_be_fails_at_once(
    simulation: Simulation, moves: Moves
) -> None:
    arm = simulation.arms[ROBOT].robot
    far = arm.placement.base @ Pose2(reach_of(arm.arm.name).travel_m + 0.03, 0.0)
    stand = (far.x, far.y, 0.3, 0.0)
    for motion in (moves.to(stand), moves.to(stand, fly_by=True)):
        with pytest.raises(SkillFailure, match="robot_0 cannot reach") as caught:
            next(motion)
        assert caught.value.outcome is Outcome.UNREACHABLE
    with pytest.raises(SkillFailure, match="cannot reach the pick position"):
        moves.check_reach(stand, "pick")
    moves.check_reach((*HERE, 0.3, 0.0), "pick")


def test_along_is_straight_and_as_fast_as_told(
    simulation: Simulation, moves: Moves
) -> None:
    start, end = (-0.15, 0.2, 0.2, 0.2), (0.0, -0.1, 0.12, 0.6)
    drive(simulation, moves.to(start))
    begin = simulation.time_s
    passed = drive(simulation, moves.along(start, end, 0.2))
    length = math.dist(start[:3], end[:3])
    assert simulation.time_s - begin == pytest.approx(length / 0.2, abs=0.02)
    a, b = np.array(start[:3]), np.array(end[:3])
    way = (b - a) / length
    aside = (passed - a) - np.outer((passed - a) @ way, way)
    assert float(np.sqrt((aside**2).sum(axis=1)).max()) < 0.008
    # It follows closely behind, and arrives when asked to.
    drive(simulation, moves.to(end))
    distance, angle = off(simulation, end)
    assert distance < 0.002
    assert angle < 0.02


def test_what_is_put_down_touches_softly(simulation: Simulation, moves: Moves) -> None:
    over, low = (-0.1, -0.1, 0.3, 0.0), (-0.1, -0.1, 0.04, 0.0)
    drive(simulation, moves.to(over))
    passed = drive(simulation, moves.lower(low, contact=True))
    last = passed[passed[:, 2] < low[2] + 0.006]
    speeds = np.diff(last[:, 2]) / 0.01
    assert np.abs(speeds).max() < 0.12


def test_a_grasp_of_air_fails(simulation: Simulation, moves: Moves) -> None:
    with pytest.raises(SkillFailure) as caught:
        drive(simulation, moves.grasp((0.0, -0.2, 0.3, 0.0), (0.0, -0.2, 0.1, 0.0)))
    assert caught.value.outcome is Outcome.MISSED_GRASP
    with pytest.raises(SkillFailure) as caught:
        moves.check_held()
    assert caught.value.outcome is Outcome.DROPPED


def test_fingers_are_waited_for_but_not_longer_than_needed(
    simulation: Simulation, moves: Moves
) -> None:
    moves.arm.opening_m = 0.0
    moves.arm.hold()
    ticks = len(drive(simulation, moves.wait_for_fingers()))
    assert 40 < ticks < 90
    assert simulation.scene.opening_m(moves.arm.robot) < 0.002
    # Nothing changes: they are still at once.
    assert len(drive(simulation, moves.wait_for_fingers())) < 12


def test_a_stalled_arm_falls_back_on_a_joint_path(
    simulation: Simulation, moves: Moves
) -> None:
    """RMPflow without a target weight goes nowhere: the other planner takes over."""
    stand = (-0.05, -0.2, 0.25, 0.8)
    pose = top_down(*stand)
    drive(simulation, moves.fall_back(pose))
    distance, angle = off(simulation, stand)
    assert distance < 0.005
    assert angle < 0.02


def test_no_way_at_all_is_a_collision(simulation: Simulation, moves: Moves) -> None:
    x, y, z = -0.05, -0.2, 0.25
    moves.arm.set_obstacles(np.array([[x, y, z, x, y, z, 0.1, 0.15]]))
    with pytest.raises(SkillFailure, match="robot_0 is blocked") as caught:
        next(moves.fall_back(top_down(x, y, z, 0.0)))
    assert caught.value.outcome is Outcome.COLLISION


def test_an_arm_that_is_held_back_notices(simulation: Simulation, moves: Moves) -> None:
    moves.check_tracking()
    moves.arm.state[0, 1] += 0.13
    with pytest.raises(SkillFailure, match="robot_0 was stopped") as caught:
        moves.check_tracking()
    assert caught.value.outcome is Outcome.COLLISION


def test_a_fast_arm_may_lag_behind_its_reference(
    simulation: Simulation, moves: Moves
) -> None:
    arm = moves.arm
    arm.state[1, 0] = 2.0
    arm.state[0, 0] += 0.12 + 0.9 * arm.robot.arm.lag_s * 2.0
    moves.check_tracking()
    arm.state[1, 0] = 0.0
    with pytest.raises(SkillFailure):
        moves.check_tracking()


@pytest.mark.parametrize("z", [0.05, 0.4])
def test_giving_up_opens_rises_and_parks(
    simulation: Simulation, moves: Moves, z: float
) -> None:
    drive(simulation, moves.to((*HERE, 0.3, 0.3)))
    if z < 0.1:
        drive(simulation, moves.grasp((*HERE, 0.3, 0.3), (*HERE, 0.025, 0.3)))
        drive(simulation, moves.rise((*HERE, 0.025, 0.3), 0.06))
        assert simulation.held()
    else:
        drive(simulation, moves.to((*HERE, z, 0.3)))
    drive(simulation, moves.give_up())
    assert simulation.held() == {}
    assert stand_of(simulation)[2] > 0.26
    drive(simulation, moves.park())
    joints = simulation.scene.data.qpos[moves.arm.robot.qpos]
    assert np.abs(joints - moves.arm.park).max() < 0.06
