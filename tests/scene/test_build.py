"""From data to a model: every team compiles, everything is there under its name."""

import mujoco
import numpy as np
import pytest
from recorded_episodes import EPISODES, first_instance
from tiers import slow_but

from lemma.core.errors import UnknownNameError
from lemma.robots.ur.build import ARMS, JOINTS
from lemma.scene.build import ACTUATIONS, TIME_STEP_S, compile_model
from lemma.scene.objects.entity import STICK


@pytest.mark.parametrize(("task", "team"), slow_but(EPISODES, *EPISODES[1::3]))
def test_every_team_of_every_task_compiles_and_holds_by_friction_alone(
    task: str, team: str
) -> None:
    spec = first_instance(task, team).scene
    model = compile_model(spec)
    for robot in spec.robot_names:
        for joint in JOINTS:
            assert model.joint(f"{robot}/{joint}").id >= 0
            assert model.actuator(f"{robot}/{joint}").id >= 0
        assert model.actuator(f"{robot}/gripper").id >= 0
        assert model.site(f"{robot}/tcp").id >= 0
        assert model.camera(f"{robot}/camera").id >= 0
    for placed in spec.objects:
        body = model.body(placed.name)
        assert body.id > 0
        assert (body.jntnum[0] == 1) == (placed.kind != "pad")
    movable = [placed.name for placed in spec.objects if placed.kind != "pad"]
    assert model.nu == 7 * len(spec.robots)
    assert model.nq == 8 * len(spec.robots) + 7 * len(movable)
    assert model.opt.timestep == TIME_STEP_S == 0.005
    # Nothing is held by anything but friction: the only equalities couple the two
    # fingers of a gripper.
    assert model.neq == 2
    assert (model.eq_type == mujoco.mjtEq.mjEQ_JOINT).all()
    for index, robot in enumerate(("robot_0", "robot_1")):
        joints = {
            model.joint(int(obj[index])).name
            for obj in (model.eq_obj1id, model.eq_obj2id)
        }
        assert joints == {f"{robot}/finger_left", f"{robot}/finger_right"}
    # No adhesion, no second actuator on anything, no force fields.
    assert model.actuator_trntype.tolist() == (
        [*[int(mujoco.mjtTrn.mjTRN_JOINT)] * 6, int(mujoco.mjtTrn.mjTRN_TENDON)] * 2
    )
    assert model.opt.gravity.tolist() == [0.0, 0.0, -9.81]
    objects = [model.body(n).id for n in spec.object_names]
    assert not np.asarray(model.body_gravcomp)[objects].any()


@pytest.mark.parametrize("actuation", ACTUATIONS)
def test_motors_keep_their_limits_however_they_are_driven(actuation: str) -> None:
    spec = first_instance("stack", "ur5+ur10").scene
    model = compile_model(spec, actuation)
    for robot, placed in zip(spec.robot_names, spec.robots, strict=True):
        arm = ARMS[placed.arm]
        for joint, effort in zip(JOINTS, arm.effort_limits, strict=True):
            motor = model.actuator(f"{robot}/{joint}")
            assert motor.forcerange.tolist() == [-effort, effort]
            assert model.actuator_forcelimited[motor.id]


def test_an_unknown_actuation_is_answered() -> None:
    spec = first_instance("stack", "ur5+ur10").scene
    with pytest.raises(UnknownNameError, match="Did you mean 'torque'"):
        compile_model(spec, "torqe")


def test_torque_motors_do_what_they_are_told() -> None:
    spec = first_instance("stack", "ur5+ur10").scene
    model = compile_model(spec, "torque")
    data = mujoco.MjData(model)
    motor = model.actuator("robot_0/elbow").id
    data.ctrl[motor] = 12.5
    mujoco.mj_forward(model, data)
    dof = model.joint("robot_0/elbow").dofadr[0]
    assert data.qfrc_actuator[dof] == pytest.approx(12.5)


def test_velocity_motors_reach_their_speed() -> None:
    spec = first_instance("stack", "ur5+ur10").scene
    model = compile_model(spec, "velocity")
    data = mujoco.MjData(model)
    data.ctrl[model.actuator("robot_0/wrist_3").id] = 0.7
    mujoco.mj_step(model, data, 100)
    dof = model.joint("robot_0/wrist_3").dofadr[0]
    assert data.qvel[dof] == pytest.approx(0.7, abs=0.01)


def test_everything_can_collide_but_what_is_structurally_one() -> None:
    spec = first_instance("hook_stack", "ur5+ur10").scene
    model = compile_model(spec)
    excluded = {
        frozenset(
            model.body(int(body)).name for body in divmod(int(signature), 1 << 16)
        )
        for signature in model.exclude_signature
    }
    assert excluded == {
        frozenset(pair)
        for robot in spec.robot_names
        for pair in (
            (f"{robot}/finger_left", f"{robot}/finger_right"),
            (f"{robot}/base", f"{robot}/shoulder"),
        )
    }
    solid = (model.geom_contype != 0) & (model.geom_conaffinity != 0)
    owners = {
        model.body(int(body)).name
        for body, is_solid in zip(model.geom_bodyid, solid, strict=True)
        if is_solid
    }
    for robot in spec.robot_names:
        assert {f"{robot}/forearm", f"{robot}/gripper", f"{robot}/base"} <= owners
    assert {STICK, "world", *spec.object_names} <= owners
