"""The arms: published numbers, kinematics, servos, contacts, and how they are drawn."""

import math

import mujoco
import numpy as np
import pytest

from lemma.core.errors import UnknownNameError
from lemma.core.poses import Pose2
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.ur.build import ARMS, JOINTS, LINKS, add_arm
from lemma.robots.ur.meshes import Loft, mesh, rounded

STRETCHED = np.array([0.0, 0.0, 0.0, 0.0, -1.57, 0.0])
FOLDED = np.array([0.0, -1.9, 2.4, -2.07, -1.57, 0.0])


def empty_spec() -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[2, 2, 0.02],
        pos=[0, 0, -0.02],
    )
    return spec


def one_arm(name: str, load_kg: float = 0.0) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = empty_spec()
    add_arm(spec, ARMS[name], "robot_0", Pose2(0.0, 0.0), "white")
    if load_kg:
        load = spec.body("robot_0/gripper").add_body(pos=[0, 0, TCP_OFFSET_M])
        load.explicitinertial = True
        load.mass = load_kg
        load.inertia = [4e-4 * load_kg] * 3
    model = spec.compile()
    return model, mujoco.MjData(model)


def reach_down(
    model: mujoco.MjModel, data: mujoco.MjData, x: float, z: float
) -> np.ndarray | None:
    """Joints, elbow up, that put the tool at (x, 0, z) pointing down; None: no such."""
    tool = model.site("robot_0/tcp").id
    data.qpos[:6] = [math.pi, -1.2, 1.6, -1.97, -math.pi / 2, 0.0]
    position, rotation = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for _ in range(300):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        axis = data.site_xmat[tool].reshape(3, 3)[:, 2]
        error = np.concatenate(
            [np.array([x, 0, z]) - data.site_xpos[tool], np.cross(axis, [0, 0, -1])]
        )
        if np.linalg.norm(error) < 1e-6:
            return data.qpos[:6].copy()
        mujoco.mj_jacSite(model, data, position, rotation, tool)
        jacobian = np.vstack([position, rotation])[:, :6]
        damped = jacobian @ jacobian.T + 1e-5 * np.eye(6)
        step = jacobian.T @ np.linalg.solve(damped, error)
        data.qpos[:6] += np.clip(step, -0.2, 0.2)
    return None


@pytest.mark.parametrize("name", ARMS)
def test_masses_and_limits_reach_the_model(name: str) -> None:
    arm = ARMS[name]
    model, _ = one_arm(name)
    for i, (joint, link) in enumerate(zip(JOINTS, LINKS, strict=True)):
        limit, effort = arm.joint_range[i], arm.effort_limits[i]
        motor = model.actuator(f"robot_0/{joint}")
        assert model.body(f"robot_0/{link}").mass[0] == arm.link_masses[i]
        assert list(model.joint(f"robot_0/{joint}").range) == [-limit, limit]
        assert list(motor.ctrlrange) == [-limit, limit]
        assert list(motor.forcerange) == [-effort, effort]
    assert arm.joint_range[2] == math.pi
    # Explicit damping removes at most all of a rotor's speed in one step.
    assert all(
        0.005 * damping < armature
        for damping, armature in zip(arm.damping, arm.armature, strict=True)
    )


@pytest.mark.parametrize("name", ARMS)
def test_gravity_is_compensated(name: str) -> None:
    model, data = one_arm(name)
    data.qpos[:6] = data.ctrl[:6] = [0.3, -0.4, 0.5, -0.6, 0.7, -0.8]
    mujoco.mj_step(model, data, 200)
    np.testing.assert_allclose(data.qpos[:6], data.ctrl[:6], atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("posture", [STRETCHED, FOLDED], ids=["stretched", "folded"])
@pytest.mark.parametrize("load_kg", [0.0, 1.0])
def test_every_joint_settles_without_ringing(
    name: str, posture: np.ndarray, load_kg: float
) -> None:
    model, data = one_arm(name, load_kg)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    for joint in range(6):
        mujoco.mj_resetData(model, data)
        data.qpos[:6] = data.ctrl[:6] = posture
        mujoco.mj_step(model, data, 200)
        start, step = data.qpos[joint], 0.002
        data.ctrl[joint] += step
        response = []
        for _ in range(100):
            mujoco.mj_step(model, data)
            response.append((data.qpos[joint] - start) / step)
        assert max(response) < 1.05
        assert max(abs(value - 1.0) for value in response[30:]) < 0.02


@pytest.mark.parametrize("name", ARMS)
def test_a_kilogram_at_full_stretch_sags_under_half_a_millimetre(name: str) -> None:
    model, data = one_arm(name, load_kg=1.0)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data.qpos[:6] = data.ctrl[:6] = STRETCHED
    mujoco.mj_forward(model, data)
    before = data.site("robot_0/tcp").xpos[2]
    mujoco.mj_step(model, data, 600)
    assert 0.0 < before - data.site("robot_0/tcp").xpos[2] < 0.5e-3


@pytest.mark.parametrize(("name", "farthest"), [("ur5", 0.89), ("ur10", 1.29)])
def test_working_poses_touch_nothing(name: str, farthest: float) -> None:
    model, data = one_arm(name)
    solved = 0
    for x in np.linspace(0.3, farthest, 16):
        for z in (0.025, 0.15, 0.3):
            if reach_down(model, data, x, z) is None:
                continue
            solved += 1
            for turn in np.linspace(-np.pi, np.pi, 8, endpoint=False):
                data.qpos[5] = turn
                for width in (0.0, 0.1):
                    data.qpos[6:8] = width / 2
                    mujoco.mj_forward(model, data)
                    assert data.ncon == 0, (x, z, turn)
    assert solved >= 40


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize(
    ("joints", "expected"),
    [
        ([0, -1.2, 3.05, 0, -1.57, 0], {"forearm", "shoulder"}),
        ([0, -1.57, 2.7, -0.5, -1.57, 0], {"finger_left", "upper_arm"}),
        ([0, 0.4, 0.0, 0.0, -1.57, 0], {"table"}),
    ],
)
def test_colliding_poses_are_noticed(
    name: str, joints: list[float], expected: set[str]
) -> None:
    model, data = one_arm(name)
    data.qpos[:6] = joints
    mujoco.mj_forward(model, data)
    touching = {
        model.body(model.geom_bodyid[geom]).name.removeprefix("robot_0/")
        if model.geom(geom).name != "table"
        else "table"
        for contact in data.contact
        for geom in contact.geom
    }
    assert expected <= touching, touching


def test_two_arms_collide_with_each_other() -> None:
    spec = empty_spec()
    add_arm(spec, ARMS["ur5"], "robot_0", Pose2(-0.4, 0.0), "red")
    add_arm(spec, ARMS["ur10"], "robot_1", Pose2(0.4, 0.0, math.pi), "white")
    model = spec.compile()
    data = mujoco.MjData(model)
    for start in (0, 8):
        data.qpos[start : start + 6] = [math.pi, -0.3, 0.3, -1.57, -1.57, 0]
    mujoco.mj_forward(model, data)
    robots = {
        tuple(sorted(model.geom(geom).name.split("/")[0] for geom in contact.geom))
        for contact in data.contact
    }
    assert ("robot_0", "robot_1") in robots


def test_arms_of_one_type_share_their_meshes_and_only_capsules_collide() -> None:
    spec = empty_spec()
    add_arm(spec, ARMS["ur5"], "robot_0", Pose2(-0.6, 0.0), "red")
    alone = len(spec.meshes)
    add_arm(spec, ARMS["ur5"], "robot_1", Pose2(0.6, 0.0, math.pi), "white")
    model = spec.compile()
    assert len(spec.meshes) == alone
    assert model.nmeshface < 2500
    meshes = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    assert not model.geom_contype[meshes].any()
    assert not model.geom_conaffinity[meshes].any()
    assert set(model.geom_group[meshes]) == {2}
    collides = model.geom_contype > 0
    assert set(model.geom_group[collides & (model.geom_bodyid > 0)]) == {3}


def test_an_unknown_color_names_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match="red, white"):
        add_arm(empty_spec(), ARMS["ur5"], "robot_0", Pose2(0, 0), "purple")


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_lofts_enclose_their_volume_from_outside(axis: int, sign: int) -> None:
    x, y, z = (float(sign * (k == axis)) for k in range(3))
    direction = (x, y, z)
    solid = Loft(
        (0.1, 0.2, 0.3),
        direction,
        rounded(0.1, 0.5, 0.2, 0.01),
        segments=64,
        closed=(True, True),
    )
    surface = mesh([solid])
    corners = np.reshape(surface.vertices, (-1, 3))[np.reshape(surface.faces, (-1, 3))]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(math.pi * 0.2**2 * 0.4, rel=0.01)
    ends = (corners[..., axis].min(), corners[..., axis].max())
    origin = (0.1, 0.2, 0.3)[axis]
    assert ends == pytest.approx(sorted(origin + sign * z for z in (0.1, 0.5)))
