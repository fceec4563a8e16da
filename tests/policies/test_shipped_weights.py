"""Requirements of all weights that ship."""

import sys
from pathlib import Path

import pytest
from command import run
from tiers import slow_but

from lemma.core.poses import Pose2
from lemma.evaluation.analysis.result import read_result
from lemma.evaluation.experiments.catalog import EXPERIMENTS, TRAININGS
from lemma.evaluation.protocol.language_controls import LanguageControl
from lemma.evaluation.run.loading import weights_of
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.class_path import privileged
from lemma.policies.models.catalog import MODELS
from lemma.policies.spec import PolicySpec
from lemma.policies.weights import find_weights, load_model, published_weights
from lemma.tasks.suite import SUITE, load_instance

NAMES = tuple(published_weights())
OTHER_SUITES = {"keypose", "team-reachnet"}
"""Weights whose rows are of the ladder alone."""
SECOND_LOOK = "episodic-transformer-second-look"
"""Weights that do not ship: they answer one question, and are not of the paper."""
NOT_SHIPPED = {"et-second-look-cliport"} | {
    f"{policy}-{rung}"
    for policy in ("act", "diffusion")
    for rung in ("reach", "lift", "place")
}
"""Experiments whose weights do not ship; those of LeRobot weigh 31 to 40 MB each."""
WHOLE = tuple(
    name
    for name in NAMES
    if hasattr(MODELS[published_weights()[name]["model"]][0], "act")
    and name not in OTHER_SUITES
)

RESULTS = sorted((Path(__file__).parents[2] / "results").glob("*/seed-0.json"))


def test_all_trainings_of_the_tables_are_published() -> None:
    needed = {one for one in TRAININGS if TRAININGS[one].samples is None}
    assert set(NAMES) - OTHER_SUITES == needed - {SECOND_LOOK}


def test_there_are_results() -> None:
    assert RESULTS, "There is no result of seed 0 in results/."


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.parent.name)
def test_results_are_of_the_weights_that_ship(path: Path) -> None:
    about = read_result(path).about
    used = {weights["sha256"] for weights in about["weights"].values()}
    assert used or about["oracle"]
    if not privileged(about["policy"]["name"]):
        shipped = {entry["sha256"] for entry in published_weights().values()}
        # An experiment leaves the list when its weights ship.
        assert (used <= shipped) == (path.parent.name not in NOT_SHIPPED)
        if used <= shipped:
            # So a user's own row can be averaged with published seeds.
            assert weights_of(EXPERIMENTS[path.parent.name].policy) == about["weights"]


@pytest.mark.parametrize("name", slow_but(NAMES, *NAMES[:2]))
def test_weights_are_small_and_what_is_said_of_them(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of torch's compiler nothing is needed, and to import it takes a second.
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)
    entry = published_weights()[name]
    path = find_weights(name)
    assert path.stat().st_size == entry["bytes"] < 17e6
    model = load_model(name)
    assert all(bool(p.isfinite().all()) for p in model.parameters())
    assert model.selection in entry["scores"]
    assert f"{entry['model']} " in entry["command"]
    assert entry["data"]["digest"]


ALL = (
    "reachnet",
    *(
        pytest.param(name, marks=pytest.mark.slow)
        for name in ("reachnet-demonstrations", "episodic-transformer+cliport")
    ),
    pytest.param("m-cliport", marks=pytest.mark.slow),
)
INSTANCES = (("pass", 0), ("stack", 3), ("hook", 5))


@pytest.mark.render
@pytest.mark.parametrize("name", ALL)
def test_neither_order_nor_company_changes_a_decision(name: str) -> None:
    player = Player.load(PolicySpec(name))
    plays = [Rollout(load_instance(task, "val", i), "human") for task, i in INSTANCES]
    inputs = [player.policy_input(play) for play in plays]
    together = player.policy.act(inputs)
    last, *others = player.policy.act(inputs[2:]) + player.policy.act(inputs[1::-1])
    for one, other in zip(together, [*others[::-1], last], strict=True):
        assert one.subtask == other.subtask
        for end in ("pick", "place"):
            # Sums of floats depend on the size of a batch, in their last digits.
            poses = [getattr(each.grounded, end) for each in (one, other)]
            assert as_numbers(poses[0]) == pytest.approx(as_numbers(poses[1]), abs=1e-5)


def as_numbers(pose: Pose2) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("name", ["reachnet", "m-cliport", "team-reachnet+oracle"])
def test_the_order_of_episodes_changes_no_episode(name: str) -> None:
    player = Player.load(PolicySpec(name))
    found = []
    for order, at_once in ((INSTANCES, 3), (INSTANCES[::-1], 1)):
        plays = [Rollout(load_instance(task, "val", i), "human") for task, i in order]
        over = {play.instance.task: play for play in roll_out(plays, player, at_once)}
        found.append(
            {
                task: [(s.subtask, s.result.outcome) for s in play.steps]
                for task, play in over.items()
            }
        )
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("name", [n for n in NAMES if n.startswith("reachnet")])
def test_ours_solves_an_episode_of_every_task(name: str) -> None:
    player = Player.load(PolicySpec(name))
    plays = [Rollout(load_instance(task, "val", 0), "human") for task in SUITE]
    over = list(roll_out(plays, player))
    # One failure in eight would be within what is claimed of it; two would not.
    assert sum(bool(play.episode.info()["success"]) for play in over) >= 7


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("name", [n for n in NAMES if n.startswith("reachnet")])
def test_ours_does_nothing_when_told_nothing(name: str) -> None:
    player = Player.load(PolicySpec(name))
    silence = LanguageControl("")
    plays = [Rollout(load_instance(task, "val", 0), control=silence) for task in SUITE]
    for play in roll_out(plays, player):
        assert play.fault is None
        assert play.episode.elapsed_s == 0.0


@pytest.mark.render
@pytest.mark.parametrize("name", slow_but(WHOLE, "reachnet"))
def test_the_demo_runs_with_them(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    # Whether it solves the task is not asked here.
    assert run("demo", "pass", "--policy", name, "--no-video") in (0, 1)
    assert "move" in capsys.readouterr().out
