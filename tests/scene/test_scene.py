"""A scene: names instead of addresses, state that can be kept and put back."""

import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from physics_steps import each_step
from recorded_episodes import first_instance, recorded
from tiers import slow_but

from lemma.core.errors import PhysicsError, UnknownNameError
from lemma.core.poses import Pose
from lemma.env.simulation import Simulation
from lemma.motion.skills import SkillRunner
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.coasting import step
from lemma.scene.scene import Scene
from lemma.scene.spec import SceneSpec
from lemma.tasks.suite import SUITE, load_instance


@pytest.fixture
def spec() -> SceneSpec:
    return first_instance("hook", "ur5+ur10").scene


@pytest.fixture
def scene(spec: SceneSpec) -> Scene:
    return Scene(spec)


def steps(scene: Scene, count: int) -> str:
    mujoco.mj_step(scene.model, scene.data, count)
    return scene.state_hash()


# --- Names -------------------------------------------------------------------------


def test_objects_are_where_the_spec_puts_them(scene: Scene) -> None:
    for placed in scene.spec.objects:
        found = scene.pose2(placed.name)
        assert found.xy == pytest.approx(placed.pose.xy)
        assert math.cos(found.yaw - placed.pose.yaw) == pytest.approx(1.0)
        assert scene.speed(placed.name) == 0.0
        body = scene.model.body(placed.name).id
        assert scene.entity_of_body(body) == placed.name
    assert scene.entity_of_body(0) is None
    assert scene.entity_of_body(scene.model.body("robot_0/forearm").id) is None


def test_movable_is_what_is_not_fixed(scene: Scene) -> None:
    movable = {o.name for o in scene.spec.objects if o.kind != "pad"}
    assert set(scene.movable_names) == movable


def test_robots_are_found_by_name(scene: Scene) -> None:
    assert [robot.name for robot in scene.robots] == ["robot_0", "robot_1"]
    assert scene.robot("robot_1") is scene.robots[1]
    with pytest.raises(UnknownNameError, match=r"'robot_2'.*Valid: robot_0, robot_1"):
        scene.robot("robot_2")


def test_joints_are_set_and_read_by_robot(scene: Scene) -> None:
    first, second = scene.robots
    q = np.array([0.1, -1.2, 1.3, -1.4, -1.5, 0.6])
    scene.set_joints(second, q, 0.06)
    assert scene.data.qpos[second.qpos].tolist() == q.tolist()
    assert scene.data.ctrl[second.ctrl].tolist() == q.tolist()
    assert scene.opening_m(second) == pytest.approx(0.06)
    assert not scene.data.qpos[first.qpos].any()
    names = [f"robot_1/{joint}" for joint in ("shoulder_pan", "wrist_3")]
    values = [scene.data.joint(name).qpos[0] for name in names]
    assert values == [0.1, 0.6]


def test_the_opening_is_never_told_beyond_its_stroke(scene: Scene) -> None:
    robot = scene.robots[0]
    scene.set_joints(robot, np.zeros(6), 0.1001)
    assert scene.opening_m(robot) == FINGER_OPENING_M
    scene.set_joints(robot, np.zeros(6), -0.0001)
    assert scene.opening_m(robot) == 0.0


@pytest.mark.parametrize("name", ["purple_cube", "robot_0", ""])
def test_an_object_that_is_not_there_is_answered(scene: Scene, name: str) -> None:
    with pytest.raises(UnknownNameError, match="object in this scene"):
        scene.pose(name)


def test_set_pose_moves_and_stops(scene: Scene) -> None:
    dof = int(scene.model.joint("stick").dofadr[0])
    scene.data.qvel[dof : dof + 6] = 0.3
    assert scene.speed("stick") == pytest.approx(math.sqrt(3 * 0.09))
    turned = Pose((0.1, 0.2, 0.5), (math.cos(0.4), 0.0, 0.0, math.sin(0.4)))
    scene.set_pose("stick", turned)
    assert scene.pose("stick") == turned
    assert scene.pose2("stick").yaw == pytest.approx(0.8)
    assert scene.speed("stick") == 0.0
    assert not scene.data.qvel[dof : dof + 6].any()


def test_what_is_fixed_cannot_be_moved(scene: Scene) -> None:
    pad = next(o.name for o in scene.spec.objects if o.kind == "pad")
    with pytest.raises(UnknownNameError, match="movable object"):
        scene.set_pose(pad, Pose((0.0, 0.0, 0.0)))
    with pytest.raises(UnknownNameError, match="movable object"):
        scene.set_pose("robot_0", Pose((0.0, 0.0, 0.0)))


# --- Snapshots ---------------------------------------------------------------------


def test_going_back_and_on_again_is_exact_to_the_bit(spec: SceneSpec) -> None:
    scene = Simulation(spec).scene
    steps(scene, 17)
    before, kept = scene.state_hash(), scene.snapshot()
    after = steps(scene, 300)
    assert after != before
    scene.restore(kept)
    assert scene.state_hash() == before
    assert steps(scene, 300) == after


def test_another_scene_of_the_same_spec_goes_on_as_well(spec: SceneSpec) -> None:
    scene = Simulation(spec).scene
    kept, after = scene.snapshot(), steps(scene, 250)
    other = Scene(spec)
    other.restore(kept)
    assert steps(other, 250) == after


@pytest.mark.parametrize("task", slow_but(["stack", "hook"], "hook"))
@pytest.mark.parametrize("tick", slow_but([150, 320, 450], 320))
def test_in_the_middle_of_a_skill_too(task: str, tick: int) -> None:
    """With an object in the hand or being put down: contacts are part of the state."""
    instance = first_instance(task, "ur5+ur10")
    first = recorded(task, "ur5+ur10").steps[0].grounded
    simulation = Simulation(instance.scene)
    scene, skill = simulation.scene, SkillRunner(simulation.arms).run(first)
    for _ in range(tick):
        next(skill)
        simulation.tick((first.robot,))
    kept = scene.snapshot()
    controls: list[np.ndarray] = []
    hashes: list[str] = []

    def note() -> None:
        controls.append(scene.data.ctrl.copy())

    with each_step(scene, note):
        for _ in range(60):
            next(skill)
            simulation.tick((first.robot,))
            hashes.append(scene.state_hash())
    scene.restore(kept)
    again = []
    for count, control in enumerate(controls, 1):
        scene.data.ctrl[:] = control
        mujoco.mj_step(scene.model, scene.data)
        if count % 2 == 0:
            again.append(scene.state_hash())
    assert again == hashes


def test_restoring_updates_what_is_drawn(scene: Scene) -> None:
    robot = scene.robots[0]
    kept = scene.snapshot()
    scene.refresh()
    site = scene.data.site(f"{robot.name}/tcp").xpos.copy()
    scene.set_joints(robot, np.full(6, 0.5), 0.0)
    scene.refresh()
    assert math.dist(site, scene.data.site(f"{robot.name}/tcp").xpos) > 0.1
    scene.restore(kept)
    assert scene.data.site(f"{robot.name}/tcp").xpos == pytest.approx(site, abs=1e-12)


def test_the_hash_sees_every_bit(scene: Scene) -> None:
    before = scene.state_hash()
    assert len(before) == 64
    scene.refresh()
    assert scene.state_hash() == before
    for array in (scene.data.qpos, scene.data.qvel, scene.data.ctrl):
        kept = array[-1]
        array[-1] = np.nextafter(kept, 9.0)
        assert scene.state_hash() != before
        array[-1] = kept
    assert scene.state_hash() == before


def test_a_snapshot_is_a_copy(scene: Scene) -> None:
    kept = scene.snapshot()
    copy = kept.copy()
    steps(scene, 10)
    assert np.array_equal(kept, copy)


# --- The first state ---------------------------------------------------------------


@pytest.mark.parametrize("task", SUITE)
def test_at_reset_objects_rest_on_the_table_and_touch_nothing_else(task: str) -> None:
    for team in ("ur5+ur5", "ur5+ur10", "ur10+ur10"):
        spec = first_instance(task, team).scene
        scene = Simulation(spec).scene
        mujoco.mj_forward(scene.model, scene.data)
        touching = set()
        for contact in scene.data.contact[: scene.data.ncon]:
            bodies = [int(scene.model.geom_bodyid[g]) for g in contact.geom]
            assert 0 in bodies, "something touches another thing than the table"
            touching.add(scene.entity_of_body(max(bodies)))
            assert scene.model.geom(int(min(contact.geom))).name.startswith("table")
        assert touching == set(scene.movable_names)
        for name in scene.movable_names:
            before = spec.placement(name).pose
            assert scene.pose2(name).distance(before) < 1e-5
            assert scene.speed(name) < 1e-3
        assert scene.time_s == 0.0


def test_poses_in_the_plane_are_headings_of_the_x_axis(scene: Scene) -> None:
    """Of a tipped cube as well: where its x axis points, seen from above."""
    cube = next(o.name for o in scene.spec.objects if o.kind == "cube")
    tilt, yaw = 0.3, 1.1
    # Yaw about the vertical after a tilt about the cube's own y axis.
    w, y = math.cos(tilt / 2), math.sin(tilt / 2)
    c, s = math.cos(yaw / 2), math.sin(yaw / 2)
    scene.set_pose(cube, Pose((0.0, 0.0, 0.1), (c * w, -s * y, c * y, s * w)))
    assert scene.pose2(cube).yaw == pytest.approx(yaw)


def test_kernels_step_the_physics_as_python_does() -> None:
    spec = load_instance("stack", "test", 0).scene
    ours, theirs = Scene(spec), Scene(spec)
    _, time, count, geoms, *_ = ours.physics
    for _ in range(50):
        step(ours.physics)
        mujoco.mj_step(theirs.model, theirs.data)
        assert (time[0], count[0]) == (ours.data.time, ours.data.ncon)
        assert geoms[: count[0]].tolist() == theirs.data.contact.geom.tolist()
    assert count[0] > 0
    assert ours.state_hash() == theirs.state_hash()


def test_memory_that_is_elsewhere_is_an_error() -> None:
    scene = Scene(load_instance("stack", "test", 0).scene)
    scene.check_memory()
    addresses, time, count, *others = scene.physics
    scene.physics = (addresses, time, count + 1, *others)  # type: ignore[assignment]
    with pytest.raises(PhysicsError, match="Install the version"):
        scene.check_memory()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_scene_is_not_copied(scene: Scene, copied: Callable[[Any], Any]) -> None:
    """A copy would advance the physics of the first one, or memory that is free."""
    with pytest.raises(TypeError, match=r"Restore a snapshot\(\)"):
        copied(scene)
