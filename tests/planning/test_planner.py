"""The planner: shortest, of highest utility, the same in the mirror, for any goal."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations, product

import pytest
from recorded_episodes import first_instance
from small_tables import cube, facing, pad
from tiers import slow_but

from lemma.core.poses import Pose, Pose2
from lemma.planning.grounding import GeometricGrounder, GroundedOption
from lemma.planning.planner import Plan, find_plan, utility
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import SHARED, STICK
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.suite import SUITE, TASKS, load_instance

TEN = range(10)


def look(spec: SceneSpec) -> tuple[SymbolicState, GeometricGrounder]:
    return SymbolicState.observe(Scene(spec)), GeometricGrounder(spec)


def planned(instance: Instance) -> tuple[SymbolicState, GeometricGrounder, Plan]:
    now, grounder = look(instance.scene)
    plan = find_plan(now, instance.goal, grounder)
    assert plan is not None
    return now, grounder, plan


# --- Of the suite ------------------------------------------------------------------


@pytest.mark.parametrize("task", slow_but(SUITE, "pass", "hook_stack"))
def test_a_plan_is_a_chain_as_long_as_the_task_says_that_ends_in_the_goal(
    task: str,
) -> None:
    for index in TEN:
        instance = load_instance(task, "test", index)
        now, grounder, plan = planned(instance)
        assert len(set(plan.subtasks)) == len(plan.subtasks) == TASKS[task].subtasks
        # Both robots work.
        assert {subtask.robot for subtask in plan.subtasks} == {"robot_0", "robot_1"}
        total = 0.0
        for step in plan.steps:
            again = grounder.ground(step.subtask, now)
            assert again == step
            total += utility(step, now, instance.goal)
            now = step.after
        assert total == pytest.approx(plan.utility)
        assert sum(s.duration_s for s in plan.steps) == pytest.approx(plan.duration_s)
        assert plan.duration_s < 100.0
        for top, bottom in instance.goal.pairs:
            assert now.supports[top] == bottom


# --- Highest utility ---------------------------------------------------------------


def all_subtasks(now: SymbolicState, robots: tuple[str, ...]) -> Iterator[SubTask]:
    """Everything that could be said: any robot, primitive, pick and place."""
    movable = tuple(now.labels)
    for robot, pick in product(robots, movable):
        for place in (*now.poses, SHARED):
            yield SubTask(robot, Primitive.MOVE, pick, place)
    if STICK in now.poses:
        for robot, target in product(robots, now.supports):
            for primitive in (
                Primitive.PREHOOK,
                Primitive.HOOK,
                Primitive.PREPOKE,
                Primitive.POKE,
            ):
                yield SubTask(robot, primitive, STICK, target)


def best_of_all(
    now: SymbolicState, goal: Goal, grounder: GeometricGrounder, steps: int
) -> float:
    """The highest utility of any plan of so many sub-tasks, by trying them all."""
    if all(now.supports[top] == bottom for top, bottom in goal.pairs):
        return 0.0
    # Every open conjunct takes a step of its own, or there is no way any more.
    open_ = sum(now.supports[top] != bottom for top, bottom in goal.pairs)
    if steps < open_:
        return -math.inf
    best = -math.inf
    for subtask in all_subtasks(now, tuple(grounder.robots)):
        if steps == 1 and (subtask.pick, subtask.place) not in goal.pairs:
            continue
        step = grounder.ground(subtask, now)
        if step is None:
            continue
        rest = best_of_all(step.after, goal, grounder, steps - 1)
        best = max(best, utility(step, now, goal) + rest)
    return best


def without_distractors(instance: Instance) -> Instance:
    needed = [o for o in instance.scene.objects if o.name not in instance.distractors]
    scene = replace(instance.scene, objects=tuple(needed))
    return replace(instance, scene=scene, distractors=())


@pytest.mark.parametrize(
    ("task", "count", "least"),
    [
        ("stack", 5, 0.0),
        ("hook", 5, 0.0),
        *slow_but(
            [
                ("pass", 5, 0.0),
                ("poke", 5, 0.0),
                ("pass2", 3, 0.0),
                ("poke_stack", 3, 0.0),
            ]
        ),
        # Of two free spots for a cube the nearer to its end can be the farther now.
        ("stack2", 5, 0.06),
    ],
)
def test_no_other_plan_is_worth_more(task: str, count: int, least: float) -> None:
    for index in range(count):
        instance = without_distractors(load_instance(task, "test", index))
        now, grounder, plan = planned(instance)
        best = best_of_all(now, instance.goal, grounder, len(plan.steps))
        # States that differ in centimetres only are one to the planner.
        assert best - 0.005 - least <= plan.utility <= best + 1e-9


@pytest.mark.parametrize("task", ["pass", "stack"])
def test_distractors_do_not_make_a_better_plan(task: str) -> None:
    found = (load_instance(task, "test", index) for index in range(60))
    instance = next(i for i in found if len(i.distractors) == 2)
    now, grounder, plan = planned(instance)
    assert plan.utility == pytest.approx(best_of_all(now, instance.goal, grounder, 2))


def test_of_two_able_robots_the_better_is_sent() -> None:
    """Both reach both; now one, now the other is nearer to the middle of its ring."""
    goal = Goal.from_pairs((("red_cube", "blue_pad"),))
    sent = set()
    for x in (-0.08, 0.08):
        now, grounder = look(facing("ur5", cube("red", x, 0.08), pad("blue", x, -0.1)))
        plan = find_plan(now, goal, grounder)
        assert plan is not None
        (subtask,) = plan.subtasks
        options = {}
        for name in grounder.robots:
            step = grounder.ground(replace(subtask, robot=name), now)
            assert step is not None
            options[name] = utility(step, now, goal)
        assert options[subtask.robot] == max(options.values()) == plan.utility
        sent.add(subtask.robot)
    assert sent == {"robot_0", "robot_1"}


# --- Any goal ----------------------------------------------------------------------


THREE = facing(
    "ur5",
    cube("red", -0.45, 0.2),
    cube("blue", 0.0, -0.1),
    cube("green", 0.45, 0.1),
    pad("white", -0.3, -0.2),
)


def plan_for(*pairs: tuple[str, str], spec: SceneSpec = THREE) -> Plan | None:
    now, grounder = look(spec)
    return find_plan(now, Goal.from_pairs(pairs), grounder)


def test_a_goal_that_holds_needs_nothing() -> None:
    scene = Scene(THREE)
    scene.set_pose("red_cube", Pose((-0.3, -0.2, 0.06)))
    goal = Goal.from_pairs((("red_cube", "white_pad"),))
    plan = find_plan(SymbolicState.observe(scene), goal, GeometricGrounder(THREE))
    assert plan is not None
    assert plan.steps == ()
    assert plan.utility == 0.0


@pytest.mark.parametrize("order", list(permutations(["red", "blue", "green"])))
def test_a_tower_of_three_is_built_from_below(order: tuple[str, str, str]) -> None:
    top, middle, bottom = (f"{color}_cube" for color in order)
    for pairs in permutations([(top, middle), (middle, bottom)]):
        plan = plan_for(*pairs)
        assert plan is not None
        placed = [(subtask.pick, subtask.place) for subtask in plan.subtasks]
        assert placed.index((middle, bottom)) < placed.index((top, middle))


def test_what_stands_on_it_is_taken_off_first() -> None:
    scene = Scene(THREE)
    scene.set_pose("green_cube", Pose((0.0, -0.1, 0.075)))
    now = SymbolicState.observe(scene)
    assert now.supports["green_cube"] == "blue_cube"
    goal = Goal.from_pairs((("blue_cube", "white_pad"),))
    plan = find_plan(now, goal, GeometricGrounder(THREE))
    assert plan is not None
    assert [subtask.pick for subtask in plan.subtasks] == ["green_cube", "blue_cube"]


def test_a_tower_is_turned_over() -> None:
    """Red on blue becomes blue on red."""
    scene = Scene(THREE)
    scene.set_pose("red_cube", Pose((0.0, -0.1, 0.075)))
    goal = Goal.from_pairs((("blue_cube", "red_cube"),))
    plan = find_plan(SymbolicState.observe(scene), goal, GeometricGrounder(THREE))
    assert plan is not None
    assert [(s.pick, s.place) for s in plan.subtasks] == [
        ("red_cube", SHARED),
        ("blue_cube", "red_cube"),
    ]


def test_an_occupied_pad_is_cleared() -> None:
    scene = Scene(THREE)
    scene.set_pose("blue_cube", Pose((-0.3, -0.2, 0.06)))
    goal = Goal.from_pairs((("red_cube", "white_pad"),))
    plan = find_plan(SymbolicState.observe(scene), goal, GeometricGrounder(THREE))
    assert plan is not None
    assert [subtask.pick for subtask in plan.subtasks] == ["blue_cube", "red_cube"]


def test_a_circle_has_no_plan() -> None:
    assert plan_for(("red_cube", "blue_cube"), ("blue_cube", "red_cube")) is None


def test_what_nobody_can_bring_has_no_plan() -> None:
    far = facing("ur5", cube("red", 0.0, 0.9), pad("white", -0.3, -0.2))
    assert plan_for(("red_cube", "white_pad"), spec=far) is None


def test_there_is_no_plan_longer_than_the_time() -> None:
    instance = load_instance("hook_stack", "test", 0)
    now, grounder, plan = planned(instance)
    limit = plan.duration_s
    assert find_plan(now, instance.goal, grounder, limit_s=limit + 0.01) == plan
    assert find_plan(now, instance.goal, grounder, limit_s=20.0) is None


def test_three_in_a_row_hand_on_in_the_regions_of_pairs() -> None:
    """No place is reached by all three; the outer two share none with each other."""
    away = THREE.robots[1].base.x
    base = Pose2(3 * away, 0.0, math.pi)
    third = RobotPlacement("ur5", "red", base)
    beyond = ObjectPlacement("pad", "green", Pose2(3 * away - 0.3, -0.3))
    spec = SceneSpec((*THREE.robots, third), (*THREE.objects, beyond))
    assert spec.regions == {"shared_01": (0, 1), "shared_12": (1, 2)}
    now, grounder = look(spec)
    plan = find_plan(now, Goal.from_pairs((("red_cube", "green_pad"),)), grounder)
    assert plan is not None
    assert [(s.robot, s.place) for s in plan.subtasks] == [
        ("robot_0", "shared_01"),
        ("robot_1", "shared_12"),
        ("robot_2", "green_pad"),
    ]
    assert {s.pick for s in plan.subtasks} == {"red_cube"}
    goal = Goal.from_pairs((("red_cube", "white_pad"),))
    alone = find_plan(now, goal, grounder, team=("robot_0",))
    assert alone is not None
    assert [subtask.robot for subtask in alone.subtasks] == ["robot_0"]


def test_robots_that_all_reach_a_place_have_one_region() -> None:
    assert THREE.regions == {"shared": (0, 1)}
    alone = SceneSpec(THREE.robots[:1], ())
    assert alone.regions == {"shared": (0,)}
    crowd = SceneSpec((*THREE.robots, THREE.robots[0]), ())
    assert crowd.regions == {"shared": (0, 1, 2)}


# --- The mirror --------------------------------------------------------------------


def turned(spec: SceneSpec) -> SceneSpec:
    """Half a turn of everything about the middle of the table; robots swap."""

    def half(pose: Pose2) -> Pose2:
        return Pose2(0.0, 0.0, math.pi) @ pose

    return SceneSpec(
        tuple(replace(robot, base=half(robot.base)) for robot in spec.robots[::-1]),
        tuple(replace(placed, pose=half(placed.pose)) for placed in spec.objects),
        None if spec.gap_m is None else (-spec.gap_m[1], -spec.gap_m[0]),
    )


@pytest.mark.parametrize("task", slow_but(SUITE, "hook"))
def test_half_a_turn_of_the_table_mirrors_the_plan(task: str) -> None:
    other = {"robot_0": "robot_1", "robot_1": "robot_0"}
    for index in TEN:
        instance = load_instance(task, "test", index)
        plan = planned(instance)[2]
        mirrored = planned(replace(instance, scene=turned(instance.scene)))[2]
        expected = [replace(s, robot=other[s.robot]) for s in plan.subtasks]
        assert list(mirrored.subtasks) == expected
        assert mirrored.utility == pytest.approx(plan.utility, abs=0.05)


def test_a_grounding_is_mirrored_to_the_pose() -> None:
    """Where the place is not chosen from a grid, poses turn with the table."""
    instance = first_instance("hook", "ur5+ur10")
    now, grounder = look(instance.scene)
    mirror, other = look(turned(instance.scene))
    names = dict(zip(grounder.robots, tuple(grounder.robots)[::-1], strict=True))
    plan = planned(instance)[2]
    compared = 0
    for subtask in (plan.subtasks[0], *all_subtasks(now, tuple(grounder.robots))):
        if subtask.place == SHARED:
            continue
        step = grounder.ground(subtask, now)
        there = other.ground(replace(subtask, robot=names[subtask.robot]), mirror)
        assert (step is None) == (there is None)
        if step is None or there is None:
            continue
        compared += 1
        assert there.quality == pytest.approx(step.quality)
        assert there.duration_s == pytest.approx(step.duration_s)
        assert_turned(step, there)
    assert compared > 0


def assert_turned(step: GroundedOption, there: GroundedOption) -> None:
    for a, b in (
        (step.grounded.pick, there.grounded.pick),
        (step.grounded.place, there.grounded.place),
    ):
        back = Pose2(0.0, 0.0, math.pi) @ b
        assert back.distance(a) < 1e-6
        # The fingers are alike: half a turn of the gripper is the same.
        assert math.cos(2.0 * (back.yaw - a.yaw)) == pytest.approx(1.0, abs=1e-6)
