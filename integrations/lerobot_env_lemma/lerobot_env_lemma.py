"""LEMMA Bench as an environment of lerobot: ``lerobot-eval --env.type=lemma``.

Observations, states and actions are those of ``lemma render --form lerobot``, so the
evaluation of a policy that was trained on such a data set needs no renaming.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import _LazyAsyncVectorEnv, freeze_after_episode_end
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

import lemma
from lemma.core.arguments import known
from lemma.core.robot_names import robot_names
from lemma.dataset.lerobot.frames import ENVIRONMENT_STATES, NONE, PRIVILEGED, SENTENCE
from lemma.env.camera_rig import close_cameras
from lemma.env.learning.flat_view import FlatView
from lemma.env.learning.harness_episodes import HarnessEpisodes
from lemma.env.learning.motor_state import (
    JOINT_POSITION,
    MOTOR_CONTROLS,
    motor_names,
    motor_state,
)
from lemma.env.observation import truth_names
from lemma.env.simulation import HORIZON_S
from lemma.scene.cameras import CLOSE_PX
from lemma.tasks.language.vector import NUMBERS as SENTENCE_NUMBERS
from lemma.tasks.language.vector import sentence_vector
from lemma.tasks.names import SUITE

STATE = "agent_pos"
"""Key of the state in an observation, by lerobot's convention."""
ENV_STATE = "environment_state"
"""Key of the other numbers in an observation, by lerobot's convention."""
TEAM = robot_names(2)
MEASURED = ("agent_pos", "tcp_pose", "base_pose")
"""Observations from which the state is computed."""
FIRST_SEED = 1000
"""The first seed of lerobot-eval, for the first instance."""


class LeRobotNames(gym.ObservationWrapper):
    """A flat view with the names of lerobot."""

    def __init__(self, env: gym.Env) -> None:
        """Rename the spaces."""
        super().__init__(env)
        named = self.observation(env.observation_space)
        if "pixels" in named:
            named["pixels"] = gym.spaces.Dict(named["pixels"])
        self.observation_space = gym.spaces.Dict(named)

    def observation(self, observation: Any) -> dict[str, Any]:
        """Return the state, and images by camera, or the privileged state."""
        prefix = f"{OBS_IMAGES}."
        pixels = {
            name.removeprefix(prefix): observation[name]
            for name in observation
            if name.startswith(prefix)
        }
        found = {STATE: observation[OBS_STATE]}
        if OBS_ENV_STATE in list(observation):
            return {**found, ENV_STATE: observation[OBS_ENV_STATE]}
        return {**found, "pixels": pixels}


class MotorState(gym.ObservationWrapper):
    """The state in the same numbers as an action."""

    def __init__(self, env: gym.Env, control: str) -> None:
        """Change the space.

        Args:
            env: A flat view of :data:`MEASURED`.
            control: The control mode.
        """
        super().__init__(env)
        self._control = control
        self.state_names = tuple(motor_names(control, TEAM))
        """Name of each number of the state: ``robot_0.gripper``."""
        assert isinstance(env.observation_space, gym.spaces.Dict)
        shape = (len(self.state_names),)
        self.observation_space = gym.spaces.Dict(
            {
                **env.observation_space.spaces,
                OBS_STATE: gym.spaces.Box(-np.inf, np.inf, shape, np.float32),
            }
        )

    def observation(self, observation: Any) -> dict[str, Any]:
        """Return the observation with this state."""
        parts = np.split(observation[OBS_STATE], len(MEASURED))
        measured = dict(zip(MEASURED, parts, strict=True))
        state = motor_state(self._control, measured).ravel()
        return {**observation, OBS_STATE: state}


class SentenceVector(gym.ObservationWrapper):
    """The instruction as numbers, for policies that do not read text."""

    def __init__(self, env: gym.Env) -> None:
        """Add the space."""
        super().__init__(env)
        space = gym.spaces.Box(-1.0, 1.0, (SENTENCE_NUMBERS,), np.float32)
        assert isinstance(env.observation_space, gym.spaces.Dict)
        self.observation_space = gym.spaces.Dict(
            {**env.observation_space.spaces, ENV_STATE: space}
        )

    def observation(self, observation: Any) -> dict[str, Any]:
        """Return the observation with the instruction."""
        sentence = self.env.get_wrapper_attr("task_description")
        return {**observation, ENV_STATE: sentence_vector(sentence)}


def make_one(
    task: str,
    options: dict[str, Any],
    environment_state: str = NONE,
    control: str = JOINT_POSITION,
) -> gym.Env:
    """Return an environment.

    Args:
        task: Name of the task.
        options: Fields of :class:`lemma.env.config.EnvConfig`.
        environment_state: Further numbers in observations: none; the instruction,
            besides images; or privileged state, instead of images.
        control: The control mode.
    """
    env = lemma.make(
        task,
        level="control",
        control=control,
        observation=PRIVILEGED if environment_state == PRIVILEGED else "rgb",
        render_mode="rgb_array",
        clip_actions=True,
        **options,
    )
    flat = FlatView(HarnessEpisodes(env, FIRST_SEED), MEASURED)
    named = LeRobotNames(MotorState(flat, control))
    return SentenceVector(named) if environment_state == SENTENCE else named


@EnvConfig.register_subclass("lemma")
@dataclass
class LemmaEnvConfig(EnvConfig):
    """The options ``--env.NAME=...``."""

    task: str | None = "all"
    """Names of tasks, separated by commas, or all."""
    fps: int = 10
    """Actions per simulated second, as in the training data."""
    split: str = "test"
    """Split of the instances, in order: seed 1000 is the first one."""
    instruction: str = "high_level"
    """Kind of instruction: high_level, human, unseen or blind."""
    cameras: str = ",".join(close_cameras(TEAM))
    """Names of cameras, separated by commas; others are robot_0 and overview."""
    width: int = CLOSE_PX
    """Width of camera images [px], as in the training data."""
    height: int = CLOSE_PX
    """Height of camera images [px]."""
    environment_state: str = NONE
    """As in the training data: none, sentence, or, instead of images, privileged."""
    control: str = JOINT_POSITION
    """Control mode, as in the training data: joint_position or ee_waypoint_rot6d."""
    render_width: int = 320
    """Width of the images of videos [px], which are rendered at every step."""
    render_height: int = 180
    """Height of the images of videos [px]."""
    horizon_s: float = HORIZON_S
    """Simulated time after which an episode ends [s]."""
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    """Features by name, computed from the fields above."""
    features_map: dict[str, str] = field(default_factory=dict)
    """LeRobot's names of the features, computed as well."""

    def __post_init__(self) -> None:
        """Compute the features."""
        known("environment state", self.environment_state, ENVIRONMENT_STATES)
        known("control mode of data sets", self.control, MOTOR_CONTROLS)
        row = (len(motor_names(self.control, TEAM)),)
        image = (self.height, self.width, 3)
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, row),
            STATE: PolicyFeature(FeatureType.STATE, row),
        }
        if self.environment_state != PRIVILEGED:
            for name in _listed(self.cameras):
                seen = PolicyFeature(FeatureType.VISUAL, image)
                self.features[f"{OBS_IMAGES}.{name}"] = seen
        sizes = {
            SENTENCE: SENTENCE_NUMBERS,
            PRIVILEGED: len(truth_names(TEAM)),
        }
        if self.environment_state != NONE:
            shape = (sizes[self.environment_state],)
            self.features[ENV_STATE] = PolicyFeature(FeatureType.ENV, shape)
        named = {STATE: OBS_STATE, ENV_STATE: OBS_ENV_STATE}
        self.features_map = {name: named.get(name, name) for name in self.features}

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Options of an environment, besides its task."""
        return {
            "control_hz": float(self.fps),
            "split": self.split,
            "instruction": self.instruction,
            "cameras": _listed(self.cameras),
            "width": self.width,
            "height": self.height,
            "render_width": self.render_width,
            "render_height": self.render_height,
            "horizon_s": self.horizon_s,
        }

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Return a vector of environments for each task: ``{task: {0: vector}}``.

        An environment whose episode has ended does not step until the next rollout.
        """
        found = {}
        for task in SUITE if self.task in (None, "all") else _listed(self.task):
            style = self.environment_state, self.control
            maker = partial(make_one, task, self.gym_kwargs, *style)
            makers = [maker] * n_envs
            if use_async_envs and n_envs > 1:
                # Its processes start with the first episode of the task.
                found[task] = {0: _LazyAsyncVectorEnv(makers)}
            else:
                frozen = [freeze_after_episode_end(maker) for maker in makers]
                found[task] = {0: gym.vector.SyncVectorEnv(frozen)}
        return found


def _listed(names: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in names.split(",") if name.strip())
