"""The one step loop: time, clocks, snapshots, and what is held."""

import gc
import math
import weakref

import numpy as np
import pytest
from physics_steps import each_step
from recorded_episodes import first_instance, recorded, run_expert
from small_tables import cube, facing, pad, stick
from tiers import slow_but

from lemma.core.errors import InvalidActionError
from lemma.core.poses import Pose, Pose2
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.env.snapshots import Ended
from lemma.expert.expert import Expert, solve
from lemma.motion.skills import SkillRunner
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.build import STEPS_PER_TICK, TICK_S, TIME_STEP_S
from lemma.tasks.instance import SPLITS
from lemma.tasks.subtask import GroundedSubTask, Primitive
from lemma.tasks.suite import SUITE, load_instance

PICK, PLACE = Pose2(-0.1, 0.15, 0.3), Pose2(-0.05, -0.2, 0.3)
MOVE = GroundedSubTask("robot_0", Primitive.MOVE, PICK, PLACE)


@pytest.fixture
def simulation() -> Simulation:
    return Simulation(
        facing("ur5", cube("red", *PICK.xy, PICK.yaw), pad("red", 0, 0.4))
    )


def test_it_begins_at_zero_with_parked_arms_and_open_grippers(
    simulation: Simulation,
) -> None:
    assert simulation.time_s == 0.0
    assert simulation.held() == {}
    for arm in simulation.arms.values():
        joints = simulation.scene.data.qpos[arm.robot.qpos]
        assert joints == pytest.approx(arm.park, abs=1e-3)
        opening = simulation.scene.opening_m(arm.robot)
        assert opening == pytest.approx(FINGER_OPENING_M, abs=1e-4)
        assert np.abs(simulation.scene.data.qvel[arm.robot.dof]).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("task", SUITE)
def test_no_frozen_instance_begins_in_its_goal(task: str) -> None:
    """And everything lies still where the instance says, for all 60 of a task."""
    for index in range(SPLITS["test"]):
        instance = load_instance(task, "test", index)
        scene = Simulation(instance.scene).scene
        assert instance.goal.progress(scene) == 0.0
        for name in scene.movable_names:
            assert scene.pose2(name).distance(scene.spec.placement(name).pose) < 1e-4
            assert scene.speed(name) < 1e-3


def test_a_tick_is_two_physics_steps(simulation: Simulation) -> None:
    ticks: list[float] = []
    steps: list[float] = []
    simulation.observers.append(lambda: ticks.append(simulation.time_s))
    with each_step(simulation.scene, lambda: steps.append(simulation.time_s)):
        for _ in range(3):
            simulation.tick()
    assert STEPS_PER_TICK * TIME_STEP_S == TICK_S
    assert ticks == pytest.approx([0.01, 0.02, 0.03])
    assert steps == pytest.approx([0.0, 0.005, 0.01, 0.015, 0.02, 0.025])


@pytest.mark.parametrize(
    ("seconds", "expected"), [(0.0, 0.0), (1.0, 1.0), (0.003, 0.01)]
)
def test_rest_lets_time_pass(
    simulation: Simulation, seconds: float, expected: float
) -> None:
    simulation.rest(seconds)
    assert simulation.time_s == pytest.approx(expected)
    assert simulation.clocks["robot_0"].busy_s == 0.0


def test_clocks_tell_busy_from_idle_and_the_idle_arm_stays(
    simulation: Simulation,
) -> None:
    other = simulation.arms["robot_1"].robot
    before = simulation.scene.data.qpos[other.qpos].copy()
    first = simulation.execute(MOVE)
    moved = simulation.scene.data.qpos[other.qpos] - before
    assert np.abs(moved).max() < 1e-4
    simulation.rest(1.0)
    back = GroundedSubTask("robot_1", Primitive.MOVE, PLACE, PICK)
    second = simulation.execute(back)
    clocks, elapsed = simulation.clocks, simulation.time_s
    assert clocks["robot_0"].busy_s == pytest.approx(first.duration_s)
    assert clocks["robot_1"].busy_s == pytest.approx(second.duration_s)
    assert elapsed == pytest.approx(first.duration_s + second.duration_s + 1.0)
    assert clocks["robot_0"].idle_s(elapsed) == pytest.approx(second.duration_s + 1.0)
    assert clocks["robot_1"].idle_s(elapsed) == pytest.approx(first.duration_s + 1.0)


# --- Held --------------------------------------------------------------------------


def test_held_is_what_both_fingers_touch(simulation: Simulation) -> None:
    seen: list[dict[str, str]] = []
    heights: list[float] = []

    def look() -> None:
        seen.append(simulation.held())
        heights.append(simulation.scene.pose("red_cube").position[2])

    simulation.observers.append(look)
    simulation.execute(MOVE)
    assert seen[0] == seen[-1] == {}
    # Whenever the cube is in the air it is held, by that robot, and nothing else is.
    for held, height in zip(seen, heights, strict=True):
        if height > 0.035:
            assert held == {"robot_0": "red_cube"}
        assert held in ({}, {"robot_0": "red_cube"})
    assert sum(height > 0.035 for height in heights) > 50


def test_one_finger_is_not_enough(simulation: Simulation) -> None:
    skill = SkillRunner(simulation.arms).run(MOVE)
    while simulation.held() == {}:
        next(skill)
        simulation.tick(("robot_0",))
    scene, robot = simulation.scene, simulation.arms["robot_0"].robot
    # Aside along the closing direction: away from one finger.
    x, y, z = scene.pose("red_cube").position
    across = simulation.arms["robot_0"].tcp_pose()[:3, 1]
    shift = 0.02
    scene.set_joints(robot, scene.data.qpos[robot.qpos], FINGER_OPENING_M)
    simulation.arms["robot_0"].opening_m = FINGER_OPENING_M
    moved = Pose((x + shift * across[0], y + shift * across[1], z))
    scene.set_pose("red_cube", Pose(moved.position, scene.pose("red_cube").quaternion))
    simulation.tick()
    assert simulation.held() == {}


# --- Snapshots ---------------------------------------------------------------------


def test_restoring_tells_what_is_held() -> None:
    simulation = Simulation(facing("ur10", stick(Pose2(-0.2, -0.2, 0.4))))
    grip = simulation.scene.pose2("stick") @ Pose2(0.05, 0.0)
    carry = GroundedSubTask("robot_0", Primitive.MOVE, grip, Pose2(-0.1, 0.2, 0.4))
    skill = SkillRunner(simulation.arms).run(carry)
    while simulation.scene.pose("stick").position[2] < 0.2:
        next(skill)
        simulation.tick(("robot_0",))
    kept = simulation.snapshot()
    skill.close()
    fresh = Simulation(simulation.scene.spec)
    assert fresh.held() == {}
    fresh.restore(kept)
    assert fresh.held() == simulation.held() == {"robot_0": "stick"}


@pytest.mark.slow
def test_a_whole_episode_from_a_snapshot_of_its_beginning() -> None:
    instance = first_instance("hook", "ur5+ur10")
    _, _, steps, hashes = run_expert(instance)
    simulation = Simulation(instance.scene)
    kept = simulation.snapshot()
    simulation.execute(steps[0].grounded)
    simulation.restore(kept)
    found = [simulation.scene.state_hash()]
    for step in steps:
        simulation.execute(step.grounded)
        found.append(simulation.scene.state_hash())
    assert found == hashes


def test_time_does_not_drift() -> None:
    simulation = Simulation(facing("ur5"))
    simulation.rest(100.0)
    assert math.isclose(simulation.time_s, 100.0, abs_tol=1e-6)


def run_alone(simulation: Simulation, subtask: GroundedSubTask) -> None:
    """Execute a sub-task by the shortest loop that can: a reference."""
    for _ in SkillRunner(simulation.arms).run(subtask):
        simulation.tick((subtask.robot,))


@pytest.mark.parametrize("task", slow_but(SUITE, "poke"))
def test_begin_and_advance_give_the_states_of_a_plain_loop(task: str) -> None:
    """Also where time passes in pieces, and another robot's turn comes at once."""
    instance = first_instance(task, "ur5+ur10")
    steps = recorded(task, "ur5+ur10").steps
    plain, pieces = Simulation(instance.scene), Simulation(instance.scene)
    for number, step in enumerate(steps):
        run_alone(plain, step.grounded)
        pieces.begin(step.grounded)
        ended: tuple[Ended, ...] = ()
        piece_s = 0.07 + 0.31 * number
        while not ended:
            assert pieces.busy == {step.grounded.robot: step.grounded}
            ended = pieces.advance(pieces.time_s + piece_s)
        assert [done.subtask for done in ended] == [step.grounded]
        assert pieces.scene.state_hash() == plain.scene.state_hash()
    assert pieces.advance() == ()


def test_two_robots_at_once_end_each_at_its_own_time() -> None:
    spots = {"robot_0": Pose2(-0.55, 0.35), "robot_1": Pose2(0.55, -0.35)}
    colors = ("red", "green")
    cubes = [cube(c, *s.xy) for c, s in zip(colors, spots.values(), strict=True)]
    simulation = Simulation(facing("ur5", *cubes))
    long, short = (
        GroundedSubTask(name, Primitive.MOVE, spot, Pose2(*(0.8 * v for v in spot.xy)))
        for name, spot in spots.items()
    )
    simulation.begin(long)
    assert simulation.advance(1.0) == ()
    simulation.begin(short)
    for refused in (lambda: simulation.begin(short), simulation.snapshot):
        with pytest.raises(InvalidActionError, match="is busy"):
            refused()
    with pytest.raises(InvalidActionError, match="cannot work alone"):
        simulation.execute(short)
    (first,) = simulation.advance()
    assert (first.subtask, first.start_s) == (long, 0.0)
    assert simulation.busy == {"robot_1": short}
    (second,) = simulation.advance()
    assert second.subtask == short
    assert second.start_s == pytest.approx(1.0)
    assert first.result.ok
    assert second.result.ok
    for done in (first, second):
        clock = simulation.clocks[done.subtask.robot]
        assert clock.busy_s == done.result.duration_s


def test_a_busy_robot_is_broken_off_at_its_time_and_freed_by_restore() -> None:
    simulation = Simulation(facing("ur5", cube("red", *PICK.xy, PICK.yaw)))
    start = simulation.snapshot()
    simulation.begin(MOVE, until_s=0.5)
    (ended,) = simulation.advance()
    assert ended.result.outcome == "out_of_time"
    assert simulation.time_s == pytest.approx(0.5)
    simulation.begin(MOVE)
    simulation.advance(1.0)
    simulation.restore(start)
    assert simulation.busy == {}
    assert simulation.execute(MOVE).ok


def test_memory_of_an_episode_is_free_at_once() -> None:
    gc.collect()
    gc.disable()
    try:
        episode = Episode(load_instance("reach", "test", 0))
        scene = episode.simulation.scene
        assert len([*solve(episode, Expert(scene, episode.instance.goal))]) == 1
        kept = weakref.ref(scene)
        del episode, scene
        # MuJoCo's memory, 7 MB an episode, is none that the garbage collector counts.
        assert kept() is None
    finally:
        gc.enable()
