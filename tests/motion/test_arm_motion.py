"""One arm in a scene: where it waits, how it solves, and the paths it falls back on."""

import math

import mujoco
import numpy as np
import pytest

from lemma.core.poses import FloatArray, Pose2
from lemma.motion.arm_motion import ArmMotion, nearest_turn, park_joints
from lemma.motion.moves import joint_path
from lemma.motion.obstacles import Obstacles
from lemma.robots.collision_model import (
    obstacle_clearance,
    self_clearance,
    table_clearance,
)
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import reach_of
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.kinematics import frames, top_down
from lemma.scene.build import TIME_STEP_S
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec

ARM_NAMES = ("ur5", "ur10")
NOTHING: FloatArray = np.zeros((0, 8))


@pytest.fixture(params=ARM_NAMES)
def arms(request: pytest.FixtureRequest) -> dict[str, ArmMotion]:
    """Two arms of one type that face each other, parked, and a cube between them."""
    distance = 0.85 * reach_of(request.param).travel_m
    scene = Scene(
        SceneSpec(
            (
                RobotPlacement(request.param, "red", Pose2(-distance, 0.0, 0.0)),
                RobotPlacement(request.param, "white", Pose2(distance, 0.1, math.pi)),
            ),
            (ObjectPlacement("cube", "green", Pose2(-0.1, -0.2, 0.3)),),
        )
    )
    result = {robot.name: ArmMotion(scene, robot) for robot in scene.robots}
    for arm in result.values():
        scene.set_joints(arm.robot, arm.park, FINGER_OPENING_M)
        arm.sync()
    return result


@pytest.fixture
def arm(arms: dict[str, ArmMotion]) -> ArmMotion:
    return arms["robot_0"]


def in_front(arm: ArmMotion, radius: float, bearing: float, z: float) -> FloatArray:
    """Return a pose of the gripper, by distance and direction from the arm's base."""
    base = arm.robot.placement.base
    reach = radius * reach_of(arm.robot.arm.name).travel_m
    place = base @ Pose2(reach * math.cos(bearing), reach * math.sin(bearing), 0.3)
    pose: FloatArray = top_down(place.x, place.y, z, place.yaw)
    return pose


def link_frames(name: str, q: FloatArray) -> FloatArray:
    out = np.empty((7, 4, 4))
    frames(ARMS[name].dh, np.eye(4), q, out)
    return out


def run(arm: ArmMotion, seconds: float) -> FloatArray:
    """Advance the reference without physics; return the joints it passed, (n, 6)."""
    passed, commands = [], np.zeros((1, arm.scene.model.nu))
    for _ in range(round(seconds / TIME_STEP_S)):
        arm.lead(commands)
        passed.append(arm.state[0].copy())
    return np.array(passed)


@pytest.mark.parametrize("name", ARM_NAMES)
def test_parks_folded_beside_its_base(name: str) -> None:
    placed = link_frames(name, np.array(park_joints(name)))
    shoulder, elbow, wrist = placed[1:4, 2, 3]
    assert elbow > 0.5 * (shoulder + wrist)
    flange = placed[6]
    assert flange[:3, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-9)
    radius = math.hypot(flange[0, 3], flange[1, 3])
    assert 0.3 < radius / reach_of(name).travel_m < 0.6
    assert flange[1, 3] > 0.0  # at the robot's left
    assert flange[0, 3] < 0.0  # and behind it, so out of its camera's view
    assert (np.abs(park_joints(name)) <= ARMS[name].joint_range).all()


def test_parked_arms_touch_nothing(arms: dict[str, ArmMotion]) -> None:
    for arm in arms.values():
        capsules = arm.capsules()
        assert self_clearance(capsules) > 0.01
        assert table_clearance(capsules) > 0.01
        others = Obstacles(arms).around(arm.robot.name, None, None)
        assert obstacle_clearance(capsules, others) > 0.05
    scene = arms["robot_0"].scene
    mujoco.mj_forward(scene.model, scene.data)
    touching = {
        scene.model.geom(geom).name
        for contact in scene.data.contact[: scene.data.ncon]
        for geom in contact.geom
    }
    assert touching <= {"green_cube", "table"}


def test_nearest_turn_adds_whole_turns_inside_the_limits() -> None:
    limit = np.array([math.tau, math.tau, math.pi, math.tau, math.tau, math.tau])
    angles = np.array([-3.0, 3.0, -3.0, 0.2, 0.5, -0.5])
    nearest_turn(angles, np.array([3.2, -3.2, 3.0, 0.0, 6.2, -6.2]), limit)
    expected = [
        -3.0 + math.tau,
        3.0 - math.tau,
        -3.0,  # one turn more is past the elbow's end
        0.2,
        0.5,  # one turn more is past the joint's end
        -0.5,
    ]
    assert angles == pytest.approx(expected)


def test_solve_posture_reaches_the_pose_on_the_branch_of_waiting(
    arm: ArmMotion,
) -> None:
    for radius, bearing in ((0.9, 0.0), (0.5, -0.8), (0.6, 1.5)):
        pose = in_front(arm, radius, bearing, 0.2)
        q = arm.solve_posture(pose)
        assert q is not None
        arm.state[0] = q
        assert arm.reference_pose() == pytest.approx(pose, abs=1e-9)
        placed = link_frames(arm.robot.arm.name, q)
        assert placed[2, 2, 3] > 0.5 * (placed[1, 2, 3] + placed[3, 2, 3])
        assert math.sin(q[4]) * math.sin(arm.park[4]) > 0


def test_solve_posture_takes_the_turn_nearest_to_the_reference(arm: ArmMotion) -> None:
    pose = in_front(arm, 0.6, 0.2, 0.2)
    q = arm.solve_posture(pose)
    assert q is not None
    for joint in (0, 5):
        turn = -math.copysign(math.tau, q[joint]) * np.eye(6)[joint]
        arm.state[0] = q + turn
        assert arm.solve_posture(pose) == pytest.approx(q + turn, abs=1e-9)


def test_solve_posture_knows_what_is_out_of_reach(arm: ArmMotion) -> None:
    assert arm.solve_posture(in_front(arm, 1.02, 0.0, 0.3)) is None
    assert arm.solve_posture(in_front(arm, 0.98, 0.0, 0.3)) is not None
    assert arm.solve_posture(in_front(arm, 0.05, 0.0, 0.3)) is None
    assert arm.solve_posture(in_front(arm, 0.5, 0.0, -0.5)) is None


def test_lead_moves_the_reference_and_leads_the_servos(arm: ArmMotion) -> None:
    before = arm.state[0].copy()
    pose = in_front(arm, 0.7, 0.5, 0.25)
    posture = arm.solve_posture(pose)
    assert posture is not None
    arm.follow_posture(posture)
    run(arm, 0.3)
    assert np.abs(arm.state[0] - before).max() > 0.05
    commands = np.full((2, arm.scene.model.nu), -1.0)
    arm.lead(commands)
    expected = arm.state[0] + arm.robot.arm.lag_s * arm.state[1]
    assert commands[1, arm.robot.ctrl] == pytest.approx(expected, abs=1e-12)
    assert (commands[:, arm.robot.gripper_ctrl] == arm.opening_m).all()
    # Commands of the other arm's servos are not touched.
    assert (commands == -1.0).sum() == 2 * 7
    run(arm, 4.0)
    arm.aim(pose, posture)
    run(arm, 3.0)
    assert arm.reference_pose() == pytest.approx(pose, abs=1e-3)
    # The measured arm has not moved: nobody stepped the physics.
    assert np.array_equal(arm.scene.data.qpos[arm.robot.qpos], before)
    arm.sync()
    assert np.array_equal(arm.state, [before, np.zeros(6)])


def check_path(
    arm: ArmMotion, path: FloatArray, pose: FloatArray, obstacles: FloatArray
) -> None:
    """Check that a path is slow, free and ends at the pose."""
    start = arm.state[0].copy()
    steps = np.abs(np.diff(np.concatenate([start[None], path]), axis=0))
    assert (steps <= 0.01 * np.array(arm.robot.arm.velocity_limits)).all()
    for q in path:
        capsules = arm.capsules(q)
        assert self_clearance(capsules) > 0.0
        assert table_clearance(capsules) > 0.0
        assert obstacle_clearance(capsules, obstacles) > 0.0
    arm.state[0] = path[-1]
    assert arm.reference_pose() == pytest.approx(pose, abs=1e-9)
    arm.state[0] = start


def test_joint_path_goes_straight_where_nothing_is_in_the_way(arm: ArmMotion) -> None:
    pose = in_front(arm, 0.7, 0.3, 0.2)
    path = joint_path(arm, pose, NOTHING)
    assert path is not None
    check_path(arm, path, pose, NOTHING)
    # A straight line: every configuration divides start to end in one proportion.
    way = path[-1] - arm.state[0]
    share = (path - arm.state[0])[:, 0] / way[0]
    assert path == pytest.approx(arm.state[0] + share[:, None] * way, abs=1e-9)


def test_joint_path_avoids_an_obstacle(arm: ArmMotion) -> None:
    start = arm.solve_posture(in_front(arm, 0.7, -0.5, 0.2))
    assert start is not None
    arm.state[0] = start
    pose = in_front(arm, 0.7, 0.6, 0.2)
    direct = joint_path(arm, pose, NOTHING)
    assert direct is not None
    x, y, _ = in_front(arm, 0.7, 0.05, 0.2)[:3, 3]
    post = np.array([[x, y, 0.0, x, y, 0.5, 0.03, 0.15]])
    assert min(obstacle_clearance(arm.capsules(q), post) for q in direct) < 0.0
    path = joint_path(arm, pose, post)
    assert path is not None
    check_path(arm, path, pose, post)
    assert len(path) > len(direct)


def test_joint_path_is_none_where_there_is_no_way(arm: ArmMotion) -> None:
    pose = in_front(arm, 0.7, 0.3, 0.2)
    x, y, z = pose[:3, 3]
    ball = np.array([[*(x, y, z) * 2, 0.05, 0.15]])
    assert joint_path(arm, pose, ball) is None
    assert joint_path(arm, in_front(arm, 1.1, 0.0, 0.2), NOTHING) is None
