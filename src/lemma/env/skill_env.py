"""The skill level: one grounded sub-task per step."""

from typing import Any

from lemma.env.action_spaces import Action, decode_skill, encode_skill, skill_space
from lemma.env.base_env import LemmaEnv, StepResult
from lemma.env.config import EnvConfig
from lemma.env.episode import LEAST_STEP_S, Episode
from lemma.motion.outcome import Outcome, SkillResult
from lemma.tasks.subtask import GroundedSubTask

_REFUSED = (Outcome.INVALID, Outcome.UNREACHABLE, Outcome.OVERLOAD)


class SubTaskEnv(LemmaEnv):
    """Common base of skill level and plan level: a step executes one sub-task.

    The episode is terminated by ``stop``, and then success is judged; it is truncated
    at T_max. ``info["outcome"]`` and ``info["explanation"]`` describe the result of the
    sub-task. An infeasible sub-task raises no error: the state stays valid, and a
    second passes.
    """

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Define the spaces; nothing is simulated before the first reset.

        Args:
            config: The options.
            render_mode: ``"rgb_array"`` for :meth:`render`, ``"human"``, or None.

        Raises:
            UnknownNameError: No such render mode.
        """
        super().__init__(config, render_mode)
        self.metadata["render_fps"] = 1
        self._max_episode_steps = max(1, round(config.horizon_s / LEAST_STEP_S))
        self.last_result: SkillResult | None = None
        """Result of the last sub-task; None before the first."""

    def _begin(self, episode: Episode) -> None:
        super()._begin(episode)
        self.last_result = None

    def _execute(self, action: Action) -> SkillResult:
        """Execute an action, or return why it cannot be executed."""
        raise NotImplementedError

    def step(self, action: Action) -> StepResult:
        """Carry out one sub-task.

        Args:
            action: The sub-task; ``encode`` makes one.

        Returns:
            Observation, reward, terminated, truncated and info.

        Raises:
            InvalidActionError: The action is not in the space.
            ResetNeededError: The episode is over.
        """
        episode = self._running()
        start = episode.elapsed_s
        self.last_result = self._execute(action)
        episode.linger(start)
        reward = self.rewards.reward(episode)
        info = self.info()
        terminated = episode.stopped or episode.has_failed
        truncated = episode.out_of_time and not terminated
        return self.observe(), reward, terminated, truncated, info

    def _full_info(self, progress: float | None) -> dict[str, Any]:
        found = super()._full_info(progress)
        result = self.last_result
        found["outcome"] = None if result is None else str(result.outcome)
        found["explanation"] = "" if result is None else result.explanation
        if found["failure"] == "goal_not_reached" and found["outcome"] in _REFUSED:
            found["failure"] = found["outcome"]
        return found

    def _remember(self) -> dict[str, Any]:
        return {"last_result": self.last_result}

    def _recall(self, memory: dict[str, Any]) -> None:
        self.last_result = memory["last_result"]


class SkillEnv(SubTaskEnv):
    """Actions are a robot, a primitive, a pick pose and a place pose."""

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Define the spaces; nothing is simulated before the first reset.

        Args:
            config: The options.
            render_mode: ``"rgb_array"`` for :meth:`render`, ``"human"``, or None.
        """
        super().__init__(config, render_mode)
        self.action_space = skill_space(len(self.robot_names))

    def encode(self, subtask: GroundedSubTask | None) -> dict[str, Any]:
        """Return the action for a grounded sub-task, or ``stop`` for None."""
        return encode_skill(subtask)

    def decode(self, action: Action) -> GroundedSubTask | None:
        """Return the grounded sub-task that an action means, None for ``stop``.

        Raises:
            InvalidActionError: The action is not in the space.
        """
        return decode_skill(action, len(self.robot_names))

    def _execute(self, action: Action) -> SkillResult:
        subtask = self.decode(action)
        if subtask is None:
            return self.episode.stop()
        return self.episode.execute(subtask)
