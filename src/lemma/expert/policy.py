"""The expert as a policy with the interface of learned policies."""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.skill_env import SkillEnv
from lemma.expert.expert import Expert
from lemma.expert.plan_env import PlanEnv

Rows = NDArray[np.float32]

MODE = "joint_position"
"""The control mode of the actions."""
_SETTLE_STEPS = 2
"""Steps at the end of a sub-task in which the servos settle."""
_WAIT_STEPS = 10


class JointMotion:
    """Converts the expert's sub-tasks in one episode into joint position actions."""

    def __init__(self, env: ControlEnv) -> None:
        """Copy the environment's episode.

        Args:
            env: The environment, during an episode, in control mode :data:`MODE`.
        """
        self._env = env
        self._copy = Episode(env.instance)

    def next_chunk(self) -> Rows:
        """Return the actions of the next sub-task, (steps, robots, 7) [rad, m].

        If the goal holds or there is no plan, the actions keep all robots still.
        """
        copy, env = self._copy, self._env
        copy.restore(env.episode.snapshot())
        _, grounded = Expert(copy.simulation.scene, copy.instance.goal).act()
        rows: list[Rows] = []
        ticks = 0

        def watch() -> None:
            nonlocal ticks
            ticks += 1
            if ticks % env.config.ticks_per_step == 0:
                rows.append(_row(copy))

        if grounded is not None:
            copy.simulation.observers.append(watch)
            copy.execute(grounded)
            copy.simulation.observers.remove(watch)
        rows += [_row(copy)] * (_WAIT_STEPS if grounded is None else _SETTLE_STEPS)
        box = env.action_layout.box()
        found: Rows = np.clip(np.stack(rows), box.low, box.high)
        return found


def _row(episode: Episode) -> Rows:
    """Return the present references of all servos, (robots, 7) [rad, m]."""
    arms = episode.simulation.arms.values()
    return np.array([[*arm.state[0], arm.opening_m] for arm in arms], np.float32)


class ExpertPolicy:
    """Solves episodes with the true state; it ignores observations.

    Example:
        >>> expert = ExpertPolicy(env)
        >>> observation, info = env.reset(seed=0)
        >>> while not done:
        ...     action = expert.act(observation)
        ...     observation, reward, done, truncated, info = env.step(action)
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Act in the given environment.

        Args:
            env: An environment of level skill or plan, or of level control with joint
                positions as actions; wrappers are allowed.

        Raises:
            InvalidConfigError: The environment has other actions.
        """
        inner = env.unwrapped
        led = isinstance(inner, ControlEnv) and inner.config.control == MODE
        if not led and not isinstance(inner, SkillEnv | PlanEnv):
            raise InvalidConfigError(
                f"The expert decides on sub-tasks or joint positions, but "
                f"{type(inner).__name__} takes other actions. Make the environment "
                f'with level="skill" or "plan", or with control="{MODE}".'
            )
        self._env: Any = inner
        self._episode: Episode | None = None
        self._expert: Expert | None = None
        self._motion: JointMotion | None = None
        self._rows: list[Rows] = []

    def act(self, observation: Any = None) -> Any:
        """Return the next action.

        Args:
            observation: Ignored.

        Raises:
            ResetNeededError: The environment has not been reset.
        """
        del observation
        episode = self._env.episode
        if isinstance(self._env, ControlEnv):
            return self._row(self._env)
        if self._expert is None or self._episode is not episode:
            self._expert = Expert(episode.simulation.scene, episode.instance.goal)
            self._episode = episode
        elif self._env.last_result is not None:
            self._expert.notice(self._env.last_result)
        subtask, grounded = self._expert.act()
        if isinstance(self._env, PlanEnv):
            return self._env.encode(subtask)
        return self._env.encode(grounded)

    def _row(self, env: ControlEnv) -> Rows:
        if self._motion is None or self._episode is not env.episode:
            self._motion, self._rows = JointMotion(env), []
            self._episode = env.episode
        if not self._rows:
            self._rows = list(self._motion.next_chunk())
        return self._rows.pop(0)
