"""Coordination: counted as it is defined, and measured as it is."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_up import row, step

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.evaluation.analysis.coordination import coordination_of
from lemma.evaluation.records import Deviation, Feedback
from lemma.evaluation.run.expert_feedback import advise, count_steps
from lemma.evaluation.run.watches import PERIOD_S, ClearanceWatch
from lemma.expert.expert import Expert, solve
from lemma.policies.interfaces import Decision
from lemma.robots.collision_model import envelope_of, place_capsules, segment_distance
from lemma.robots.ur.kinematics import frames
from lemma.scene.scene import Scene
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.suite import load_instance


def first_advice(task: str, **changes: Any) -> Feedback:
    """Return what is said of the expert's first sub-task, when it is changed."""
    episode = Episode(load_instance(task, "val", 0))
    subtask, grounded = Expert(episode.simulation.scene, episode.instance.goal).act()
    return advise(episode, Decision(replace(subtask, **changes), grounded))


def other(robot: str) -> str:
    return {"robot_0": "robot_1", "robot_1": "robot_0"}[robot]


def test_the_experts_robot_is_able() -> None:
    said = first_advice("pass")
    assert (said.able, said.departure) == (True, Deviation.NONE)


def test_a_robot_that_cannot_reach_is_not_able() -> None:
    expected = first_advice("pass").expected
    said = first_advice("pass", robot=other(expected.robot))
    assert (said.able, said.departure) == (False, Deviation.ROBOT)


def test_what_nobody_can_do_says_nothing_of_the_robot() -> None:
    assert first_advice("pass", pick="stick").able is None


def test_shares_are_of_what_they_are_of() -> None:
    steps = [
        step(3, able=True),
        step(2, "robot", able=False),
        step(2, "object", able=None),
        step(2, "object", able=True),
    ]
    found = count_steps(steps, 2)
    assert (found["able"], found["doable"]) == (2, 3)
    assert (found["as_expert"], found["planned"]) == (1, 2)


@pytest.mark.parametrize(
    ("after", "able", "outcome", "violated"),
    [
        (2, True, "success", False),  # Any order will do: it served the goal.
        (3, True, "success", True),
        (4, True, "success", True),
        (None, True, "success", True),
        (3, True, "missed_grasp", False),  # Could be done, and simply failed.
        (3, False, "unreachable", True),
        (3, None, "invalid", True),
    ],
)
def test_order_violations(
    after: int | None, able: bool | None, outcome: str, violated: bool
) -> None:
    steps = [step(3, "order", outcome, able=able)]
    assert count_steps(steps, after)["order_violations"] == violated


def test_only_successes_are_timed() -> None:
    def of(index: int, success: bool, expert_s: float | None) -> dict[str, Any]:
        made = row("stack", index, success=success, elapsed_s=30.0)
        return {**made, "coordination": {**made["coordination"], "expert_s": expert_s}}

    found = coordination_of(
        [of(0, True, 20.0), of(1, False, 20.0), of(2, True, None)],
        "high_level",
        "stack",
    )
    assert (found.episodes, found.timed) == (3, 1)
    assert (found.elapsed_s, found.timed_s, found.expert_s) == (90.0, 30.0, 20.0)
    assert found.idle_s == {"robot_0": 15.0, "robot_1": 75.0}


def test_nearest_and_touching() -> None:
    def of(gap_mm: float | None) -> dict[str, Any]:
        made = row("stack")
        return {
            **made,
            "coordination": {**made["coordination"], "clearance_mm": gap_mm},
        }

    found = coordination_of([of(80.0), of(-2.5), of(0.0)], "human", "stack")
    assert (found.nearest_mm, found.touching) == (-2.5, 2)
    alone = coordination_of([of(None)], "human", "stack")
    assert (alone.nearest_mm, alone.touching) == (None, 0)


def gaps(scene: Scene) -> Iterator[float]:
    """Yield the gap of every pair of capsules of two arms, without any shortcut."""
    placed = []
    for robot in scene.robots:
        envelope = envelope_of(robot.arm.name)
        links = np.empty((7, 4, 4))
        frames(robot.arm.dh, robot.world_from_base, scene.data.qpos[robot.qpos], links)
        out = np.empty((len(envelope.capsules), 7))
        place_capsules(links, envelope.capsule_links, envelope.capsules, out)
        placed.append(out)
    for a in placed[0]:
        for b in placed[1]:
            yield segment_distance(a, b) - a[6] - b[6]


def test_the_smallest_distance_is_watched() -> None:
    episode = Episode(load_instance("pass", "val", 0))
    watch = ClearanceWatch(episode.simulation)
    found = [min(gaps(episode.simulation.scene))]
    times = [0.0]

    def compare() -> None:
        if episode.elapsed_s >= times[-1] + PERIOD_S - 1e-9:
            times.append(episode.elapsed_s)
            found.append(min(gaps(episode.simulation.scene)))

    episode.simulation.observers.append(compare)
    list(solve(episode, Expert(episode.simulation.scene, episode.instance.goal)))
    assert len(found) > 100
    assert watch.least_m == pytest.approx(min(found), abs=1e-12)
    assert watch.least_m < found[0]


def test_arms_in_each_other_are_negative() -> None:
    robots = tuple(
        RobotPlacement("ur5", "red", Pose2(x, 0.0, yaw))
        for x, yaw in ((-0.4, 0.0), (0.4, math.pi))
    )
    simulation = Simulation(SceneSpec(robots, ()))
    watch = ClearanceWatch(simulation)
    apart = watch.least_m
    for robot in simulation.scene.robots:
        # Stretched out, face to face.
        simulation.scene.data.qpos[robot.qpos] = [math.pi, 0.0, 0.0, 0.0, 0.0, 0.0]
    for _ in range(10):
        watch._tick()
    assert watch.least_m == pytest.approx(min(gaps(simulation.scene)), abs=1e-12)
    assert watch.least_m < 0.0 < apart


def test_one_arm_has_no_distance() -> None:
    instance = load_instance("stack", "val", 0)
    alone = RobotPlacement("ur5", "red", Pose2(-0.6, 0.0, 0.0))
    spec = SceneSpec((alone,), instance.scene.objects)
    episode = Episode(replace(instance, scene=spec))
    watch = ClearanceWatch(episode.simulation)
    episode.simulation.rest(0.2)
    assert watch.least_m == math.inf


def test_watching_changes_nothing() -> None:
    instance = load_instance("stack", "val", 1)
    states = []
    for watched in (False, True):
        episode = Episode(instance)
        if watched:
            ClearanceWatch(episode.simulation)
        subtask, grounded = Expert(episode.simulation.scene, instance.goal).act()
        assert subtask == SubTask(
            subtask.robot, Primitive.MOVE, subtask.pick, subtask.place
        )
        assert grounded is not None
        episode.execute(grounded)
        states.append(episode.simulation.scene.data.qpos.tobytes())
    assert states[0] == states[1]
