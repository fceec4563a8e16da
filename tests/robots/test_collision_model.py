"""The simplified arms: distances, and how well capsules stand for the real shape."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.poses import FloatArray, Pose2
from lemma.robots.collision_model import (
    envelope_of,
    obstacle_clearance,
    place_capsules,
    segment_distance,
    self_clearance,
    table_clearance,
)
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.build import add_arm
from lemma.robots.ur.kinematics import frames, inverse, top_down

ARM_NAMES = ("ur5", "ur10")
ELBOW_UP = (0.0, -1.4, 1.8, -1.97, -1.57, 0.0)

coordinate = st.floats(-1.0, 1.0).map(lambda value: round(value, 4))
segments = st.lists(coordinate, min_size=6, max_size=6).map(np.array)


def brute_force_distance(a: FloatArray, b: FloatArray) -> float:
    """Sample one segment densely; the nearest point of the other is exact."""
    points = a[:3] + np.linspace(0, 1, 4001)[:, None] * (a[3:] - a[:3])
    along = b[3:] - b[:3]
    length = float(along @ along)
    t = np.clip((points - b[:3]) @ along / length, 0, 1) if length > 0 else 0.0
    nearest = b[:3] + np.multiply.outer(t, along)
    return float(np.sqrt(((points - nearest) ** 2).sum(axis=-1)).min())


@given(segments, segments)
def test_segment_distance_is_that_of_the_nearest_samples(
    a: FloatArray, b: FloatArray
) -> None:
    expected = brute_force_distance(a, b)
    # Between two samples the distance changes by no more than half their spacing.
    spacing = float(np.linalg.norm(a[3:] - a[:3])) / 4000
    distance = segment_distance(a, b)
    assert expected - 0.5 * spacing - 1e-9 <= distance <= expected + 1e-9
    assert segment_distance(b, a) == pytest.approx(distance, abs=1e-9)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ((0, 0, 0, 1, 0, 0), (0, 0, 2, 0, 0, 3), 2.0),  # at right angles
        ((-1, 0, 0, 1, 0, 0), (0, -1, 1, 0, 1, 1), 1.0),  # crossing in the middle
        ((0, 0, 0, 1, 0, 0), (0, 1, 0, 1, 1, 0), 1.0),  # parallel
        ((0, 0, 0, 1, 0, 0), (2, 0, 0, 3, 0, 0), 1.0),  # in one line
        ((0, 0, 0, 1, 0, 0), (0.5, 3, 4, 0.5, 3, 4), 5.0),  # a point
        ((1, 1, 1, 1, 1, 1), (1, 1, 4, 1, 1, 4), 3.0),  # two points
        ((0, 0, 0, 1, 0, 0), (0.5, -1, 0, 0.5, 1, 0), 0.0),  # touching
    ],
)
def test_segment_distance_of_special_cases(
    a: tuple[float, ...], b: tuple[float, ...], expected: float
) -> None:
    for scale in (1.0, 1e-2, 1e-4):
        distance = segment_distance(scale * np.array(a), scale * np.array(b))
        assert distance == pytest.approx(scale * expected, abs=1e-9)


def placed(arm: str, q: FloatArray, base: FloatArray | None = None) -> FloatArray:
    envelope = envelope_of(arm)
    all_frames = np.empty((7, 4, 4))
    frames(ARMS[arm].dh, np.eye(4) if base is None else base, q, all_frames)
    out = np.empty((len(envelope.capsules), 7))
    place_capsules(all_frames, envelope.capsule_links, envelope.capsules, out)
    return out


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_capsules_move_with_their_links(arm: str) -> None:
    envelope = envelope_of(arm)
    base = np.eye(4)
    base[:3, 3] = 0.3, -0.2, 0.1
    q = np.array([0.4, -1.2, 1.5, -0.6, 0.9, -2.0])
    all_frames = np.empty((7, 4, 4))
    frames(ARMS[arm].dh, base, q, all_frames)
    for link, local, world in zip(
        envelope.capsule_links, envelope.capsules, placed(arm, q, base), strict=True
    ):
        frame = all_frames[int(link)]
        assert np.abs(world[:3] - (frame @ [*local[:3], 1.0])[:3]).max() < 1e-12
        assert np.abs(world[3:6] - (frame @ [*local[3:6], 1.0])[:3]).max() < 1e-12
        assert world[6] == local[6]


def surface_points(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, FloatArray]:
    """Return what is seen of each link as mesh vertices in the world, by link."""
    points: dict[str, list[FloatArray]] = {}
    for geom in range(model.ngeom):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        local = model.mesh_vert[first : first + count]
        world = data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T
        link = model.body(model.geom_bodyid[geom]).name
        points.setdefault(link, []).append(world)
    return {link: np.concatenate(parts) for link, parts in points.items()}


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_capsules_hold_what_is_seen_of_the_arm(arm: str) -> None:
    spec = mujoco.MjSpec()
    add_arm(spec, ARMS[arm], "robot_0", Pose2(0.0, 0.0), "white")
    model = spec.compile()
    data = mujoco.MjData(model)
    q = np.array([0.5, -1.1, 1.3, -0.4, 0.8, 0.3])
    data.qpos[:6] = q
    data.qpos[6:8] = 0.05
    mujoco.mj_kinematics(model, data)
    capsules = placed(arm, q)
    seen = surface_points(model, data)
    assert len(seen) == 10
    for link, points in seen.items():
        outside = max(
            min(
                segment_distance(np.array([*point, *point]), capsule) - capsule[6]
                for capsule in capsules
            )
            for point in points
        )
        # Housings end flat, capsules round: corners stick out by up to 0.41 radii.
        assert outside < 0.03, f"{link} sticks out by {outside:.3f} m"


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_capsules_hold_what_the_arm_collides_with(arm: str) -> None:
    spec = mujoco.MjSpec()
    add_arm(spec, ARMS[arm], "robot_0", Pose2(0.0, 0.0), "white")
    model = spec.compile()
    data = mujoco.MjData(model)
    q = np.array([-0.5, -0.7, 1.6, -2.4, -1.2, 1.3])
    data.qpos[:6] = q
    mujoco.mj_kinematics(model, data)
    capsules, count = placed(arm, q), 0
    for geom in range(model.ngeom):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_CAPSULE:
            continue
        count += 1
        radius, half, _ = model.geom_size[geom]
        axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        for offset in np.linspace(-half, half, 11):
            point = data.geom_xpos[geom] + offset * axis
            outside = min(
                segment_distance(np.array([*point, *point]), capsule) - capsule[6]
                for capsule in capsules
            )
            assert outside + radius < 0.01, model.geom(geom).name
    assert count >= 7


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_spheres_lie_in_the_arm(arm: str) -> None:
    envelope = envelope_of(arm)
    all_frames = np.empty((7, 4, 4))
    q = np.array(ELBOW_UP)
    frames(ARMS[arm].dh, np.eye(4), q, all_frames)
    capsules = placed(arm, q)
    assert len(envelope.spheres) == len(envelope.sphere_links)
    assert len(envelope.spheres) == len(envelope.sphere_meets_table)
    for link, sphere in zip(envelope.sphere_links, envelope.spheres, strict=True):
        centre = (all_frames[int(link)] @ [*sphere[:3], 1.0])[:3]
        depth = min(
            segment_distance(np.array([*centre, *centre]), capsule) - capsule[6]
            for capsule in capsules
        )
        assert depth < 0.0


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_self_clearance_tells_folded_from_free(arm: str) -> None:
    assert self_clearance(placed(arm, np.array(ELBOW_UP))) > 0.01
    assert self_clearance(placed(arm, np.zeros(6))) > 0.01
    for wrist_on_upper_arm in (3.05, -3.05):
        q = np.array([0.0, -1.4, wrist_on_upper_arm, 0.0, -1.57, 0.0])
        assert self_clearance(placed(arm, q)) < -0.05
    gripper_in_base = top_down(ARMS[arm].d4 + 0.005, 0.0, 0.16, 0.3)
    solutions = inverse(ARMS[arm].dh, gripper_in_base)
    assert len(solutions) > 0
    for q in solutions:
        assert self_clearance(placed(arm, q)) < 0.0


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_table_clearance_sees_arms_below_the_table(arm: str) -> None:
    arm_up, arm_down = np.array(ELBOW_UP), np.array([0, 0.6, 0, -1.57, -1.57, 0])
    # The shoulder is the lowest part that never moves.
    shoulder = ARMS[arm].d1 - ARMS[arm].elbow_radius
    assert table_clearance(placed(arm, arm_up)) == pytest.approx(shoulder, abs=1e-9)
    assert table_clearance(placed(arm, arm_down)) < 0.0


def test_obstacle_clearance_is_between_surfaces() -> None:
    capsules = placed("ur5", np.zeros(6))
    # At joint zero the arm lies along -x at shoulder height: measure from above.
    height = ARMS["ur5"].d1
    post = np.array([[-0.5, 0.0, height + 0.5, -0.5, -0.3, height + 0.5, 0.03]])
    expected = 0.5 - 0.03 - ARMS["ur5"].elbow_radius
    assert obstacle_clearance(capsules, post) == pytest.approx(expected, abs=1e-9)
    touching = post.copy()
    touching[0, [2, 5]] = height + 0.05
    assert obstacle_clearance(capsules, touching) < 0.0
    # The base stands on the table with whatever stands next to it: it is left out.
    at_the_foot = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.01]])
    assert obstacle_clearance(capsules, at_the_foot) > 0.0
    assert obstacle_clearance(capsules, np.zeros((0, 7))) == math.inf
