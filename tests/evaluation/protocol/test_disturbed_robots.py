"""Robots that take other times than expected: the same way, later, in every run."""

from pathlib import Path
from typing import Any

import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.workers.pool import Serial
from lemma.env.episode import Episode
from lemma.evaluation.protocol.disturbances import DISTURBANCES, SLOW, disturb
from lemma.evaluation.records import read_about
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate, start_of
from lemma.evaluation.run.replay import differences, play_again
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.spec import PolicySpec
from lemma.tasks.suite import load_instance

INSTANCE = load_instance("relay", "test", 0)


def first_subtask_s(kind: str) -> float:
    """Return how long the first sub-task takes, alone [s]."""
    episode = Episode(INSTANCE)
    scene, grounder = episode.simulation.scene, GeometricGrounder(INSTANCE.scene)
    plan = find_plan(SymbolicState.observe(scene), INSTANCE.goal, grounder)
    assert plan is not None
    if kind:
        disturb(episode, kind)
    result = episode.execute(plan.steps[0].grounded)
    assert result.ok
    return result.duration_s


@pytest.mark.slow
def test_no_subtask_is_quicker_than_undisturbed() -> None:
    usual_s = first_subtask_s("")
    assert usual_s < first_subtask_s("durations") < 2.0 * usual_s
    assert all(first_subtask_s(kind) >= usual_s for kind in DISTURBANCES)


def test_one_robot_is_slow_and_one_stops() -> None:
    names = INSTANCE.scene.robot_names
    slow = DISTURBANCES["slow"](INSTANCE)
    assert sorted(slow(name, 0.0, 1.0) for name in names) == [SLOW, 1.0, 1.0]
    stops = DISTURBANCES["stops"](INSTANCE)
    still = [k for k in range(100) if any(stops(n, 0.0, k + 0.5) == 0.0 for n in names)]
    assert len(still) == 20
    assert still == list(range(still[0], still[0] + 20))


@pytest.mark.slow
def test_a_disturbed_episode_is_played_again_to_the_bit(tmp_path: Path) -> None:
    config = EvaluationConfig(
        out=tmp_path,
        policy=PolicySpec("oracle", acting="together"),
        tasks=("relay",),
        episodes=1,
        disturb="slow",
    )
    assert config.command().endswith("--disturb slow")
    (row,) = evaluate(config, Serial())
    about = read_about(tmp_path)
    assert row["success"]
    assert list(differences(row, play_again(row, start_of(row), about))) == []
    del about["disturb"]
    assert list(differences(row, play_again(row, start_of(row), about)))


def test_unknown_disturbances_and_those_of_motor_commands_are_refused(
    tmp_path: Path,
) -> None:
    told: dict[str, Any] = {"out": tmp_path, "tasks": ("pass",)}
    with pytest.raises(UnknownNameError, match="disturbance"):
        EvaluationConfig(**told, policy=PolicySpec("oracle"), disturb="wind")
    control = PolicySpec("oracle", level="control")
    with pytest.raises(InvalidConfigError, match="motor commands"):
        EvaluationConfig(**told, policy=control, disturb="slow")
