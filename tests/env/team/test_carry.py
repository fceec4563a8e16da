"""Two robots carry a tray with its load: on one clock, or not at all."""

import math
from functools import cache

import pytest

import lemma
from lemma.core.errors import InvalidActionError, InvalidConfigError
from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.env.team.orders import Team
from lemma.motion.moves import Motion, Moves
from lemma.motion.outcome import Outcome, SkillFailure
from lemma.planning.grounding import GeometricGrounder, ground_or_refuse
from lemma.planning.pddl import to_pddl
from lemma.planning.planner import find_plan
from lemma.planning.schedule import in_order, pose_jobs
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.could import could_of
from lemma.robots.reach import TRAVEL_HEIGHT_M, reach_of
from lemma.scene.objects.tray import (
    HANDLE_GRASP_M,
    HANDLE_WIDTH_M,
    PLATE_LENGTH_M,
    TRAY_LENGTH_M,
)
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import On
from lemma.tasks.instance import Instance
from lemma.tasks.rules import problems
from lemma.tasks.sampling import sample
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import TASKS, load_instance
from lemma.tasks.teams.coalitions import needed
from lemma.tasks.zones import Territory

APART_M = 1.8
START, END = Pose2(0.0, -0.2, 0.1), Pose2(0.02, 0.2, -0.15)
HANDLE = Pose2(-0.335, 0.0)
CARRY = GroundedSubTask("robot_0", Primitive.CARRY, START @ HANDLE, END @ HANDLE)
ORDER = SubTask("robot_0", Primitive.CARRY, "tray", "blue_rack")
LEVEL_RAD = math.radians(1.0)


def table(*more: ObjectPlacement) -> SceneSpec:
    """Two UR5 face to face, a tray with a cube on it, and a rack."""
    robots = (
        RobotPlacement("ur5", "red", Pose2(-APART_M / 2, 0.0)),
        RobotPlacement("ur5", "white", Pose2(APART_M / 2, 0.0, math.pi)),
    )
    things = (
        ObjectPlacement("tray", "tray", START),
        ObjectPlacement("rack", "blue", END),
        ObjectPlacement("cube", "red", START @ Pose2(0.05, 0.0, 0.3)),
    )
    return SceneSpec(robots, (*things, *more))


@cache
def instance(index: int = 0) -> Instance:
    return sample(TASKS["carry"], "free", index).instance


def tilt_rad(scene: Scene) -> float:
    _, x, y, _ = scene.pose("tray").quaternion
    return math.acos(min(1.0, 1.0 - 2.0 * (x * x + y * y)))


def lies_on_the_rack(scene: Scene) -> bool:
    parts = (On("tray", "blue_rack"), On("red_cube", "tray"))
    return all(part.holds(scene) for part in parts)


# --- The skill ---------------------------------------------------------------------


def test_two_arms_put_a_tray_onto_a_rack_level_and_loaded() -> None:
    simulation, tilts = Simulation(table()), [0.0]
    scene = simulation.scene
    simulation.observers.append(lambda: tilts.append(tilt_rad(scene)))
    simulation.begin(CARRY)
    assert list(simulation.busy) == ["robot_0", "robot_1"]
    assert simulation.partner_of(CARRY) == "robot_1"
    with pytest.raises(InvalidActionError, match="robot_1 is busy"):
        simulation.begin(GroundedSubTask("robot_1", Primitive.MOVE, START, END))
    (ended,) = simulation.advance()
    assert ended.subtask == CARRY
    assert ended.result.outcome is Outcome.SUCCESS
    assert not simulation.busy
    assert not simulation.reservations.cells
    assert lies_on_the_rack(scene)
    assert max(tilts) < LEVEL_RAD
    assert simulation.clocks["robot_0"] == simulation.clocks["robot_1"]


@pytest.mark.slow
def test_one_at_a_time_is_the_same_to_the_bit() -> None:
    one, other = Simulation(table()), Simulation(table())
    assert one.execute(CARRY).ok
    other.begin(CARRY)
    while other.busy:
        other.advance(other.time_s + 0.05)
    assert one.scene.state_hash() == other.scene.state_hash()


@pytest.mark.slow
def test_two_are_as_slow_as_the_slower_one() -> None:
    simulation = Simulation(table())
    usual_s = simulation.execute(CARRY).duration_s
    slow = Simulation(table())
    slow.pace = lambda robot, start_s, now_s: 0.5 if robot == "robot_1" else 1.0
    result = slow.execute(CARRY)
    assert result.ok
    assert lies_on_the_rack(slow.scene)
    assert 1.7 * usual_s < result.duration_s < 2.1 * usual_s


def test_what_one_of_two_cannot_do_is_refused_for_both() -> None:
    """The partner's end of the way is out of its reach."""
    simulation = Simulation(table())
    before = simulation.scene.pose("tray")
    far = Pose2(-0.6, -0.2, 0.1) @ HANDLE
    result = simulation.execute(
        GroundedSubTask("robot_0", Primitive.CARRY, START @ HANDLE, far)
    )
    assert result.outcome is Outcome.UNREACHABLE
    assert "robot_1" in result.explanation
    assert not simulation.busy
    away = math.dist(before.position, simulation.scene.pose("tray").position)
    assert away < 0.001


def test_without_a_handle_there_is_nothing_to_carry() -> None:
    simulation = Simulation(table())
    middle = GroundedSubTask("robot_0", Primitive.CARRY, START, END)
    assert simulation.partner_of(middle) == ""
    result = simulation.execute(middle)
    assert result.outcome is Outcome.INVALID


def drag(simulation: Simulation, raised_m: float) -> Motion:
    """One arm takes its handle to where it shall lie."""
    arm = simulation.arms["robot_0"]
    moves, low_m, end_m = Moves(arm), 0.018, 0.078
    start, end = START @ HANDLE, END @ HANDLE
    low = (start.x, start.y, low_m, start.yaw)
    yield from moves.grasp((start.x, start.y, TRAVEL_HEIGHT_M, start.yaw), low)
    up_m = low_m + raised_m
    yield from moves.rise(low, up_m)
    yield from moves.along(
        (start.x, start.y, up_m, start.yaw), (end.x, end.y, up_m, end.yaw), 0.2
    )
    put = (end.x, end.y, end_m, end.yaw)
    yield from moves.along((end.x, end.y, up_m, end.yaw), put, 0.2)
    yield from moves.release(put)
    yield from moves.park()


@pytest.mark.parametrize(
    "raised_m", [0.08, *(pytest.param(m, marks=pytest.mark.slow) for m in (0.0, 0.25))]
)
def test_one_arm_alone_drags_or_tips_it(raised_m: float) -> None:
    simulation, tilts = Simulation(table()), [0.0]
    scene = simulation.scene
    try:
        for _ in drag(simulation, raised_m):
            simulation.tick(("robot_0",))
            tilts.append(tilt_rad(scene))
    except SkillFailure:
        pass
    simulation.rest(1.0)
    assert not lies_on_the_rack(scene)
    assert (
        scene.pose("tray").position != Simulation(table()).scene.pose("tray").position
    )
    if raised_m:
        assert max(tilts) > 3.0 * LEVEL_RAD


# --- Orders ------------------------------------------------------------------------


def test_one_hand_cannot_hold_it_and_one_robot_has_no_plan() -> None:
    found = instance()
    now = SymbolicState.observe(Scene(found.scene))
    grounder, (on, _) = GeometricGrounder(found.scene), found.goal.placements
    for robot in found.scene.robot_names:
        refused = ground_or_refuse(
            SubTask(robot, Primitive.MOVE, on.top, on.bottom), now, grounder
        )
        assert getattr(refused, "outcome", None) is Outcome.INVALID
        assert find_plan(now, found.goal, grounder, team=(robot,)) is None
    plan = find_plan(now, found.goal, grounder)
    assert plan is not None
    (step,) = plan.steps
    assert {step.grounded.robot, step.partner} == set(found.scene.robot_names)
    jobs = pose_jobs(now, plan, found.goal, grounder)
    schedule = in_order(jobs, (0,))
    assert set(schedule.team(0)) == set(found.scene.robot_names)
    assert len(schedule.stays(0)) == 4


def test_a_tray_cannot_be_told_in_pddl() -> None:
    found = instance()
    now = SymbolicState.observe(Scene(found.scene))
    with pytest.raises(InvalidConfigError, match="a tray"):
        to_pddl("carry", now, found.goal, GeometricGrounder(found.scene))


def test_each_robot_is_needed() -> None:
    for index in range(5):
        found = instance(index)
        territory = Territory(found.scene.robots)
        assert needed(territory, found.scene.objects, found.goal) == (0, 1)
    assert problems(found) == ()


def test_each_handle_is_of_one_robot_alone() -> None:
    """By the bound of any posture, of trays and racks of the test list."""
    for index in range(60):
        scene = load_instance("carry", "test", index).scene
        for placed in scene.objects:
            if placed.kind in ("tray", "rack"):
                owners = [owner(scene, placed.pose, side) for side in (-1, 1)]
                assert sorted(owners) == [0, 1]


def owner(scene: SceneSpec, pose: Pose2, side: int) -> int:
    """The robot that works at a handle; fails where the other one could touch it."""
    handle, found = pose @ Pose2(side * HANDLE_GRASP_M, 0.0), []
    for number, robot in enumerate(scene.robots):
        reach, away = reach_of(robot.arm), robot.base.distance(handle)
        if reach.inner_m + 0.03 <= away <= reach.travel_m - 0.03:
            found.append(number)
            continue
        rim = [
            pose @ Pose2(side * along, across)
            for along in (PLATE_LENGTH_M / 2, TRAY_LENGTH_M / 2)
            for across in (-HANDLE_WIDTH_M / 2, HANDLE_WIDTH_M / 2)
        ]
        nearest = min(robot.base.distance(point) for point in rim)
        assert nearest > could_of(robot.arm).touch_m + 0.029
    (alone,) = found
    return alone


@pytest.mark.slow
def test_an_order_takes_the_partner_and_waits_until_it_is_free() -> None:
    cube = ObjectPlacement("cube", "blue", Pose2(0.75, -0.45))
    pad = ObjectPlacement("pad", "blue", Pose2(0.75, 0.45))
    scene = table(cube, pad)
    found = Instance(
        "carry", "own", 0, scene, instance().goal.from_pairs((("tray", "blue_rack"),)),
        {"high_level": "Carry it."}, (),
    )  # fmt: skip
    episode = Episode(found)
    team = Team(episode)
    move = SubTask("robot_1", Primitive.MOVE, "blue_cube", "blue_pad")
    assert team.order(move) is None
    assert team.order(ORDER) is None
    assert team.waits_for == {"robot_0": ("robot_1",)}
    assert team.works_on("robot_1") == "robot_1"
    (moved,) = team.advance()
    assert moved.subtask == move
    assert team.works_on("robot_1") == "robot_0"
    assert team.free == ()
    episode.advance(episode.simulation.time_s + 5.0)
    middle = episode.snapshot(), team.state()
    (carried,) = team.advance()
    assert carried.result.ok
    assert carried.partner == "robot_1"
    assert lies_on_the_rack(episode.simulation.scene)
    again = Episode(found)
    again.restore(middle[0])
    other = Team(again)
    other.restore(middle[1])
    assert other.advance()[0].result == carried.result
    hashes = {e.simulation.scene.state_hash() for e in (episode, again)}
    assert len(hashes) == 1


@pytest.mark.slow
def test_both_may_say_so_in_one_step_of_an_environment() -> None:
    env = lemma.make("carry", level="plan", acting="together")
    env.reset(seed=0)
    rack = env.episode.instance.goal.placements[0].bottom
    orders = [SubTask(f"robot_{k}", Primitive.CARRY, "tray", rack) for k in range(2)]
    for order in orders:
        assert order in env.valid_orders(order.robot)
    _, _, _, _, info = env.step(env.encode(*orders))
    (ended,) = info["ended"]
    assert ended["robot"] == "robot_0"
    assert ended["outcome"] == "success"
    assert info["success"]
