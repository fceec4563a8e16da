"""Episodes at control level: a policy's motor commands, many episodes at once.

The loop and the verdicts are those of the skill level. There is no protective stop,
because motors do not execute infeasible commands.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lemma.core.arguments import known
from lemma.core.errors import InvalidActionError, InvalidConfigError
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.observation import OBSERVATIONS, Observer, write_text
from lemma.evaluation.protocol.language_controls import OWN_SENTENCE, LanguageControl
from lemma.evaluation.run.fault_isolation import Fault
from lemma.evaluation.run.loading import load_policy
from lemma.evaluation.run.rollout import Player, Rollout, Verdict
from lemma.evaluation.run.together import TeamPlayer
from lemma.evaluation.run.watches import HandlingWatch
from lemma.policies.control.interfaces import (
    CONTROL_OPTIONS,
    ControlInput,
    ControlPolicy,
    chunk_of,
)
from lemma.policies.control.oracle import OracleControlInput
from lemma.policies.interfaces import is_oracle
from lemma.policies.spec import PolicySpec
from lemma.serve.faults import FaultKind
from lemma.tasks.instance import Instance
from lemma.tasks.suite import FREE_SPLIT

_DEFAULTS = {"control": "joint_position", "control_hz": 20.0, "observation": "rgb"}


def environment_of(policy: object, task: str) -> EnvConfig:
    """Return the options of a policy's environment.

    Args:
        policy: A policy at control level.
        task: Name of the task.

    Raises:
        LemmaError: An option of the policy is unknown or invalid, or it would observe
            privileged state and is no oracle.
    """
    asked = getattr(policy, "control_options", {})
    if not isinstance(asked, Mapping):
        raise InvalidConfigError(
            f"control_options of the policy is a {type(asked).__name__}. Valid: a "
            'dictionary, such as {"control": "delta_ee_pose", "control_hz": 10}.'
        )
    for name in asked:
        known("option of a policy", name, CONTROL_OPTIONS)
    config = EnvConfig(
        task=task,
        split=FREE_SPLIT,
        horizon_s=Rollout.horizon_s,
        **{**_DEFAULTS, **asked},
    ).at_control_level()
    if OBSERVATIONS[config.observation].truth and not is_oracle(policy):
        fair = (name for name in OBSERVATIONS if not OBSERVATIONS[name].truth)
        raise InvalidConfigError(
            f"observation={config.observation!r} contains privileged state. Valid: "
            f"{', '.join(fair)}; or derive the policy from "
            "lemma.policies.interfaces.Oracle, which its result states."
        )
    return config


@dataclass(kw_only=True)
class ControlRollout(Rollout):
    """One episode at control level."""

    config: EnvConfig
    """Options of the policy's environment."""
    actions: int = 0
    """Number of control steps so far."""
    asked: int = 0
    """Number of the policy's decisions so far."""
    memory: Any = None
    """The policy's memory of this episode."""

    def _begin(self) -> Episode:
        self.env = ControlEnv(self.config)
        self.env.set_table(options={"instance": self.instance})
        self.handling = HandlingWatch(self.env.episode)
        return self.env.episode

    def look(self, observer: Observer, *, oracle: bool) -> ControlInput:
        """Return the present input of a policy: copies, without references to the env.

        Args:
            observer: Creates the observation.
            oracle: Whether the input has privileged state, too.

        Raises:
            RenderingError: OpenGL does not work here.
        """
        observation = observer.observe(self.episode, self.kind)
        observation["instruction"] = write_text(self.instruction)
        scene = self.episode.simulation.scene
        cameras = {}
        if observer.contents.renders:
            scene.refresh()
            cameras = {
                name: observer.rig.calibrated(scene, scene.data, name)
                for name in observer.cameras
            }
        fields: dict[str, Any] = {
            "instruction": self.instruction,
            "robots": self._phrases,
            "observation": _copied(observation),
            "cameras": cameras,
            "step": self.actions,
            "time_s": self.episode.elapsed_s,
            "memory": self.memory,
        }
        if oracle:
            return OracleControlInput(**fields, env=self.env)
        return ControlInput(**fields)

    def take(self, policy_input: object, decision: Any) -> None:
        """Execute the actions of a policy, up to the end of the episode."""
        self.asked += 1
        self.memory = decision.memory
        layout = self.env.action_layout
        try:
            chunk = chunk_of(decision.rows, layout.shape)
        except ValueError as error:
            names = f"rows {', '.join(layout.rows)}, {', '.join(layout.columns)}"
            self.fail(Fault(FaultKind.MALFORMED, f"{error}; {names}."))
            return
        try:
            for row in chunk:
                _, terminated, truncated = self.env.advance(row)
                self.actions += 1
                self.handling.look()
                if terminated or truncated:
                    return
        except InvalidActionError as error:
            self.fail(Fault(FaultKind.MALFORMED, str(error)))

    def fields(self, strict: Verdict) -> dict[str, Any]:
        """Return the fields of its line that only the control level has."""
        return {
            "control": {
                "mode": self.config.control,
                "hz": self.config.control_hz,
                "actions": self.actions,
                "asked": self.asked,
                **self.handling.fields(),
            }
        }


def _copied(observation: dict[str, Any]) -> dict[str, Any]:
    return {
        name: _copied(value) if isinstance(value, dict) else np.array(value)
        for name, value in observation.items()
    }


class ControlPlayer(Player):
    """A policy at control level with its observer."""

    def __init__(self, policy: ControlPolicy) -> None:
        """Store the policy; the first image starts OpenGL.

        Args:
            policy: The policy.
        """
        super().__init__(policy)
        self._observers: dict[tuple[int, tuple[str, ...]], Observer] = {}

    def begin(
        self, instance: Instance, kind: str, control: LanguageControl = OWN_SENTENCE
    ) -> Rollout:
        """Begin an episode.

        Raises:
            LemmaError: The policy's options of the environment are invalid.
        """
        config = environment_of(self.policy, instance.task)
        return ControlRollout(instance, kind, control=control, config=config)

    def policy_input(self, rollout: Rollout) -> ControlInput:
        """Return the policy's present input in an episode."""
        assert isinstance(rollout, ControlRollout)
        robots, config = len(rollout.instance.scene.robots), rollout.config
        key = (robots, config.kinds)
        if key not in self._observers:
            self._observers[key] = Observer(
                config.observation,
                tuple(range(robots)),
                config.image_size,
                config.cameras,
                config.kinds,
            )
        return rollout.look(self._observers[key], oracle=is_oracle(self.policy))


def load_player(spec: PolicySpec) -> Player:
    """Load a policy of any level by name.

    Raises:
        LemmaError: There is no such policy, or its weights are damaged.
    """
    if spec.controls:
        return ControlPlayer(load_policy(spec))
    if spec.together:
        return TeamPlayer.load(spec)
    return Player.load(spec)
