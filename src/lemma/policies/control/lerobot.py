"""LeRobot policies as policies at control level: ``--policy lerobot:CHECKPOINT``.

Policies with privileged state are oracles: ``--policy lerobot-privileged:CHECKPOINT``.
The module needs the lerobot package, which ``lemma-bench[lerobot]`` installs.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy, deepcopy
from typing import Any

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError
from lemma.core.robot_names import robot_names
from lemma.env.camera_rig import camera_names
from lemma.env.learning.motor_state import MOTOR_CONTROLS, motor_names, motor_state
from lemma.env.observation import truth_names, truth_vector
from lemma.policies.class_path import LEROBOT, LEROBOT_PRIVILEGED
from lemma.policies.control.checkpoint_file import checkpoint_folder
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Oracle
from lemma.tasks.language.vector import NUMBERS as SENTENCE_NUMBERS
from lemma.tasks.language.vector import sentence_vector

TEAM = robot_names(2)
_CONTROLS: Mapping[tuple[int, ...], str] = {
    (len(motor_names(name, TEAM)),): name for name in MOTOR_CONTROLS
}
"""Control modes by the shape of a state and of an action."""
TRUTH = truth_names(TEAM)
"""Names of the numbers of the true state."""
_SHARED = ("_parameters", "_buffers", "_modules")
"""Attributes of the network, which all episodes share."""
_DRAWS_ONCE = ("diffusion", "DDIM")
"""Type and scheduler of a policy whose only random numbers are the initial noise."""
_TOGETHER = (_DRAWS_ONCE, ("act", None))
"""Those whose chunk for an episode cannot depend on the others of a batch."""


class LeRobotPolicy:
    """A checkpoint that lerobot saved, trained on ``lemma render --form lerobot``.

    Its cameras and their size come from its configuration. Chunks of actions have the
    same length as in ``lerobot-eval``; the policy is not called, and no images are
    rendered, until a chunk ends. Policies with a history of several observations are
    called at every step.
    """

    def __init__(self, checkpoint: str, hz: float = 10.0, device: str = "cpu") -> None:
        """Load a policy and its processors.

        Args:
            checkpoint: A folder, ``.../checkpoints/last/pretrained_model``, a name on
                the Hub, or the name of published weights of this package.
            hz: Actions per second: the frames per second of its training data.
            device: Device of the policy, such as ``"cuda"``.

        Raises:
            InvalidConfigError: Its inputs or outputs are not available here.
            OSError: There is no such checkpoint.
            WeightsError: Published weights are missing or damaged.
        """
        with checkpoint_folder(checkpoint) as folder:
            config = PreTrainedConfig.from_pretrained(folder)
            config.pretrained_path = folder
            config.device = device
            self.control_options = control_options(
                config, hz, privileged=isinstance(self, Oracle)
            )
            self._config = config
            self._policy = get_policy_class(config.type).from_pretrained(
                folder, config=config
            )
            self._policy.eval()
            self._before, self._after = make_pre_post_processors(
                config,
                pretrained_path=folder,
                preprocessor_overrides={"device_processor": {"device": device}},
            )
        self._control = self.control_options["control"]
        ensembles = getattr(config, "temporal_ensemble_coeff", None) is not None
        # lerobot has queues even for a single observation.
        self._queues = OBS_STATE in (getattr(self._policy, "_queues", None) or {})
        self._looks_on = config.n_obs_steps > 1 or ensembles
        # Others, such as SmolVLA, draw noise for the whole batch at once.
        kind = (config.type, getattr(config, "noise_scheduler_type", None))
        self._one_by_one = self._looks_on or kind not in _TOGETHER

    @torch.no_grad()
    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return the next action or chunk of actions for each episode.

        Random numbers of a policy, such as Diffusion Policy, depend only on the step,
        not on other episodes of the batch.
        """
        if self._one_by_one:
            return [self._alone(control_input) for control_input in inputs]
        batch = self._before(self._batch(inputs))
        with self._drawing(inputs[0].step):
            if self._queues:
                chunks = self._chunks(batch, noise=self._noise(inputs))
            else:
                chunks = self._policy.predict_action_chunk(batch)
        chunks = chunks[:, : self._config.n_action_steps]
        return [Actions(rows) for rows in self._rows(chunks)]

    def _alone(self, control_input: ControlInput) -> Actions:
        batch = self._before(self._batch([control_input]))
        with self._drawing(control_input.step):
            if not self._looks_on:
                return Actions(self._rows(self._chunks(batch))[0])
            memory = control_input.memory
            policy = self._fresh() if memory is None else memory
            action = policy.select_action(batch)
        return Actions(self._rows(action)[0], policy)

    def _chunks(self, batch: dict[str, Any], **more: Any) -> torch.Tensor:
        """Return the chunks that a policy with queues gives action by action."""
        self._policy.reset()
        count = self._config.n_action_steps
        rows = [self._policy.select_action(batch, **more) for _ in range(count)]
        return torch.stack(rows, 1)

    def _noise(self, inputs: Sequence[ControlInput]) -> torch.Tensor:
        """Return the initial noise, for each episode as in a batch of one."""
        shape = (1, self._config.horizon, self._config.action_feature.shape[0])
        rows = []
        for control_input in inputs:
            with self._drawing(control_input.step):
                rows.append(torch.randn(shape, device=self._config.device))
        return torch.cat(rows)

    @contextmanager
    def _drawing(self, seed: int) -> Iterator[None]:
        """Seed torch's random numbers, and restore their state afterwards."""
        device = torch.device(self._config.device)
        with torch.random.fork_rng([] if device.type == "cpu" else [device]):
            torch.manual_seed(seed)
            yield

    def _fresh(self) -> Any:
        """Return a copy of the policy with its own queues, for a new episode."""
        found = copy(self._policy)
        own = {name: it for name, it in vars(found).items() if name not in _SHARED}
        vars(found).update(deepcopy(own))
        found.reset()
        return found

    def _batch(self, inputs: Sequence[ControlInput]) -> dict[str, Any]:
        seen = [control_input.observation for control_input in inputs]
        state = np.stack([motor_state(self._control, each).ravel() for each in seen])
        found: dict[str, Any] = {
            OBS_STATE: torch.from_numpy(state).float(),
            "task": [control_input.instruction for control_input in inputs],
        }
        if OBS_ENV_STATE in self._config.input_features:
            env_states = np.stack([self._environment_state(one) for one in inputs])
            found[OBS_ENV_STATE] = torch.from_numpy(env_states)
        for camera in self.control_options.get("cameras", ()):
            images = np.stack([each["pixels"][camera] for each in seen])
            found[f"{OBS_IMAGES}.{camera}"] = (
                torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255.0
            )
        return found

    def _environment_state(self, control_input: ControlInput) -> NDArray[np.float32]:
        return sentence_vector(control_input.instruction)

    def _rows(self, actions: torch.Tensor) -> Any:
        """Return actions (..., numbers) as rows of the team, (..., 2, numbers / 2)."""
        values = self._after(actions).cpu().numpy()
        return values.reshape(*values.shape[:-1], len(TEAM), -1)


class PrivilegedLeRobotPolicy(LeRobotPolicy, Oracle):
    """A checkpoint that was trained on privileged state, poses and goal, not images.

    It measures a policy without errors of perception and language.
    """

    def _environment_state(self, control_input: ControlInput) -> NDArray[np.float32]:
        return truth_vector(control_input.observation)


def control_options(
    config: Any, hz: float, *, privileged: bool = False
) -> dict[str, Any]:
    """Return the options of the environment of a policy.

    Args:
        config: Configuration of a lerobot policy.
        hz: Actions per second.
        privileged: Whether its environment state is the privileged state.

    Raises:
        InvalidConfigError: Its inputs or outputs are not available here.
    """
    features = {**config.input_features, **config.output_features}
    shapes = {name: tuple(feature.shape) for name, feature in features.items()}
    image_names = [name for name in shapes if name.startswith(f"{OBS_IMAGES}.")]
    images = {
        name.removeprefix(f"{OBS_IMAGES}."): shapes.pop(name) for name in image_names
    }
    row = shapes.get(ACTION, ())
    plain = {OBS_STATE: row, ACTION: row}
    env_numbers = len(TRUTH) if privileged else SENTENCE_NUMBERS
    with_env_state = {**plain, OBS_ENV_STATE: (env_numbers,)}
    allowed = [with_env_state] if privileged else [plain, with_env_state]
    if row not in _CONTROLS or shapes not in allowed:
        counts = " or ".join(str(count) for (count,) in _CONTROLS)
        raise InvalidConfigError(
            f"The policy has {shapes} besides its images. Valid: {OBS_STATE} and "
            f"{ACTION} of {counts} numbers, as lemma render --form lerobot writes "
            f"them, and {OBS_ENV_STATE} of {SENTENCE_NUMBERS}, with "
            f"--environment-state sentence, or of {len(TRUTH)}, with "
            "--environment-state privileged, for "
            f"{LEROBOT_PRIVILEGED}CHECKPOINT."
        )
    options = {"control": _CONTROLS[row], "control_hz": hz, "clip_actions": True}
    if privileged:
        if images:
            raise InvalidConfigError(
                f"The policy has the images {', '.join(images)} as input, so it is not "
                f"privileged. Name it {LEROBOT}CHECKPOINT."
            )
        return {**options, "observation": "privileged"}
    valid = camera_names(TEAM)
    if not images or set(images) - set(valid) or len(set(images.values())) > 1:
        raise InvalidConfigError(
            f"The policy's images are {images}. Valid: one or more of "
            f"{', '.join(f'{OBS_IMAGES}.{name}' for name in valid)}, all of one size."
        )
    _, height, width = next(iter(images.values()))
    seen = {"observation": "rgb", "cameras": tuple(images)}
    return {**options, **seen, "width": width, "height": height}
