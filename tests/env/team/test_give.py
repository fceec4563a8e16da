"""One robot gives a rod to another over a gap: from hand to hand, or not at all."""

import math
from collections.abc import Callable
from functools import cache

import pytest

import lemma
from lemma.core.errors import InvalidActionError
from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.env.team.orders import Team
from lemma.motion.moves import Motion, Moves
from lemma.motion.outcome import Outcome
from lemma.planning.grounding import GeometricGrounder, ground_or_refuse
from lemma.planning.planner import find_plan
from lemma.planning.schedule import in_order, pose_jobs
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.could import could_of
from lemma.robots.reach import TRAVEL_HEIGHT_M, reach_of
from lemma.scene.objects.pad import PAD_RADIUS_M
from lemma.scene.objects.rod import END_GRASP_M, ROD, ROD_LENGTH_M
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import On
from lemma.tasks.instance import Instance
from lemma.tasks.rules import problems
from lemma.tasks.sampling import sample
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import TASKS
from lemma.tasks.teams.coalitions import needed
from lemma.tasks.teams.layouts import gap_out_of_reach
from lemma.tasks.zones import Territory

APART_M = 1.7
HIGH_M = 0.2
"""The rod is at least so high as it changes hands."""
LEFT, RIGHT = Pose2(-APART_M / 2, 0.0), Pose2(APART_M / 2, 0.0, math.pi)
ROBOTS = (RobotPlacement("ur5", "red", LEFT), RobotPlacement("ur5", "white", RIGHT))
START, PAD = Pose2(-0.75, -0.45, 2.0), Pose2(0.85, 0.5)
END = Pose2(PAD.x, PAD.y, 0.3)
GRIP = Pose2(-END_GRASP_M, 0.0)
GIVE = GroundedSubTask("robot_0", Primitive.GIVE, START @ GRIP, END @ GRIP)
ORDER = SubTask("robot_0", Primitive.GIVE, "rod", "blue_pad")


def table(pad: Pose2 = PAD) -> SceneSpec:
    """Two UR5 face to face over a gap, a rod with one and a pad with the other."""
    things = (
        ObjectPlacement("rod", "rod", START),
        ObjectPlacement("pad", "blue", pad),
    )
    return SceneSpec(ROBOTS, things, gap_out_of_reach(ROBOTS))


@cache
def instance(index: int = 0) -> Instance:
    return sample(TASKS["give"], "free", index).instance


def lies_on_the_pad(scene: Scene) -> bool:
    return On("rod", "blue_pad").holds(scene)


# --- The skill ---------------------------------------------------------------------


def test_a_rod_goes_from_hand_to_hand_in_the_air() -> None:
    simulation = Simulation(table())
    scene, held = simulation.scene, list[tuple[set[str], float]]()
    simulation.observers.append(
        lambda: held.append((set(scene.held()), float(scene.position("rod")[2])))
    )

    simulation.begin(GIVE)
    assert list(simulation.busy) == ["robot_0", "robot_1"]
    assert simulation.partner_of(GIVE) == "robot_1"
    with pytest.raises(InvalidActionError, match="robot_1 is busy"):
        simulation.begin(GroundedSubTask("robot_1", Primitive.MOVE, START, END))
    (ended,) = simulation.advance()
    assert ended.subtask == GIVE
    assert ended.result.outcome is Outcome.SUCCESS
    assert not simulation.busy
    assert not simulation.reservations.cells
    assert lies_on_the_pad(scene)
    assert scene.pose2("rod").distance(END) < 0.005
    both = [k for k, (who, _) in enumerate(held) if len(who) == 2]
    assert all("robot_1" not in who for who, _ in held[: both[0]])
    assert all("robot_0" not in who for who, _ in held[both[-1] + 1 :])
    assert min(height_m for _, height_m in held[both[0] : both[-1]]) > HIGH_M
    assert simulation.clocks["robot_0"] == simulation.clocks["robot_1"]


@pytest.mark.slow
def test_one_at_a_time_is_the_same_to_the_bit() -> None:
    one, other = Simulation(table()), Simulation(table())
    assert one.execute(GIVE).ok
    other.begin(GIVE)
    while other.busy:
        other.advance(other.time_s + 0.05)
    assert one.scene.state_hash() == other.scene.state_hash()


@pytest.mark.slow
@pytest.mark.parametrize("slow_one", ["robot_0", "robot_1"])
def test_two_are_as_slow_as_the_slower_one(slow_one: str) -> None:
    simulation = Simulation(table())
    usual_s = simulation.execute(GIVE).duration_s
    slow = Simulation(table())
    slow.pace = lambda robot, start_s, now_s: 0.5 if robot == slow_one else 1.0
    result = slow.execute(GIVE)
    assert result.ok
    assert lies_on_the_pad(slow.scene)
    assert 1.7 * usual_s < result.duration_s < 2.1 * usual_s


def test_what_the_taker_cannot_do_is_refused_for_both() -> None:
    """The pad is out of its reach."""
    simulation = Simulation(table())
    before = simulation.scene.pose("rod")
    far = Pose2(-0.6, 0.2, 0.1) @ GRIP
    result = simulation.execute(
        GroundedSubTask("robot_0", Primitive.GIVE, START @ GRIP, far)
    )
    assert result.outcome is Outcome.UNREACHABLE
    assert "robot_1" in result.explanation
    assert not simulation.busy
    away = math.dist(before.position, simulation.scene.pose("rod").position)
    assert away < 0.001


def test_without_an_end_there_is_nothing_to_give() -> None:
    simulation = Simulation(table())
    middle = GroundedSubTask("robot_0", Primitive.GIVE, START, END)
    assert simulation.partner_of(middle) == ""
    result = simulation.execute(middle)
    assert result.outcome is Outcome.INVALID


# --- One robot alone ---------------------------------------------------------------


def over_the_gap(simulation: Simulation, pushed_m: float) -> Motion:
    """One arm holds the rod by its end, as far out as it gets, and lets go."""
    moves, start = Moves(simulation.arms["robot_0"]), START @ GRIP
    low = (start.x, start.y, 0.018, start.yaw)
    yield from moves.grasp((start.x, start.y, TRAVEL_HEIGHT_M, start.yaw), low)
    yield from moves.rise(low, TRAVEL_HEIGHT_M)
    out_m = reach_of("ur5").travel_m - 0.01
    bearing = math.atan2(PAD.y - LEFT.y, PAD.x - LEFT.x)
    out = Pose2(LEFT.x, LEFT.y, bearing) @ Pose2(out_m, 0.0)
    hand = (out.x, out.y, TRAVEL_HEIGHT_M, out.yaw)
    yield from moves.to(hand, fly_by=True)
    down = (out.x, out.y, 0.06, out.yaw)
    yield from moves.lower(down)
    end = (out.x + pushed_m, out.y, 0.06, out.yaw)
    yield from moves.along(down, end, 0.5)
    yield from moves.release(end)


def onto_the_edge(simulation: Simulation, pushed_m: float) -> Motion:
    """One arm pushes the rod by its end over the edge of its table top."""
    moves, start = Moves(simulation.arms["robot_0"]), START @ GRIP
    low = (start.x, start.y, 0.018, start.yaw)
    yield from moves.grasp((start.x, start.y, TRAVEL_HEIGHT_M, start.yaw), low)
    end = (start.x + pushed_m, start.y, 0.022, start.yaw)
    yield from moves.along(low, end, 0.3)
    yield from moves.release(end)


@pytest.mark.parametrize(
    ("alone", "by_m"),
    [
        (over_the_gap, 0.0),
        pytest.param(over_the_gap, 0.1, marks=pytest.mark.slow),
        pytest.param(onto_the_edge, 0.5, marks=pytest.mark.slow),
    ],
)
def test_one_arm_alone_drops_it_into_the_gap(
    alone: Callable[[Simulation, float], Motion], by_m: float
) -> None:
    simulation = Simulation(table())
    scene = simulation.scene
    for _ in alone(simulation, by_m):
        simulation.tick(("robot_0",))
    simulation.rest(1.0)
    assert scene.fallen == ("rod",)
    assert not lies_on_the_pad(scene)


def test_one_robot_alone_cannot_put_it_there() -> None:
    for robot in ("robot_0", "robot_1"):
        simulation = Simulation(table())
        put = GroundedSubTask(robot, Primitive.MOVE, START, END)
        assert simulation.execute(put).outcome is Outcome.UNREACHABLE


def test_neither_robot_could_do_it_and_a_rod_falls_into_the_gap() -> None:
    """By the bound of any posture, with the rod in the hand as a means."""
    for index in range(5):
        found = instance(index)
        robots, gap = found.scene.robots, found.scene.gap_m
        assert gap is not None
        assert gap[1] - gap[0] > ROD_LENGTH_M
        placed = {one.name: one.pose for one in found.scene.objects}
        (on,) = found.goal.placements
        giver, taker = sorted(
            robots, key=lambda robot: robot.base.distance(placed["rod"])
        )
        alone_m = could_of(taker.arm).touch_m + 0.5 * ROD_LENGTH_M
        assert taker.base.distance(placed["rod"]) > alone_m
        carried_m = could_of(giver.arm).touch_m + 0.5 * ROD_LENGTH_M
        assert giver.base.distance(placed[on.bottom]) > carried_m + 0.05
        # No rod on the giver's table top gets to where the taker could touch it.
        edge = min(gap, key=lambda x: abs(x - giver.base.x))
        assert abs(taker.base.x - edge) > alone_m
        assert needed(Territory(robots, gap), found.scene.objects, found.goal) == (0, 1)
        assert problems(found) == ()


def test_with_the_pad_within_the_rods_length_one_robot_is_enough() -> None:
    goal = instance().goal.from_pairs((("rod", "blue_pad"),))
    near = LEFT.x + could_of("ur5").touch_m + 0.5 * ROD_LENGTH_M + PAD_RADIUS_M
    for x, who in ((near, (0,)), (near + 0.2, (0, 1))):
        spec = table(Pose2(x, 0.0))
        territory = Territory(ROBOTS, spec.gap_m)
        assert needed(territory, spec.objects, goal) == who


# --- Orders ------------------------------------------------------------------------


def test_one_robot_has_no_plan_and_the_taker_cannot_give() -> None:
    found = instance()
    now = SymbolicState.observe(Scene(found.scene))
    grounder, (on,) = GeometricGrounder(found.scene), found.goal.placements
    plan = find_plan(now, found.goal, grounder)
    assert plan is not None
    (step,) = plan.steps
    assert {step.grounded.robot, step.partner} == set(found.scene.robot_names)
    refused = ground_or_refuse(
        SubTask(step.partner, Primitive.GIVE, on.top, on.bottom), now, grounder
    )
    assert getattr(refused, "outcome", None) is Outcome.UNREACHABLE
    for robot in found.scene.robot_names:
        assert find_plan(now, found.goal, grounder, team=(robot,)) is None
        refused = ground_or_refuse(
            SubTask(robot, Primitive.GIVE, on.top, "shared"), now, grounder
        )
        assert getattr(refused, "outcome", None) is Outcome.INVALID
    jobs = pose_jobs(now, plan, found.goal, grounder)
    schedule = in_order(jobs, (0,))
    assert set(schedule.team(0)) == set(found.scene.robot_names)
    assert len(schedule.stays(0)) == 4


@pytest.mark.slow
def test_an_order_takes_the_partner_and_waits_until_it_is_free() -> None:
    cube = ObjectPlacement("cube", "blue", Pose2(0.95, -0.45))
    pad = ObjectPlacement("pad", "red", Pose2(0.65, -0.45))
    spec = table()
    scene = SceneSpec(spec.robots, (*spec.objects, cube, pad), spec.gap_m)
    found = Instance(
        "give", "own", 0, scene, instance().goal.from_pairs((("rod", "blue_pad"),)),
        {"high_level": "Give it."}, (),
    )  # fmt: skip
    episode = Episode(found)
    team = Team(episode)
    move = SubTask("robot_1", Primitive.MOVE, "blue_cube", "red_pad")
    assert team.order(move) is None
    assert team.order(ORDER) is None
    assert team.waits_for == {"robot_0": ("robot_1",)}
    (moved,) = team.advance()
    assert moved.subtask == move
    assert team.works_on("robot_1") == "robot_0"
    assert team.free == ()
    episode.advance(episode.simulation.time_s + 7.0)
    middle = episode.snapshot(), team.state()
    (given,) = team.advance()
    assert given.result.ok
    assert given.partner == "robot_1"
    assert lies_on_the_pad(episode.simulation.scene)
    again = Episode(found)
    again.restore(middle[0])
    other = Team(again)
    other.restore(middle[1])
    assert other.advance()[0].result == given.result
    hashes = {e.simulation.scene.state_hash() for e in (episode, again)}
    assert len(hashes) == 1


@pytest.mark.slow
def test_the_giver_may_be_told_in_an_environment() -> None:
    env = lemma.make("give", level="plan", acting="together")
    env.reset(seed=0)
    pad = env.episode.instance.goal.placements[0].bottom
    orders = [SubTask(f"robot_{k}", Primitive.GIVE, "rod", pad) for k in range(2)]
    (order,) = (one for one in orders if one in env.valid_orders(one.robot))
    _, _, _, _, info = env.step(env.encode(order))
    (ended,) = info["ended"]
    assert ended["robot"] == order.robot
    assert ended["outcome"] == "success"
    assert info["success"]


def test_a_rod_is_held_at_either_end() -> None:
    assert ROD.ends is not None
    one, other = (grasp.at for grasp in ROD.ends)
    assert one.distance(other) == pytest.approx(2.0 * END_GRASP_M)
