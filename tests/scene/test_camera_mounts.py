"""Cameras hang above their robots and see what these could touch, stick in hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.poses import Pose2
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.camera_mounts import (
    CAMERA_FOVY_RAD,
    CAMERA_HEIGHT_PX,
    CAMERA_WIDTH_PX,
    CameraFootprint,
    camera_mount,
    reach_mount,
)
from lemma.scene.cameras import Camera, CameraIntrinsics
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.spec import RobotPlacement
from lemma.tasks.instance import SPLITS
from lemma.tasks.suite import SUITE, load_instance

arms = st.sampled_from(["ur5", "ur10"])
bases = st.builds(
    Pose2, st.floats(-1.2, 1.2), st.floats(-0.1, 0.1), st.floats(-math.pi, math.pi)
)


def sees(robot: RobotPlacement, x: float, y: float) -> bool:
    return bool(CameraFootprint(robot).sees(np.array([x]), np.array([y]))[0])


def camera(robot: RobotPlacement) -> Camera:
    pose, fovy = camera_mount(robot)
    lens = CameraIntrinsics.from_fovy(fovy, CAMERA_WIDTH_PX, CAMERA_HEIGHT_PX)
    return Camera("camera", pose, lens)


@given(arms, bases)
def test_a_camera_hangs_above_its_robot_and_looks_down_in_front(
    arm: str, base: Pose2
) -> None:
    robot = RobotPlacement(arm, "red", base)
    pose, fovy = camera_mount(robot)
    assert fovy == CAMERA_FOVY_RAD
    x, y, z = pose.position
    assert base.distance(Pose2(x, y)) < 0.3
    assert 1.8 < z < 2.6
    rotation = pose.matrix()[:3, :3]
    assert rotation.T @ rotation == pytest.approx(np.eye(3), abs=1e-9)
    right, down, forward = rotation.T
    assert right[2] == pytest.approx(0.0, abs=1e-9)
    assert forward[2] < -0.5
    # Up in the image is away from the robot.
    assert -down[0] * math.cos(base.yaw) - down[1] * math.sin(base.yaw) > 0.5


@given(arms, bases)
def test_where_the_robot_works_is_in_the_middle_of_the_image(
    arm: str, base: Pose2
) -> None:
    robot = RobotPlacement(arm, "red", base)
    ahead = base @ Pose2(0.34 * could_of(arm).touch_m, 0.0)
    (pixel,), depth = camera(robot).project([[ahead.x, ahead.y, 0.0]])
    middle = ((CAMERA_WIDTH_PX - 1) / 2, (CAMERA_HEIGHT_PX - 1) / 2)
    assert pixel == pytest.approx(middle, abs=1e-6)
    assert depth[0] > 1.0


@given(arms, bases, st.floats(0.0, 2.0), st.floats(-math.pi, math.pi))
def test_sees_is_what_projects_into_the_image(
    arm: str, base: Pose2, away: float, bearing: float
) -> None:
    robot = RobotPlacement(arm, "red", base)
    at = base @ Pose2(away * math.cos(bearing), away * math.sin(bearing))
    (pixel,), depth = camera(robot).project([[at.x, at.y, 0.0]])
    offsets = [
        abs(value - (size - 1) / 2) / (size / 2)
        for value, size in zip(pixel, (CAMERA_WIDTH_PX, CAMERA_HEIGHT_PX), strict=True)
    ]
    inside = bool(depth[0] > 0) and max(offsets) <= 0.94
    if depth[0] <= 0 or abs(max(offsets) - 0.94) > 1e-6:
        assert sees(robot, at.x, at.y) == inside


@pytest.mark.parametrize("task", SUITE)
def test_both_cameras_see_the_middle(task: str) -> None:
    for index in range(0, SPLITS["test"], 3):
        for robot in load_instance(task, "test", index).scene.robots:
            # The middle of the region between them is the middle of the table.
            for y in (-0.2, 0.0, 0.2):
                assert sees(robot, 0.0, y)


@given(arms, bases, st.floats(-1.5, 1.5), st.floats(0.2, 1.0))
def test_a_camera_sees_all_that_its_robot_could_touch_ahead(
    arm: str, base: Pose2, bearing: float, share: float
) -> None:
    away = share * could_of(arm).touch_m
    at = base @ Pose2(away * math.cos(bearing), away * math.sin(bearing))
    assert sees(RobotPlacement(arm, "red", base), at.x, at.y)


@pytest.mark.parametrize("size", [(224, 224), (320, 240), (96, 128)])
@pytest.mark.parametrize(("arm", "least_px"), [("ur5", 6.5), ("ur10", 4.3)])
def test_a_close_camera_sees_all_that_its_robot_reaches_and_cubes_are_wider(
    arm: str, least_px: float, size: tuple[int, int]
) -> None:
    robot = RobotPlacement(arm, "red", Pose2(0.4, -0.05, 2.0))
    mount, fov = reach_mount(robot)
    camera = Camera("close", mount, CameraIntrinsics.from_shorter_side(fov, *size))
    grid = np.mgrid[-1.7:1.7:0.02, -1.7:1.7:0.02].reshape(2, -1)
    x, y = grid + np.array(robot.base.xy)[:, None]
    reach, away = reach_of(arm), np.hypot(*grid)
    # Objects lie nowhere that the robot's other camera does not see.
    inside = (away > reach.inner_m) & (away < reach.travel_m)
    inside &= CameraFootprint(robot).sees(x, y)
    assert inside.sum() > 2000
    edge = 0.5 * CUBE_EDGE_M
    for dx, dy in ((-edge, 0.0), (edge, 0.0), (0.0, -edge), (0.0, edge)):
        top = np.stack([x + dx, y + dy, np.full(len(x), CUBE_EDGE_M)], 1)[inside]
        u, v = camera.project(top)[0].T
        assert -0.5 < u.min() < u.max() < size[0] - 0.5
        assert -0.5 < v.min() < v.max() < size[1] - 0.5
    width = camera.intrinsics.fx * CUBE_EDGE_M / mount.position[2]
    assert width > least_px * min(size) / 224


@pytest.mark.parametrize(("arm", "least_px"), [("ur5", 11.5), ("ur10", 8.5)])
def test_cubes_are_large_enough_to_be_seen(arm: str, least_px: float) -> None:
    """Wide on average over where the robot works [px]."""
    robot = RobotPlacement(arm, "red", Pose2(0.0, 0.0))
    widths = []
    for away in np.linspace(0.3, could_of(arm).touch_m, 8):
        for bearing in np.linspace(-1.5, 1.5, 7):
            x, y = away * math.cos(bearing), away * math.sin(bearing)
            ends = [(x, y - CUBE_EDGE_M / 2, 0.05), (x, y + CUBE_EDGE_M / 2, 0.05)]
            (a, b), _ = camera(robot).project(ends)
            widths.append(math.dist(a, b))
    assert np.mean(widths) > least_px
    assert min(widths) > 0.8 * least_px


def test_no_camera_is_enough() -> None:
    """Each misses something that the other sees, and sometimes both do."""
    missing: set[tuple[bool, bool]] = set()
    for task in SUITE:
        for index in range(SPLITS["test"]):
            scene = load_instance(task, "test", index).scene
            left, right = (
                any(not sees(robot, *placed.pose.xy) for placed in scene.objects)
                for robot in scene.robots
            )
            missing.add((left, right))
    assert missing >= {(True, False), (False, True), (True, True)}
