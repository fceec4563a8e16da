"""The expert does what it planned, and plans again when the world did not."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from recorded_episodes import EPISODES, first_instance, recorded
from tiers import slow_but

from lemma.core.poses import Pose, Pose2
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.motion.outcome import Outcome, SkillResult
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.could import could_of
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import STICK
from lemma.scene.scene import Scene
from lemma.scene.table import lies_on_table
from lemma.tasks.drags import stick_gap
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import STOP, Primitive
from lemma.tasks.suite import SUITE, TASKS, load_instance

TEAM = "ur5+ur10"
Disturbance = Callable[[Episode], None]


@pytest.mark.parametrize(("task", "team"), slow_but(EPISODES, *EPISODES[1::3]))
def test_every_team_solves_every_task_as_planned(task: str, team: str) -> None:
    episode = recorded(task, team)
    assert episode.success
    assert episode.elapsed_s < 100.0
    assert len(episode.steps) == TASKS[task].subtasks
    assert all(step.result.outcome is Outcome.SUCCESS for step in episode.steps)
    assert episode.replans == 0
    scene = Scene(episode.instance.scene)
    plan = find_plan(
        SymbolicState.observe(scene),
        episode.instance.goal,
        GeometricGrounder(episode.instance.scene),
    )
    assert plan is not None
    assert plan.subtasks == tuple(step.subtask for step in episode.steps)


@pytest.mark.slow
def test_hooking_and_stacking_is_quick_enough() -> None:
    times = [recorded(task, team).elapsed_s for task, team in EPISODES[-3:]]
    assert EPISODES[-1][0] == "hook_stack"
    assert sum(times) / len(times) < 70.0


# --- Deciding ----------------------------------------------------------------------


def start(instance: Instance) -> tuple[Episode, Expert]:
    episode = Episode(instance)
    return episode, Expert(episode.simulation.scene, instance.goal)


def test_a_reached_goal_is_the_end() -> None:
    episode, expert = start(first_instance("pass", TEAM))
    assert list(solve(episode, expert))
    assert episode.stopped
    assert expert.act() == (STOP, None)


def test_where_nothing_helps_it_stops() -> None:
    """Both cubes far from everybody, and no stick in the world."""
    instance = first_instance("stack", TEAM)
    episode, expert = start(instance)
    for k, name in enumerate(instance.goal.entities):
        episode.simulation.scene.set_pose(name, Pose((0.2 * k, 1.0, 0.025)))
    assert expert.plan() is None
    assert expert.act() == (STOP, None)
    assert list(solve(episode, expert)) == []
    assert episode.stopped
    assert episode.failure == "goal_not_reached"


def test_a_smaller_team_finds_no_plan() -> None:
    instance = first_instance("stack", TEAM)
    episode = Episode(instance)
    for robot in ("robot_0", "robot_1"):
        expert = Expert(episode.simulation.scene, instance.goal, team=(robot,))
        assert expert.act() == (STOP, None)


def test_a_plan_is_kept_while_the_world_does_as_predicted() -> None:
    instance = first_instance("hook_stack", TEAM)
    _, expert = start(instance)
    plan = expert.plan()
    assert plan is not None
    assert expert.replans == -1
    subtask, grounded = expert.act()
    assert expert.replans == 0
    assert subtask == plan.subtasks[0]
    assert grounded == plan.steps[0].grounded


# --- Disturbances ------------------------------------------------------------------


def play(instance: Instance, after: int, disturb: Disturbance) -> Expert:
    """Let the expert work, and somebody else meddle after so many sub-tasks."""
    episode, expert = start(instance)
    for count, step in enumerate(solve(episode, expert), 1):
        assert step.result.ok, step.result.explanation
        if count == after:
            disturb(episode)
    assert episode.stopped
    assert episode.is_success
    return expert


def free(scene: Scene, name: str, at: Pose2) -> bool:
    """Whether a cube can be put down somewhere, with room for fingers around it."""
    if not lies_on_table(scene.spec.gap_m, at, 0.05):
        return False
    for other in scene.spec.object_names:
        pose = scene.pose2(other)
        gap = stick_gap(pose, *at.xy) if other == STICK else pose.distance(at)
        if other != name and gap < (0.08 if other == STICK else 0.13):
            return False
    return True


def solvable(episode: Episode) -> bool:
    scene = episode.simulation.scene
    now = SymbolicState.observe(scene)
    return (
        find_plan(now, episode.instance.goal, GeometricGrounder(scene.spec)) is not None
    )


def shove(episode: Episode, name: str, distance_m: float) -> None:
    """Move a cube in the first direction that leaves the instance solvable."""
    scene = episode.simulation.scene
    before = scene.pose(name)
    here = scene.pose2(name)
    for k in range(16):
        angle = math.tau * k / 16
        there = Pose2(
            here.x + distance_m * math.cos(angle), here.y + distance_m * math.sin(angle)
        )
        if free(scene, name, there):
            scene.set_pose(name, Pose((there.x, there.y, 0.025)))
            if solvable(episode):
                episode.simulation.rest(0.1)
                return
            scene.set_pose(name, before)
    pytest.fail("There is nowhere to shove it.")


def carried(task: str, which: int) -> str:
    """Object of the expert's sub-task of that number."""
    subtask = recorded(task, TEAM).steps[which].subtask
    return subtask.pick if subtask.primitive is Primitive.MOVE else subtask.place


@pytest.mark.parametrize("task", slow_but(SUITE, "poke"))
def test_a_cube_shoved_by_ten_centimetres_is_found_again(task: str) -> None:
    name = carried(task, 0)
    expert = play(first_instance(task, TEAM), 1, lambda e: shove(e, name, 0.1))
    assert expert.replans >= 1


@pytest.mark.parametrize(
    "task", slow_but(["pass", "pass2", "stack", "stack2"], "stack")
)
def test_a_cube_taken_back_is_brought_again(task: str) -> None:
    """Out of the shared region, to where it was: only its first robot reaches it."""
    instance = first_instance(task, TEAM)
    name = carried(task, 0)

    def take_back(episode: Episode) -> None:
        scene = episode.simulation.scene
        x, y = scene.spec.placement(name).pose.xy
        scene.set_pose(name, Pose((x, y, 0.025)))

    expert = play(instance, 1, take_back)
    assert expert.replans == 1


@pytest.mark.parametrize("task", slow_but(SUITE, "stack"))
def test_the_last_cube_is_put_back_where_it_was(task: str) -> None:
    """It falls off its tower, or is pushed off its pad, and comes to rest beside it."""
    name, away_m = carried(task, -1), 0.14 if "stack" in task else 0.15
    count = TASKS[task].subtasks
    expert = play(first_instance(task, TEAM), count, lambda e: shove(e, name, away_m))
    assert expert.replans == 1


@pytest.mark.parametrize(
    "task", slow_but(["poke", "poke_stack", "hook", "hook_stack"], "poke")
)
def test_a_stick_kicked_aside_is_prepared_again(task: str) -> None:
    def kick(episode: Episode) -> None:
        scene = episode.simulation.scene
        pose = scene.pose(STICK)
        # Sideways, where it meets nothing.
        x, y = (scene.pose2(STICK) @ Pose2(0.0, -0.04)).xy
        scene.set_pose(STICK, Pose((x, y, pose.position[2]), pose.quaternion))
        assert not SymbolicState.observe(scene).is_prepared(
            recorded(task, TEAM).steps[1].subtask.primitive, carried(task, 1)
        )

    expert = play(first_instance(task, TEAM), 1, kick)
    assert expert.replans >= 1


@pytest.mark.slow
@pytest.mark.parametrize("task", slow_but(["poke", "hook"], "hook"))
def test_a_cube_pushed_out_of_reach_again_is_dragged_again(task: str) -> None:
    name = carried(task, 1)

    def push_back(episode: Episode) -> None:
        scene = episode.simulation.scene
        pose = scene.spec.placement(name).pose
        scene.set_pose(name, Pose((*pose.xy, 0.025)))
        for robot in scene.spec.robots:
            beyond_m = could_of(robot.arm).radius_m(CUBE.disc_m)
            assert robot.base.distance(pose) > beyond_m

    play(first_instance(task, TEAM), 2, push_back)


# --- Failures ----------------------------------------------------------------------


def snatch_once(episode: Episode, when: Callable[[], bool], put: Pose) -> list[bool]:
    """Somebody snatches the first cube of the goal and puts it down elsewhere."""
    name = recorded(episode.instance.task, TEAM).steps[0].subtask.pick
    done: list[bool] = []

    def look() -> None:
        if not done and when():
            done.append(True)
            episode.simulation.scene.set_pose(name, put)

    episode.simulation.observers.append(look)
    return done


@pytest.mark.parametrize(
    "task", slow_but(["pass", "pass2", "stack", "stack2"], "stack")
)
@pytest.mark.parametrize("outcome", [Outcome.MISSED_GRASP, Outcome.DROPPED])
def test_after_a_failed_skill_it_tries_again(task: str, outcome: Outcome) -> None:
    instance = first_instance(task, TEAM)
    episode, expert = start(instance)
    first = recorded(task, TEAM).steps[0].subtask
    scene, arm = episode.simulation.scene, episode.simulation.arms[first.robot]
    home = scene.pose(first.pick)
    if outcome is Outcome.MISSED_GRASP:
        done = snatch_once(episode, lambda: arm.opening_m == 0.0, Pose((0.0, 1.0, 0.1)))
    else:
        done = snatch_once(
            episode, lambda: scene.pose(first.pick).position[2] > 0.15, home
        )
    outcomes = []
    for step in solve(episode, expert):
        outcomes.append(step.result.outcome)
        if len(outcomes) == 1:
            scene.set_pose(first.pick, home)
            episode.simulation.rest(0.1)
    assert done
    assert outcomes[0] is outcome
    assert outcomes[1:] == [Outcome.SUCCESS] * TASKS[task].subtasks
    assert expert.replans == 1
    assert episode.is_success


@pytest.mark.parametrize("task", slow_but(["hook", "poke"], "hook"))
def test_after_a_stick_slipped_from_the_hand_it_tries_again(task: str) -> None:
    instance = first_instance(task, TEAM)
    episode, expert = start(instance)
    scene = episode.simulation.scene
    home = scene.pose(STICK)
    done: list[bool] = []

    def look() -> None:
        if not done and scene.pose(STICK).position[2] > 0.2:
            done.append(True)
            scene.set_pose(STICK, home)

    episode.simulation.observers.append(look)
    outcomes = [step.result.outcome for step in solve(episode, expert)]
    assert outcomes[0] is Outcome.DROPPED
    assert outcomes[1:] == [Outcome.SUCCESS] * TASKS[task].subtasks
    assert episode.is_success


def test_a_failure_is_forgotten_once_the_plan_is_new() -> None:
    instance = load_instance("stack2", "test", 1)
    episode, expert = start(instance)
    first, grounded = expert.act()
    assert grounded is not None
    expert.notice(SkillResult(Outcome.TIMEOUT, "It took too long.", 7.0))
    again, same = expert.act()
    assert (again, same) == (first, grounded)
    assert expert.replans == 1
    assert np.isfinite(episode.elapsed_s)
