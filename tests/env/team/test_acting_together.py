"""Orders to free robots: several work at once, those at work are left alone."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import lemma
from lemma.core.errors import InvalidActionError, InvalidConfigError
from lemma.env.team.team_env import TeamPlanEnv
from lemma.expert.expert import Expert
from lemma.tasks.subtask import (
    STOP,
    GroundedSubTask,
    Primitive,
    SubTask,
    primitive_names,
)
from lemma.tasks.suite import load_instance


def team_env(task: str = "relay", **options: Any) -> TeamPlanEnv:
    options = {"split": "test", "index": 0, **options}
    env = lemma.make(task, level="plan", acting="together", **options)
    assert isinstance(env, TeamPlanEnv)
    env.reset()
    return env


@cache
def plan_of(task: str) -> tuple[SubTask, ...]:
    episode = lemma.Episode(load_instance(task, "test", 0))
    plan = Expert(episode.simulation.scene, episode.instance.goal).plan()
    assert plan is not None
    return plan.subtasks


@pytest.mark.parametrize("level", ["plan", "skill"])
def test_gymnasium_finds_no_fault(level: str) -> None:
    env = lemma.make(
        "stack2", level=level, acting="together", split="test", horizon_s=3.0
    )
    check_env(env, skip_render_check=True)


def test_a_relay_is_ordered_at_once_and_each_waits_for_the_one_before() -> None:
    env = team_env()
    steps = plan_of("relay")
    *_, info = env.step(env.encode(*steps))
    first, second, third = (step.robot for step in steps)
    assert set(info["doing"]) | set(info["free"]) == set(env.robot_names)
    assert info["waits_for"][third] == (second,)
    waited, ends = 0.0, []
    while info["doing"]:
        waited += info["duration_s"]
        ends += info["ended"]
        *_, info = env.step({})
    ends += info["ended"]
    assert [one["robot"] for one in ends] == [first, second, third]
    # The first goes home while the second comes.
    tried = env.episode.executed
    assert tried[1].start_s < tried[0].start_s + tried[0].result.duration_s - 0.5
    _, reward, terminated, truncated, _ = env.step(env.encode(STOP))
    assert (reward, terminated, truncated) == (1.0, True, False)


@pytest.mark.slow
def test_orders_to_one_robot_at_a_time_give_the_same_state_as_turns() -> None:
    turns = lemma.make("stack2", level="plan", split="test", index=0)
    together = team_env("stack2")
    turns.reset()
    for step in (*plan_of("stack2"), STOP):
        turns.step(turns.encode(step))
        *_, info = together.step(together.encode(step))
        while not together.episode.is_over and info["doing"]:
            *_, info = together.step({})
    assert together.episode.is_success
    assert together.state_hash() == turns.state_hash()
    assert together.episode.elapsed_s == turns.episode.elapsed_s


def test_a_busy_robot_takes_no_order_and_its_mask_says_so() -> None:
    env = team_env("stack2")
    step = plan_of("stack2")[0]
    assert step in env.valid_orders(step.robot)
    env.team.order(step)
    before = env.state_hash()
    with pytest.raises(InvalidActionError, match=f"{step.robot} is busy"):
        env.step(env.encode(step))
    assert env.state_hash() == before
    masks = env.action_masks()
    assert np.flatnonzero(masks[step.robot]["primitive"]).tolist() == [
        len(primitive_names())
    ]
    for name in env.robot_names:
        order = env.order_space.sample(mask=masks[name])
        assert env.order_space.contains(order)


def test_a_refused_order_costs_its_robot_alone_a_second() -> None:
    env = team_env("stack2")
    first = plan_of("stack2")[0]
    other = next(name for name in env.robot_names if name != first.robot)
    cubes = (name for name in env.instance.scene.object_names if "cube" in name)
    nonsense = SubTask(other, Primitive.HOOK, next(cubes), "shared")
    *_, info = env.step(env.encode(first, nonsense))
    assert info["duration_s"] == pytest.approx(1.0, abs=0.02)
    assert info["free"] == (other,)
    assert info["ended"][0]["outcome"] == "invalid"
    assert list(info["doing"]) == [first.robot]


def test_a_moment_in_the_midst_is_found_again_to_the_bit() -> None:
    env, again = team_env(), team_env()
    env.step(env.encode(*plan_of("relay")))
    snapshot = env.snapshot()
    again.restore(snapshot)
    assert again.info()["doing"] == env.info()["doing"]
    for one in (env, again):
        one.step({})
    assert again.state_hash() == env.state_hash()


def test_nobody_ordered_lets_a_second_pass_and_every_episode_ends() -> None:
    env = team_env(horizon_s=2.5)
    durations = []
    truncated = False
    while not truncated:
        *_, truncated, info = env.step({})
        durations.append(info["duration_s"])
    assert durations == pytest.approx([1.0, 1.0, 0.5], abs=0.02)


@pytest.mark.slow
def test_a_robot_that_is_left_out_lays_its_cube_down_with_another() -> None:
    """Where the goal is about times, a decision is due every second."""
    env = team_env("unison")
    pairs, steps = env.instance.goal.pairs, plan_of("unison")
    before = next(one for one in steps if (one.pick, one.place) not in pairs)
    after = next(one for one in steps if one.pick == before.pick and one != before)
    (alone,) = set(steps) - {before, after}
    *_, info = env.step(env.encode(before, after))
    while info["waits_for"].get(after.robot) == (before.robot,):
        assert alone.robot in info["free"]
        assert 0.0 < info["duration_s"] <= 1.01
        *_, info = env.step({})
    *_, info = env.step(env.encode(alone))
    while info["doing"]:
        *_, info = env.step({})
    _, reward, *_, info = env.step(env.encode(STOP))
    assert reward == 1.0
    assert info["rule"]["has_been"]


@pytest.mark.parametrize("level", ["plan", "skill"])
def test_what_is_done_at_the_same_time_is_not_done_in_turns(level: str) -> None:
    with pytest.raises(InvalidConfigError, match="cannot do it in turns"):
        lemma.make("unison", level=level)
    episode = lemma.Episode(load_instance("unison", "test", 0))
    with pytest.raises(InvalidConfigError, match="Let them act together"):
        list(lemma.solve(episode))
    assert episode.elapsed_s == 0.0


def test_poses_alone_are_an_order_that_begins_at_once() -> None:
    env = lemma.make("stack2", level="skill", acting="together", split="test", index=0)
    env.reset()
    expert = Expert(env.episode.simulation.scene, env.instance.goal)
    plan = expert.plan()
    assert plan is not None
    poses: dict[str, GroundedSubTask] = {}
    for step in plan.steps:
        poses.setdefault(step.grounded.robot, step.grounded)
    *_, info = env.step(env.encode(*poses.values()))
    assert len(poses) == 2
    assert len(info["doing"]) == 1
    assert info["ended"][0]["outcome"] == "success"


def test_robots_that_nobody_asked_cannot_be_named() -> None:
    env = team_env("stack2")
    with pytest.raises(InvalidActionError, match="robot_0, robot_1"):
        env.step({"robot_7": {}})
    with pytest.raises(InvalidConfigError, match="control level"):
        lemma.make("stack2", acting="together")


@pytest.mark.slow
def test_moves_drawn_by_chance_end_and_nothing_flies() -> None:
    env = team_env("carousel", horizon_s=20.0)
    rng, over = np.random.default_rng(0), False
    most = 0
    while not over:
        orders = []
        for name in env.team.free:
            every = env.valid_orders(name)
            valid = [one for one in every if one.primitive is Primitive.MOVE]
            if valid:
                orders.append(valid[int(rng.integers(len(valid)))])
        _, _, terminated, truncated, _ = env.step(env.encode(*orders))
        most = max(most, len(env.episode.simulation.busy))
        over = terminated or truncated
    assert not env.episode.is_thrown
    assert most > 1
