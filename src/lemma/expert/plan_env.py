"""The plan level: an action is a symbolic sub-task, which the oracle grounds."""

from typing import Any

from lemma.env.action_spaces import Action, decode_plan, encode_plan, plan_space
from lemma.env.config import EnvConfig
from lemma.env.episode import Episode
from lemma.env.skill_env import SubTaskEnv
from lemma.motion.outcome import SkillResult
from lemma.planning.grounding import GeometricGrounder, ground_or_refuse
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.subtask import Primitive, SubTask


class PlanEnv(SubTaskEnv):
    """Environment whose actions are robot, primitive, pick and place, without poses."""

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Define the spaces; nothing is simulated before the first reset.

        Args:
            config: The options.
            render_mode: ``"rgb_array"`` for :meth:`render`, or None.
        """
        super().__init__(config, render_mode)
        self.action_space = plan_space(len(self.robot_names), config.kinds)
        self._grounder: GeometricGrounder | None = None

    def _begin(self, episode: Episode) -> None:
        super()._begin(episode)
        self._grounder = GeometricGrounder(episode.simulation.scene.spec)

    def encode(self, subtask: SubTask | None) -> dict[str, Any]:
        """Return the action for a sub-task, or ``stop`` for None.

        Raises:
            InvalidActionError: There is no such entity, or the argument is neither.
        """
        return encode_plan(subtask, len(self.robot_names), self.config.kinds)

    def decode(self, action: Action) -> SubTask:
        """Return the sub-task of an action.

        Raises:
            InvalidActionError: The action is not in the space.
        """
        return decode_plan(action, len(self.robot_names), self.config.kinds)

    def _execute(self, action: Action) -> SkillResult:
        subtask = self.decode(action)
        if subtask.primitive is Primitive.STOP:
            return self.episode.stop()
        assert self._grounder is not None
        now = SymbolicState.observe(self.episode.simulation.scene)
        found = ground_or_refuse(subtask, now, self._grounder)
        if isinstance(found, SkillResult):
            return found
        return self.episode.execute(found.grounded)
