"""The gripper: stroke, force, and what it holds by friction alone."""

import math

import mujoco
import numpy as np
import pytest
from tiers import slow_but

from lemma.core.poses import Pose2
from lemma.robots.gripper import FINGER_OPENING_M, GRIP_FORCE_N, SKIN_M
from lemma.robots.ur.build import ARMS, add_arm

HELD = np.array([0.0, -1.9, 1.6, -1.27, -math.pi / 2, 0.0])
CUBE = ((0.025, 0.025, 0.025), 0.09)
STICK = ((0.25, 0.015, 0.015), 0.11)
SWING = ((0.5, 0.4), (0.2, 0.5), (0.2, 0.6), (0.3, 0.5), (0.4, 0.7), (1.0, 0.4))


def scene(
    arm: str,
    thing: tuple[tuple[float, float, float], float] | None,
    off_centre_m: float = 0.0,
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """An arm in the air, and a thing between its fingers or nothing."""
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep = 0.005
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 300
    add_arm(spec, ARMS[arm], "robot_0", Pose2(0.0, 0.0), "red")
    if thing:
        size, mass = thing
        body = spec.worldbody.add_body(name="thing")
        body.add_freejoint()
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=size,
            mass=mass,
            friction=[0.8, 0.01, 0.0002],
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:6] = data.ctrl[:6] = HELD
    data.qpos[6:8] = FINGER_OPENING_M / 2
    mujoco.mj_forward(model, data)
    if thing:
        tool = data.site("robot_0/tcp")
        rotation = tool.xmat.reshape(3, 3)
        data.qpos[8:11] = tool.xpos + off_centre_m * rotation[:, 0]
        mujoco.mju_mat2Quat(data.qpos[11:15], tool.xmat)
        # Nothing falls until the fingers have closed.
        model.opt.gravity[:] = 0.0
        mujoco.mj_step(model, data, 160)
        model.opt.gravity[2] = -9.81
        mujoco.mj_step(model, data, 40)
    return model, data


def in_hand(data: mujoco.MjData) -> np.ndarray:
    tool = data.site("robot_0/tcp")
    return tool.xmat.reshape(3, 3).T @ (data.body("thing").xpos - tool.xpos)


def test_the_stroke_takes_half_a_second_and_stays_symmetric() -> None:
    model, data = scene("ur5", None)
    data.ctrl[6] = 0.0
    widths = []
    for _ in range(160):
        mujoco.mj_step(model, data)
        widths.append(data.qpos[6] + data.qpos[7])
        assert abs(data.qpos[6] - data.qpos[7]) < 1e-5
    closed_s = 0.005 * next(i for i, width in enumerate(widths) if width < 0.002)
    assert 0.4 < closed_s < 0.7
    data.ctrl[6] = 0.06
    mujoco.mj_step(model, data, 200)
    assert data.qpos[6] + data.qpos[7] == pytest.approx(0.06, abs=1e-4)


@pytest.mark.parametrize("thing", [CUBE, STICK], ids=["cube", "stick"])
def test_the_fingers_squeeze_with_their_force_and_no_more(
    thing: tuple[tuple[float, float, float], float],
) -> None:
    model, data = scene("ur5", thing)
    squeeze, wrench = 0.0, np.zeros(6)
    for index, contact in enumerate(data.contact):
        names = {model.geom(geom).name for geom in contact.geom}
        mujoco.mj_contactForce(model, data, index, wrench)
        squeeze += wrench[0] * ("robot_0/pad_left" in names)
        assert contact.dist > 0.0
    assert squeeze == pytest.approx(GRIP_FORCE_N, rel=0.02)
    assert data.qpos[6] < thing[0][1] + SKIN_M


@pytest.mark.parametrize("arm", slow_but(ARMS, "ur5"))
@pytest.mark.parametrize(
    ("thing", "off_centre_m"), [(CUBE, 0.0), (STICK, 0.2)], ids=["cube", "stick"]
)
@pytest.mark.parametrize(("scale", "slip_m"), [(0.3, 1e-3), (1.0, 10e-3)])
def test_a_swinging_arm_keeps_what_it_holds(
    arm: str,
    thing: tuple[tuple[float, float, float], float],
    off_centre_m: float,
    scale: float,
    slip_m: float,
) -> None:
    model, data = scene(arm, thing, off_centre_m)
    start = in_hand(data)
    for step in range(2000):
        time_s = 0.005 * step
        for joint, (amplitude, frequency_hz) in enumerate(SWING):
            wave = math.sin(math.tau * frequency_hz * time_s)
            swell = scale * min(1.0, time_s / 2.0)
            data.ctrl[joint] = HELD[joint] + swell * amplitude * wave
        mujoco.mj_step(model, data)
        assert np.linalg.norm(in_hand(data) - start) < slip_m
        assert data.contact.dist.min() > -1e-3
