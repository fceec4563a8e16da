"""Teams that the benchmark does not have: another arm, and three robots."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from command import run as command
from own_plugins import EXAMPLES, loaded
from small_tables import cube, pad

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.dataset.recipe.record import record_episode
from lemma.dataset.recipe.replay import replay
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.robots.reach import reach_of
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample

UR16E = EXAMPLES / "13_write_a_robot.py"


def test_any_registered_arms_make_a_team_where_instances_are_sampled() -> None:
    with loaded(UR16E):
        team = ("ur16e", "ur5")
        env = lemma.make("stack", level="plan", split="free", index=0, robots=team)
        expert = lemma.ExpertPolicy(env)
        env.reset()
        assert tuple(r.arm for r in env.instance.scene.robots) == team
        assert env.instance.team == "ur5+ur16e"
        done = False
        while not done:
            _, reward, terminated, truncated, _ = env.step(expert.act())
            done = terminated or truncated
        assert reward == 1.0
        with pytest.raises(InvalidConfigError, match=r"split='free'"):
            lemma.make("stack", split="test", robots=team)
    with pytest.raises(UnknownNameError, match="ur16e"):
        lemma.make("stack", split="free", robots=team)


@pytest.mark.parametrize("robots", [5, "ur5", (), {"ur5": 1}, 1.5, True])
def test_what_is_no_team_is_refused(robots: Any) -> None:
    with pytest.raises(InvalidConfigError, match=r"robots=.* is no team"):
        lemma.make("stack", robots=robots)


@pytest.mark.parametrize("robots", [("ur5", "ur6"), (5, 5), (None, "ur5"), ([], [])])
def test_an_arm_that_is_unknown_is_named(robots: Any) -> None:
    with pytest.raises(UnknownNameError, match="Unknown arm"):
        lemma.make("stack", split="free", robots=robots)


@pytest.mark.slow
def test_own_team_is_in_data_statistics_and_tables(capsys, tmp_path: Path) -> None:
    def run(*words: object) -> str:
        code = command(*words)
        out, err = capsys.readouterr()
        assert not code, err
        return str(out)

    data, result, report = (tmp_path / name for name in ("data", "result", "report"))
    asked = ("--tasks", "stack_ur16e", "--episodes", 1)
    with loaded(UR16E):
        run("generate", *asked, "--out", data)
        run("evaluate", "--policy", "oracle", *asked, "--out", result)
        found = json.loads(run("inspect", data, "--json"))
    assert list(found["teams"]) == ["ur5+ur16e"]
    run("report", result, "--out", report)
    assert "ur5+ur16e" in (report / "results.md").read_text()


def three_arms() -> Instance:
    """Three UR5 around a table: a cube of the first, a pad and a cube of the others."""
    away = reach_of("ur5").travel_m - 0.12
    robots = []
    for turn, color in enumerate(("red", "white", "white")):
        angle = math.tau * turn / 3.0
        base = Pose2(away * math.cos(angle), away * math.sin(angle), angle + math.pi)
        robots.append(RobotPlacement("ur5", color, base))

    def beside(robot: int) -> tuple[float, float]:
        spot = robots[robot].base @ Pose2(0.1, -0.34)
        return spot.x, spot.y

    scene = SceneSpec(
        tuple(robots),
        (
            cube("red", *beside(0)),
            pad("blue", *beside(1)),
            cube("green", *beside(2)),
        ),
    )
    goal = Goal.from_pairs((("red_cube", "blue_pad"), ("green_cube", "red_cube")))
    words = dict.fromkeys(("high_level", "human", "unseen"), "build a tower")
    return Instance("stack", "free", 0, scene, goal, words, ())


@pytest.mark.slow
def test_three_robots_plan_and_work_together() -> None:
    instance = three_arms()
    episode = Episode(instance)
    steps = list(solve(episode, Expert(episode.simulation.scene, instance.goal)))
    assert [step.result.outcome for step in steps] == ["success"] * len(steps)
    assert {step.subtask.robot for step in steps} == {"robot_0", "robot_1", "robot_2"}
    assert episode.is_success
    record = record_episode(instance)
    assert record.success
    assert record.team == "ur5+ur5+ur5"
    assert replay(record).is_exact


def test_an_environment_has_as_many_robots_as_its_team() -> None:
    env = lemma.make("stack", level="skill", split="free", robots=("ur5",) * 3)
    assert env.robot_names == ("robot_0", "robot_1", "robot_2")
    observation, info = env.reset(options={"instance": three_arms()})
    assert len(info["idle_s"]) == 3
    assert env.observation_space.contains(observation)
    with pytest.raises(InvalidConfigError, match="has 3 robots, but tables of"):
        env.reset(seed=0)
    with pytest.raises(InvalidConfigError, match="for 2 robots"):
        lemma.make("stack").reset(options={"instance": three_arms()})


def test_the_sampler_sets_tables_for_two() -> None:
    with pytest.raises(InvalidConfigError, match="1 robots"):
        sample(lemma.TASKS["stack"], "free", 0, team=("ur5",))
