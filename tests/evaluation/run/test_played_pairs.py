"""Playing pairs: to act where it can be done, and else to refuse with the reason."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from lemma.cli.main import main
from lemma.core.errors import InvalidConfigError
from lemma.core.workers.pool import Serial
from lemma.evaluation.analysis.pair_scores import PairScores
from lemma.evaluation.evaluation import evaluate
from lemma.evaluation.lines import read_rows
from lemma.evaluation.records import EPISODES
from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.evaluation.report.sections import PAIRS, page
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.verification import verify
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.spec import PolicySpec
from lemma.tasks.subtask import STOP


class AlwaysRefuses:
    """Says no to everything."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return [Decision(STOP, None, "No robot reaches anything.") for _ in inputs]


def test_the_oracle_is_right_says_why_and_is_verified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--suite", "teams", "--pairs", "--episodes", "2", "--protocol", "strict"]
    out = str(tmp_path / "oracle")
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", "--policy", "oracle", *words, "--out", out])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert "refused rightly" in printed
    able, unable = read_rows(tmp_path / "oracle")
    assert able["pair"] == {
        "can": True,
        "refused": False,
        "explained": False,
        "reason": "",
    }
    assert able["success"]
    assert unable["pair"]["refused"]
    assert unable["pair"]["explained"]
    assert unable["pair"]["reason"].startswith("No robot reaches the ")
    checked = verify(tmp_path / "oracle" / EPISODES, Serial())
    assert checked.ok, checked.problems
    text = page(entries_of(read_results([tmp_path / "oracle"])))
    assert f"## {PAIRS}" in text
    assert "| refused rightly | 1 of 1 |" in text
    assert "lemma evaluate --policy oracle --instructions high-level --pairs" in text


def test_who_refuses_everything_is_wrong() -> None:
    found = evaluate(AlwaysRefuses(), tasks="pass", split="pairs", episodes=2)
    (scores,) = found.result.pairs
    assert scores == PairScores("high_level", 1, 0, 1, 0, 1, 1, 1, 0, 0)


@pytest.mark.parametrize("policy", ["oracle", "greedy-reach"])
def test_teams_refuse_as_well(policy: str) -> None:
    found = evaluate(
        policy, tasks="pass", split="pairs", episodes=2, acting="together", level="plan"
    )
    able, unable = found.rows
    assert able["success"]
    assert unable["pair"]["refused"]
    assert unable["pair"]["explained"] == (policy == "oracle")


def test_pairs_are_played_with_their_own_sentences(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfigError, match="full sentence"):
        EvaluationConfig(
            out=tmp_path,
            policy=PolicySpec("oracle"),
            tasks=("pass",),
            split="pairs",
            language="shuffled",
        )
    arguments = ["--policy", "oracle", "--pairs", "--tasks", "pass2"]
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", *arguments, "--out", str(tmp_path)])
    assert ended.value.code == 2


@pytest.mark.slow
def test_the_oracle_is_right_in_pairs_of_all_kinds() -> None:
    found = evaluate("oracle", tasks="pass", split="pairs", episodes=30)
    (scores,) = found.result.pairs
    assert scores.right == scores.refused_rightly == scores.explained == 15
