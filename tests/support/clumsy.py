"""A policy that fails in a different way in each episode, and what it makes of some."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from kept import kept_folder

from lemma.core.poses import Pose2
from lemma.core.workers.pool import Serial
from lemma.evaluation.analysis.result import summarise
from lemma.evaluation.records import SUMMARY, read_about
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.policies.interfaces import Decision, Oracle, OracleInput, PolicyInput
from lemma.policies.oracle import OracleGrounder, OraclePlanner
from lemma.policies.spec import PolicySpec
from lemma.tasks.subtask import STOP

KINDS = ("high_level", "unseen")
EPISODES = 4
FAILED = 3
"""Of the episodes of each kind; the first one is solved."""


class Clumsy(Oracle):
    """The expert, but: stops early, picks beside the cube, takes the wrong robot."""

    def __init__(self) -> None:
        """Begin."""
        self._planner, self._grounder = OraclePlanner(), OracleGrounder()

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode."""
        return [self._decide(given) for given in inputs]

    def _decide(self, given: PolicyInput) -> Decision:
        assert isinstance(given, OracleInput)
        index, done = given.episode.instance.index % EPISODES, len(given.past)
        (subtask,) = self._planner.plan([given])
        if subtask == STOP or (done == 1 and index != 0):
            return Decision(STOP, None)
        (grounded,) = self._grounder.ground([given], [subtask])
        assert grounded is not None
        if index == 2:
            beside = Pose2(grounded.pick.x + 0.15, grounded.pick.y, grounded.pick.yaw)
            return Decision(subtask, replace(grounded, pick=beside))
        if index == 3:
            robot = "robot_1" if subtask.robot == "robot_0" else "robot_0"
            return Decision(replace(subtask, robot=robot), None, "No pose was found.")
        return Decision(subtask, grounded)


def played_clumsily() -> Path:
    """Return the policy's result on a few episodes, made once; do not write there."""
    return kept_folder("clumsy", _play)


def _play(folder: Path) -> None:
    order = EvaluationConfig(
        out=folder,
        policy=PolicySpec("clumsy:Clumsy", timeout_s=0.0),
        tasks=("stack",),
        split="val",
        kinds=KINDS,
        episodes=EPISODES,
    )
    rows = evaluate(order, Serial())
    summarise(rows, read_about(folder), order.command()).write(folder / SUMMARY)
