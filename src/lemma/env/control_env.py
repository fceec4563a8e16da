"""The control level: motor commands, 20 times a second by default."""

from typing import Any

from numpy.typing import ArrayLike

from lemma.core.errors import InvalidConfigError, ResetNeededError
from lemma.env.base_env import LemmaEnv, StepResult
from lemma.env.config import EnvConfig
from lemma.env.control.controllers import Controller, StepSize
from lemma.env.control.modes import CONTROLS
from lemma.env.episode import Episode
from lemma.scene.build import TICK_S

SETTLE_S = 0.5
"""The episode ends when its goal has held for this time [s]."""


class ControlEnv(LemmaEnv):
    """An environment that commands all robots at once, with one row of numbers each.

    ``action_layout`` names rows and columns. Values out of bounds are an error, or are
    clipped with ``clip_actions``; values that exceed only the limits of a weaker arm
    are no error: its motion is limited.

    The episode is terminated when the goal has held for half a second, with nothing in
    a gripper unless the goal requires it, or when an object is thrown. It is truncated
    at T_max. Then the robots stand still for a second, and success is judged. A robot
    is busy, for ``info["idle_s"]``, while a joint turns faster than 0.02 rad/s or a
    finger moves faster than 2 mm/s.
    """

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Define the spaces; nothing is simulated before the first reset.

        Args:
            config: The options.
            render_mode: ``"rgb_array"`` for :meth:`render`, ``"human"``, or None.

        Raises:
            UnknownNameError: No such control mode or render mode.
        """
        super().__init__(config.at_control_level(), render_mode)
        self.mode = CONTROLS[config.control]
        self.actuation = self.mode.actuation
        # Video writers need an integer.
        self.metadata["render_fps"] = max(1, round(config.control_hz))
        self.action_layout = self.mode.layout(self.robot_names)
        self.action_space = self.action_layout.box()
        self._max_episode_steps = max(1, round(config.horizon_s * config.control_hz))
        self._step = StepSize(
            position_m=config.delta_position_m, rotation_rad=config.delta_rotation_rad
        )
        self._controller: Controller | None = None
        self._settled_s = 0.0
        self._goal_progress: float | None = None

    def _begin(self, episode: Episode) -> None:
        super()._begin(episode)
        arms = tuple(episode.simulation.arms.values())
        self._controller = self.mode.controller(arms, self._step)
        self._settled_s = 0.0

    def take_over(self, episode: Episode) -> None:
        """Continue a running episode from its present state.

        Args:
            episode: Episode with a team as large as this environment's; its robots are
                at rest.

        Raises:
            InvalidConfigError: Its actuation or its number of robots differs.
        """
        scene = episode.simulation.scene
        if scene.actuation != self.actuation:
            raise InvalidConfigError(
                f"control={self.config.control!r} drives motors by {self.actuation}, "
                f"and those of this episode take {scene.actuation}."
            )
        if scene.spec.robot_names != self.robot_names:
            raise InvalidConfigError(
                f"Number of robots: {len(scene.spec.robot_names)} in the episode, "
                f"{len(self.robot_names)} in this environment."
            )
        self._begin(episode)

    @property
    def controller(self) -> Controller:
        """The controller that drives the arms in this episode.

        Raises:
            ResetNeededError: There is no episode yet.
        """
        if self._controller is None:
            raise ResetNeededError("There is no episode yet. Call reset() first.")
        return self._controller

    def step(self, action: ArrayLike) -> StepResult:
        """Command the motors for one control step.

        Args:
            action: One row for each robot; see ``action_layout``.

        Returns:
            Observation, reward, terminated, truncated and info.

        Raises:
            InvalidActionError: The action is not in the space; nothing has moved.
            ResetNeededError: The episode is over.
        """
        reward, terminated, truncated = self.advance(action)
        info = self._report(self._goal_progress)
        return self.observe(), reward, terminated, truncated, info

    def advance(self, action: ArrayLike) -> tuple[float, bool, bool]:
        """Step without an observation: return reward, terminated and truncated."""
        episode = self._running()
        rows = self.action_layout.check(action, clip=self.config.clip_actions)
        controller, simulation = self.controller, episode.simulation
        controller.check(rows)
        controller.command(rows)
        simulation.run(controller.run, self.config.ticks_per_step)
        clocks, ticks = simulation.clocks.values(), controller.busy_ticks()
        for clock, busy in zip(clocks, ticks, strict=True):
            # Add tick by tick: a product would differ in the last bits.
            for _ in range(busy):
                clock.busy_s += TICK_S
        step_s = 1.0 / self.config.control_hz
        self._goal_progress = episode.goal_progress
        success = episode.succeeds(self._goal_progress)
        self._settled_s = self._settled_s + step_s if success else 0.0
        if self._settled_s >= SETTLE_S - 0.5 * TICK_S:
            episode.stop()
        over = episode.is_over
        if over:
            episode.conclude()
            # The cached goal progress is out of date.
            self._goal_progress = None
        reward = self.rewards.reward(episode)
        terminated = over and (episode.stopped or episode.has_failed)
        return reward, terminated, over and not terminated

    def _remember(self) -> dict[str, Any]:
        return {"settled_s": self._settled_s}

    def _recall(self, memory: dict[str, Any]) -> None:
        self._settled_s = memory["settled_s"]
