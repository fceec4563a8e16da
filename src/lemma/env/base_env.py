"""Common base class of all Gymnasium environments.

An environment wraps an :class:`~lemma.env.episode.Episode`. Rewards are sparse, 1 when
the episode ends in success, else 0, or :mod:`dense <lemma.env.signals.rewards>`;
``info["progress"]`` is the fraction of the task that is done.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from lemma.core.arguments import known, whole
from lemma.core.errors import InvalidConfigError, ResetNeededError, shown
from lemma.core.robot_names import robot_names
from lemma.env.camera_rig import OVERVIEW
from lemma.env.config import EnvConfig, InstanceSource, own_options
from lemma.env.episode import Episode, EpisodeSnapshot
from lemma.env.observation import (
    Observation,
    Observer,
    object_poses,
)
from lemma.env.signals.rewards import RewardMeter
from lemma.env.view import View
from lemma.scene.cameras import Camera, RgbImage
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.rendering.window import Window
from lemma.tasks.instance import Instance
from lemma.tasks.language.blind import instruction
from lemma.tasks.suite import TASKS

StepResult = tuple[Observation, float, bool, bool, dict[str, Any]]


@dataclass(frozen=True, slots=True)
class EnvSnapshot:
    """An environment between two steps; plain data, can be pickled."""

    episode: EpisodeSnapshot
    level: dict[str, Any]
    """State that the subclass adds."""


class LemmaEnv(gymnasium.Env[Observation, Any]):
    """A task as a Gymnasium environment.

    Its arguments in :func:`gymnasium.make` are the fields of
    :class:`~lemma.env.config.EnvConfig`.
    """

    actuation = "position"
    """How the motors are driven."""

    def __init__(self, config: EnvConfig, render_mode: str | None = None) -> None:
        """Define the spaces; nothing is simulated before the first reset.

        Args:
            config: The options.
            render_mode: ``"rgb_array"`` for :meth:`render`, ``"human"`` for a window
                of MuJoCo's viewer, or None.

        Raises:
            UnknownNameError: No such render mode.
            RenderingError: There is no display for a window.
        """
        self.metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 20}
        if render_mode is not None:
            known("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self._window = Window() if render_mode == "human" else None
        self.config = config
        self.task = config.task
        self._instances = InstanceSource(config)
        self.robot_names = robot_names(config.team_size)
        self._observer = Observer(
            config.observation,
            tuple(range(config.team_size)),
            config.image_size,
            config.cameras,
            config.kinds,
        )
        self.observation_space = self._observer.space
        self.rewards = RewardMeter(config.reward, config.reward_discount)
        self._episode: Episode | None = None
        self._renderer: Renderer | None = None

    @property
    def episode(self) -> Episode:
        """The episode in progress.

        Raises:
            ResetNeededError: There is none yet.
        """
        if self._episode is None:
            raise ResetNeededError("There is no episode yet. Call reset() first.")
        return self._episode

    @property
    def instance(self) -> Instance:
        """The problem of this episode."""
        return self.episode.instance

    @property
    def task_description(self) -> str:
        """The instruction of this episode; the task's summary before the first."""
        if self._episode is None:
            return TASKS[self.task].summary
        return instruction(self._episode.instance, self.config.instruction)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: Seeds the random choice of instances, in this and later resets.
            options: ``split`` and ``index`` choose an instance; ``instance`` passes one
                directly. The chosen instance depends on these options alone, never on
                earlier resets. Unknown options, such as those of libraries that wrap
                the environment, are ignored with a warning.

        Returns:
            The first observation and ``info``.

        Raises:
            UnknownNameError: No such split, or an option that looks misspelled.
            InvalidConfigError: The seed or the index is no number or out of range, or
                the instance cannot be used here.
        """
        self.set_table(seed, options)
        return self.observe(), self.info()

    def set_table(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> None:
        """Reset without computing an observation."""
        super().reset(seed=None if seed is None else whole("seed", seed, 0))
        episode = Episode(
            self._instances.choose(own_options(options), self.np_random),
            horizon_s=self.config.horizon_s,
            actuation=self.actuation,
        )
        self._begin(episode)

    def _begin(self, episode: Episode) -> None:
        """Make an episode the current one."""
        self._episode = episode
        self.rewards.begin(episode)
        if self._window is not None:
            window, simulation = self._window, episode.simulation
            window.show(simulation.scene)
            simulation.observers.append(lambda: window.follow(simulation.scene))

    def _running(self) -> Episode:
        """Return the current episode, which must not be over.

        Raises:
            ResetNeededError: The episode is over, or there is none.
        """
        if self.episode.is_over:
            raise ResetNeededError(
                f"The episode {self.instance.key} is over. Call reset() before step()."
            )
        return self.episode

    @abstractmethod
    def step(self, action: Any) -> StepResult:
        """Execute one action."""
        raise NotImplementedError

    def observe(self) -> Observation:
        """Return the present observation."""
        return self._observer.observe(self.episode, self.config.instruction)

    def view(self) -> View:
        """Return the present view, as policies get it in ``lemma evaluate``.

        Images are rendered on first access, whatever the option ``observation`` is.

        Raises:
            ResetNeededError: There is no episode yet.
        """
        return self._observer.view(self.episode.simulation.scene)

    def info(self) -> dict[str, Any]:
        """Return the ``info`` of the present state, as steps and resets report it."""
        return self._report()

    def _report(self, progress: float | None = None) -> dict[str, Any]:
        """Return :meth:`info`, given the goal's progress if already computed."""
        found = self._full_info(progress)
        return numbers_of(found) if self.config.numeric_info else found

    def _full_info(self, progress: float | None) -> dict[str, Any]:
        """Return the ``info`` with text and poses as well as numbers."""
        found = self.episode.info(progress)
        found["instruction"] = self.task_description
        found["state"] = object_poses(self.episode.simulation.scene)
        if self.rewards.potential is not None:
            found["potential"] = self.rewards.potential
        return found

    def cameras(self) -> dict[str, Camera]:
        """Return the observed cameras with their present calibration.

        See :class:`~lemma.env.config.EnvConfig` for the choice of cameras.
        """
        scene, rig = self.episode.simulation.scene, self._observer.rig
        scene.refresh()
        return {
            name: rig.calibrated(scene, scene.data, name)
            for name in self._observer.cameras
        }

    def render(self) -> RgbImage | None:
        """Return an image for people; None without a render mode, or in a window.

        Returns:
            Colors, (``render_height``, ``render_width``, 3).

        Raises:
            ResetNeededError: There is no episode yet.
            RenderingError: OpenGL does not work here.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() was called without a render mode. Make the environment with "
                'render_mode="rgb_array".'
            )
            return None
        if self._window is not None:
            return None
        if self._renderer is None:
            size = (self.config.render_width, self.config.render_height)
            self._renderer = Renderer(*size, quality="video")
        scene = self.episode.simulation.scene
        scene.refresh()
        return self._renderer.rgb(scene.model, scene.data, OVERVIEW)

    def close(self) -> None:
        """Free the resources of rendering."""
        self._observer.close()
        if self._window is not None:
            self._window.close()
        if self._renderer is not None:
            self._renderer.close()

    def state_hash(self) -> str:
        """Return the SHA-256 of the full integration state of the physics."""
        return self.episode.simulation.scene.state_hash()

    def snapshot(self) -> EnvSnapshot:
        """Return the full state of the episode."""
        return EnvSnapshot(self.episode.snapshot(), self._remember())

    def restore(self, snapshot: EnvSnapshot) -> tuple[Observation, dict[str, Any]]:
        """Restore a snapshot, which may be of another instance or environment.

        With the same options, the episode then continues bit-identically.

        Returns:
            The observation and ``info`` of the snapshot's state.

        Raises:
            InvalidConfigError: The argument is no snapshot, or its team differs.
        """
        if not isinstance(snapshot, EnvSnapshot):
            raise InvalidConfigError(
                f"{shown(snapshot)} is no snapshot. Valid: a result of snapshot()."
            )
        instance = snapshot.episode.instance
        if self._episode is None or self._episode.instance != instance:
            self._instances.check(instance)
            self._begin(
                Episode(
                    instance,
                    horizon_s=self.config.horizon_s,
                    actuation=self.actuation,
                )
            )
        self.episode.restore(snapshot.episode)
        self._recall(snapshot.level)
        self.rewards.begin(self.episode)
        return self.observe(), self.info()

    def _remember(self) -> dict[str, Any]:
        """Return the subclass's state beside the episode."""
        return {}

    def _recall(self, memory: dict[str, Any]) -> None:
        """Restore what :meth:`_remember` returned."""


def numbers_of(info: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers of an environment's ``info``.

    Args:
        info: ``info`` of a step or reset.

    Returns:
        ``is_success`` and ``success``, ``progress`` and ``goal_progress``,
        ``elapsed_s`` [s], ``potential`` (only with dense rewards), the numbers of
        fallen and of thrown objects, and ``idle_s`` in the order of the robots,
        (robots,) [s].
    """
    names = (
        "is_success",
        "success",
        "progress",
        "goal_progress",
        "elapsed_s",
        "potential",
    )
    return {
        **{name: info[name] for name in names if name in info},
        "fallen": len(info["fallen"]),
        "thrown": len(info["thrown"]),
        "idle_s": np.array(list(info["idle_s"].values())),
    }
