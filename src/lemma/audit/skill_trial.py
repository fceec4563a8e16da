"""One attempt at an instance with grounded sub-tasks of one robot."""

from typing import Any

import numpy as np

from lemma.audit.trial import AttemptOver, Trial
from lemma.core.poses import Pose2
from lemma.env.episode import Episode, EpisodeSnapshot
from lemma.motion.outcome import SkillResult
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import Plan, find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive

_UNLIMITED_S = 1000.0


class SkillTrial(Trial):
    """The actions of an attack at skill level."""

    def __init__(
        self, episode: Episode, robot: str, rng: np.random.Generator, attempt: int = 0
    ) -> None:
        """Begin an attempt; see :class:`~lemma.audit.trial.Trial`."""
        super().__init__(episode, robot, rng, attempt)
        self.grounder = GeometricGrounder(self.scene.spec)

    @staticmethod
    def begin(instance: Instance) -> Episode:
        """Return an episode in which attempts can be made."""
        return Episode(instance)

    def state(self) -> SymbolicState:
        """Return the present symbolic state."""
        return SymbolicState.observe(self.scene)

    def move(self, pick: Pose2, place: Pose2) -> SkillResult:
        """Pick up the object at a pose and put it down at another."""
        return self.do(Primitive.MOVE, pick, place)

    def carry(self, name: str, place: Pose2) -> bool:
        """Pick up an object and put it down at a pose; return whether that worked."""
        pick = self.grounder.grasp(self.robot, name, self.state())
        return pick is not None and self.move(pick, place).ok

    def do(self, primitive: Primitive, pick: Pose2, place: Pose2) -> SkillResult:
        """Execute a grounded sub-task, as a step of the environment does.

        Args:
            primitive: The primitive.
            pick: Gripper at the grasp, in the world's frame.
            place: Gripper at the release, in the world's frame.

        Raises:
            AttemptOver: The goal is reached, or the time is up.
            Lost: The goal cannot be reached any more.
        """
        return self.execute(GroundedSubTask(self.robot, primitive, pick, place))

    def execute(self, subtask: GroundedSubTask) -> SkillResult:
        """Execute a grounded sub-task of any robot; see :meth:`do`."""
        self.acted = True
        start_s = self.episode.elapsed_s
        result = self.episode.execute(subtask)
        self.episode.linger(start_s)
        self.simulated_s += self.episode.elapsed_s - start_s
        if self.episode.goal_progress == 1.0 and not self.episode.is_over:
            before = self.episode.snapshot()
            if self.finish():
                raise AttemptOver
            self.episode.restore(before)
        self.look(self.episode.is_over)
        return result

    def plan_alone(self) -> Plan | None:
        """Return the expert's plan for this robot alone; None if there is none."""
        return find_plan(
            self.state(),
            self.goal,
            self.grounder,
            limit_s=_UNLIMITED_S,
            team=(self.robot,),
        )

    def snapshot(self) -> EpisodeSnapshot:
        """Return the present moment, for :meth:`restore`."""
        return self.episode.snapshot()

    def restore(self, moment: EpisodeSnapshot) -> None:
        """Return to a moment and undo all later actions."""
        self.episode.restore(moment)

    def finish(self) -> bool:
        """Send ``stop``, and return whether the episode is a success."""
        if not self.episode.is_over:
            self.episode.stop()
        self.best_progress = max(self.best_progress, self.episode.goal_progress)
        return self.episode.is_success

    def record(self) -> dict[str, Any]:
        """Return the sub-tasks that were executed."""
        return {"subtasks": tuple(one.grounded for one in self.episode.executed)}
