"""The expert with the interfaces of policies; it uses the true state, not images."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

from lemma.core.errors import InvalidConfigError
from lemma.env.episode import Episode
from lemma.expert.expert import Expert
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import (
    Decision,
    Oracle,
    OracleInput,
    Planner,
    PolicyInput,
    proposals,
)
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask
from lemma.tasks.teams.coalitions import lack_of
from lemma.tasks.zones import Territory


@dataclass
class _Answer:
    """The last decision for an episode, and the number of sub-tasks before it."""

    expert: Expert
    executed: int = -1
    subtask: SubTask = STOP


@dataclass(frozen=True)
class OraclePlanner(Oracle):
    """The expert's planner: it plans with the true state, and again after a failure."""

    _answers: WeakKeyDictionary[Episode, _Answer] = field(
        default_factory=WeakKeyDictionary, repr=False
    )

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode.

        Repeated calls between two executions return the same sub-task.

        Raises:
            InvalidConfigError: The inputs are no :class:`OracleInput`.
        """
        return [self._plan(truth_of(policy_input)) for policy_input in inputs]

    def propose(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the sub-tasks as decisions, with the reason of each refusal."""
        found = []
        for policy_input, subtask in zip(inputs, self.plan(inputs), strict=True):
            begins = not policy_input.past and subtask.primitive is Primitive.STOP
            why = refusal_words(truth_of(policy_input)) if begins else ""
            found.append(Decision(subtask, None, why))
        return found

    def _plan(self, episode: Episode) -> SubTask:
        answer = self._answers.get(episode)
        if answer is None or answer.executed > len(episode.executed):
            expert = Expert(episode.simulation.scene, episode.instance.goal)
            answer = self._answers[episode] = _Answer(expert)
        if answer.executed < len(episode.executed):
            if answer.executed >= 0:
                answer.expert.notice(episode.executed[-1].result)
            answer.subtask, _ = answer.expert.act()
            answer.executed = len(episode.executed)
        return answer.subtask


@dataclass(frozen=True)
class OracleGrounder(Oracle):
    """The expert's grounder: it computes poses from the true state."""

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with poses; None if its robot cannot do it.

        Raises:
            InvalidConfigError: The inputs are no :class:`OracleInput`.
            UnknownNameError: There is no such robot in the scene.
        """
        found: list[GroundedSubTask | None] = []
        for policy_input, subtask in zip(inputs, subtasks, strict=True):
            scene = truth_of(policy_input).simulation.scene
            step = GeometricGrounder(scene.spec).ground(
                subtask, SymbolicState.observe(scene)
            )
            found.append(None if step is None else step.grounded)
        return found


@dataclass(frozen=True)
class GroundTruthAllocation(Oracle):
    """A planner with ground-truth allocation of robots (paper: GTA).

    Primitive and objects remain the planner's. If the expert's next sub-task has the
    same primitive and objects, the robot is the expert's. Otherwise it is the robot
    with the largest reach margin, or the planner's own if no robot can do the sub-task.
    """

    planner: Planner
    expert: OraclePlanner = field(default_factory=OraclePlanner)

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the planner's sub-tasks with the allocated robots.

        Raises:
            InvalidConfigError: The inputs are no :class:`OracleInput`.
        """
        return [decision.subtask for decision in self.propose(inputs)]

    def propose(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the planner's decisions with the allocated robots."""
        return [
            replace(decision, subtask=self._allocate(policy_input, decision.subtask))
            for policy_input, decision in zip(
                inputs, proposals(self.planner, inputs), strict=True
            )
        ]

    def _allocate(self, policy_input: PolicyInput, subtask: SubTask) -> SubTask:
        if subtask.primitive is Primitive.STOP:
            return subtask
        expected = self.expert.plan([policy_input])[0]
        if replace(expected, robot=subtask.robot) == subtask:
            return expected
        scene = truth_of(policy_input).simulation.scene
        geometry, now = GeometricGrounder(scene.spec), SymbolicState.observe(scene)
        steps = [
            geometry.ground(replace(subtask, robot=robot), now)
            for robot in geometry.robots
        ]
        able = [step for step in steps if step is not None]
        if not able:
            return subtask
        return max(able, key=lambda step: step.quality).subtask


def refusal_words(episode: Episode) -> str:
    """Return why the team cannot reach the goal; empty if the reason is unknown."""
    instance = episode.instance
    territory = Territory(instance.scene.robots, instance.scene.gap_m)
    lack = lack_of(territory, instance.scene.objects, instance.goal)
    return "" if lack is None else lack.words(robot_phrases(instance.scene.robots))


def truth_of(policy_input: PolicyInput) -> Episode:
    """Return the episode of an oracle's input.

    Raises:
        InvalidConfigError: The input is no :class:`OracleInput`.
    """
    if not isinstance(policy_input, OracleInput):
        raise InvalidConfigError(
            "An oracle needs privileged state, which these inputs lack. Pass "
            "OracleInput, or use a learned policy."
        )
    return policy_input.episode
