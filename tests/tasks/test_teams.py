"""Teams of three and four: where they stand, who is needed, and what they solve.

Everything holds for every layout and every family that is registered.
"""

import math
from itertools import combinations

import numpy as np
import pytest
from recorded_episodes import acted_together, played
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.env.simulation import Simulation
from lemma.evaluation.run.watches import ClearanceWatch
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.could import could_of
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.pad import PAD_RADIUS_M
from lemma.scene.objects.plank import PLANK_LENGTH_M
from lemma.scene.objects.rod import ROD_LENGTH_M
from lemma.scene.objects.tray import HANDLE_GRASP_M
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal, On
from lemma.tasks.instance import Instance
from lemma.tasks.names import FAMILIES
from lemma.tasks.rules import problems
from lemma.tasks.suite import TASKS, load_instance
from lemma.tasks.teams.coalitions import HANDLE_DISC_M, needed
from lemma.tasks.teams.layouts import LAYOUTS
from lemma.tasks.zones import Territory

LARGER = [name for name in LAYOUTS if LAYOUTS[name].size > 2]
ARMS_APART_M = 0.05


def robots_of(layout: str, draw: int = 0) -> tuple[RobotPlacement, ...]:
    record, rng = LAYOUTS[layout], stream("test", "layout", layout, draw)
    placed = record.place(("ur5",) * record.size, rng)
    assert placed is not None
    return placed


# --- Layouts -----------------------------------------------------------------------


@pytest.mark.parametrize("layout", slow_but(LARGER, LARGER[0]))
def test_robots_of_a_layout_differ_in_color_and_neighbors_share(layout: str) -> None:
    record = LAYOUTS[layout]
    for draw in range(5):
        robots = robots_of(layout, draw)
        assert len({robot.color for robot in robots}) == record.size
        assert record.allows(robots)
        regions = set(SceneSpec(robots, ()).regions.values())
        everybody = {tuple(range(record.size))}
        assert regions in ({tuple(sorted(n)) for n in record.neighbors}, everybody)
        moved = [*robots[:-1], RobotPlacement("ur5", "red", Pose2(0.0, 0.0))]
        assert not record.allows(moved)


@pytest.mark.parametrize("layout", LARGER)
def test_waiting_arms_are_clear_of_each_other(layout: str) -> None:
    simulation = Simulation(SceneSpec(robots_of(layout), ()))
    watch = ClearanceWatch(simulation)
    for _ in range(10):
        simulation.tick(())
    assert watch.least_m > ARMS_APART_M


@pytest.mark.parametrize("layout", LARGER)
def test_roles_keep_neighbors(layout: str) -> None:
    record = LAYOUTS[layout]
    pairs = {frozenset(pair) for pair in record.neighbors}
    for order in record.orders:
        assert sorted(order) == list(range(record.size))
        assert {frozenset((order[i], order[j])) for i, j in record.neighbors} == pairs


def test_a_team_of_another_size_is_refused() -> None:
    with pytest.raises(InvalidConfigError, match="are set for 3"):
        lemma.make("relay", split="free", robots=("ur5", "ur5")).reset(seed=0)


# --- The robots that are needed ----------------------------------------------------


def cube(color: str, x: float, y: float) -> ObjectPlacement:
    return ObjectPlacement("cube", color, Pose2(x, y))


def test_whoever_could_be_done_without_is_found() -> None:
    """Three in a row, 1.4 m apart: what matters is who could touch what."""
    robots = tuple(
        RobotPlacement("ur5", color, Pose2(x, -0.6, 0.5 * math.pi))
        for x, color in ((-1.4, "red"), (0.0, "white"), (1.4, "blue"))
    )
    far = ObjectPlacement("pad", "red", Pose2(1.5, 0.0))
    mine = ObjectPlacement("pad", "blue", Pose2(-1.2, 0.0))
    start, goal = cube("red", -1.5, 0.1), Goal((On("red_cube", "red_pad"),))
    territory = Territory(robots)
    assert needed(territory, (start, far), goal) == (0, 1, 2)
    near = Goal((On("red_cube", "blue_pad"),))
    assert needed(territory, (start, mine), near) == (0,)
    # A long row of cubes gets from one end to where the other could touch it.
    row = [
        cube(color, -1.5, 0.3 + 0.15 * k) for k, color in enumerate(("pink", "blue"))
    ]
    more = [cube(color, 0.0, 0.15 * k) for k, color in enumerate(("white", "green"))]
    assert 1 in needed(territory, (start, far, *more), goal)
    assert 1 in needed(territory, (start, far, *row), goal)
    closer = tuple(
        RobotPlacement(r.arm, r.color, Pose2(0.85 * r.base.x, r.base.y, r.base.yaw))
        for r in robots
    )
    assert 1 in needed(Territory(closer), (start, far), goal)
    assert 1 not in needed(Territory(closer), (start, far, *row), goal)


def could(robot: RobotPlacement, kind: str, at: Pose2) -> bool:
    """Whether a robot could touch a thing or put another on it, by the bound alone."""
    reach, away = could_of(robot.arm), robot.base.distance(at)
    cube_m = math.sqrt(0.5) * CUBE_EDGE_M
    sizes = {"cube": cube_m, "pad": PAD_RADIUS_M}
    sizes |= {"plank": 0.5 * PLANK_LENGTH_M, "rod": 0.5 * ROD_LENGTH_M}
    size_m = sizes.get(kind, HANDLE_DISC_M)
    return away - size_m < max(reach.touch_m, reach.place_m)


def spots(placed: ObjectPlacement) -> list[Pose2]:
    """Where a thing has to be held: at its middle, or at both ends of a tray."""
    if placed.kind not in ("tray", "rack"):
        return [placed.pose]
    return [placed.pose @ Pose2(side * HANDLE_GRASP_M, 0.0) for side in (-1, 1)]


def may_act(instance: Instance) -> list[str]:
    """The robots but one that a rule excludes."""
    rule = instance.goal.rule
    excluded = None if rule is None else rule.robot
    return [name for name in instance.scene.robot_names if name != excluded]


@pytest.mark.parametrize("task", FAMILIES)
def test_nobody_can_be_done_without(task: str) -> None:
    """It alone could touch or carry a thing, or it joins two that share nothing."""
    for index in range(60):
        instance = load_instance(task, "test", index)
        scene, goal = instance.scene, instance.goal
        team = [scene.robot_names.index(name) for name in may_act(instance)]
        who = {
            (name, at): [i for i in team if could(scene.robots[i], placed.kind, at)]
            for name in goal.entities
            for placed in [scene.placement(name)]
            for at in spots(placed)
        }
        carry = [
            [i for i in team if not scene.robots[i].overload("", scene.placement(top))]
            for top, _ in goal.pairs
        ]
        owners = {able[0] for able in (*who.values(), *carry) if len(able) == 1}
        for absent in set(team) - owners:
            ends = [scene.robots[i] for i in team if i != absent]
            assert len(ends) == 2
            reaches = [could_of(robot.arm) for robot in ends]
            touch_m = sum(max(r.touch_m, r.place_m) for r in reaches)
            assert ends[0].base.distance(ends[1].base) > touch_m + CUBE_EDGE_M
            assert {len(able) for able in who.values()} == {1}


@pytest.mark.parametrize("task", slow_but(FAMILIES, "relay"))
def test_no_coalition_has_a_plan(task: str) -> None:
    for index in range(2):
        instance = load_instance(task, "val", index)
        now = SymbolicState.observe(Scene(instance.scene))
        robots = may_act(instance)
        grounder = GeometricGrounder(instance.scene)
        for coalition in combinations(robots, len(robots) - 1):
            assert find_plan(now, instance.goal, grounder, team=coalition) is None


# --- Frozen lists ------------------------------------------------------------------


@pytest.mark.parametrize("task", slow_but(FAMILIES, "relay"))
def test_tables_are_those_that_the_sampler_sets(task: str) -> None:
    record = TASKS[task]
    tables = [load_instance(task, "test", index) for index in range(60)]
    teams = {tuple(r.arm for r in one.scene.robots) for one in tables}
    both_ways = LAYOUTS[record.layout].size == 2
    assert teams == {*record.teams, *(t[::-1] for t in record.teams if both_ways)}
    counts = {len(one.distractors) for one in tables}
    assert counts == set(range(record.distractors[0], record.distractors[1] + 1))
    for one in tables[:3]:
        assert problems(one) == ()


@pytest.mark.parametrize("task", slow_but(FAMILIES, "relay"))
def test_the_expert_solves_it_one_at_a_time_and_together(task: str) -> None:
    """In turns only where that can be."""
    alone, together = played(task), acted_together(task)
    assert all(step.result.ok for step in together.steps)
    assert alone.success
    assert together.success
    assert len(alone.record.subtasks) == TASKS[task].subtasks == len(together.steps)
    assert together.elapsed_s <= alone.elapsed_s
    assert together.clearance_m > ARMS_APART_M


def test_regions_of_pairs_are_actions_at_plan_level() -> None:
    env = lemma.make("line", level="plan", split="val", index=0)
    expert = lemma.ExpertPolicy(env)
    env.reset()
    rng, done, reward, steps = np.random.default_rng(0), False, 0.0, 0
    env.action_space.seed(int(rng.integers(100)))
    while not done:
        action = expert.act()
        assert env.action_space.contains(action)
        _, reward, terminated, truncated, _ = env.step(action)
        done, steps = terminated or truncated, steps + 1
    assert reward == 1.0
    assert steps == TASKS["line"].subtasks + 1  # and stop
