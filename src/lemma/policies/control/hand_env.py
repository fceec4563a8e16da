"""The control level for one hand that points down and moves in Cartesian steps.

A small environment for reinforcement learning. The robot that reaches the object has
five action dimensions, observes the features in
:data:`~lemma.policies.control.hand_steps.FEATURE_NAMES`, and gets a dense reward for
progress through the stages. Actions, features and rewards are those of
:mod:`lemma.warp`, so :class:`~lemma.policies.control.hand_steps.HandPolicy` executes
networks from both.
"""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray

from lemma.core.arguments import real
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.env.signals.goal_state import grasp_of
from lemma.policies.control.hand_starts import starts
from lemma.policies.control.hand_steps import (
    COLUMNS,
    CONTROL_HZ,
    FEATURES,
    Arms,
    Hand,
)
from lemma.robots.gripper import FINGER_OPENING_M


class HandEnv(gymnasium.Env[NDArray[np.float32], Any]):
    """One robot moves its hand forward, left and up, turns it, and moves its fingers.

    The acting robot is the one that reaches the goal's first object. Actions and
    features are in :mod:`~lemma.policies.control.hand_steps`.

    The reward of a step is the increase of the potential of ``reward="dense"``, plus 1
    for success. An episode that ends because an object was thrown has no further
    penalty, so that hands do not learn to avoid objects.
    """

    def __init__(
        self,
        task: str,
        split: str = "train",
        *,
        horizon_s: float = 8.0,
        near: float = 0.0,
    ) -> None:
        """Define the spaces.

        Args:
            task: A task without sticks that one robot can do: ``"lift_varied"``.
            split: Split of its instances.
            horizon_s: Simulated seconds after which an episode is truncated.
            near: Share of episodes that begin with the hand over the goal's first
                object, around it or closed on it; the attribute may be changed.

        Raises:
            UnknownNameError: There is no such task or split.
            InvalidConfigError: The share is out of range.
        """
        config = EnvConfig(
            task=task, split=split, observation="goal_state", control="joint_position",
            control_hz=CONTROL_HZ, clip_actions=True, reward="dense",
            reward_discount=1.0, horizon_s=horizon_s,
        )  # fmt: skip
        self.lemma, self.near = ControlEnv(config), real("near", near, 0.0, 1.0)
        self.action_space = Box(-1.0, 1.0, (len(COLUMNS),))
        self.observation_space = Box(-np.inf, np.inf, (FEATURES,))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode; see :meth:`lemma.env.control_env.ControlEnv.reset`."""
        super().reset(seed=seed)
        self.lemma.set_table(seed, options)
        observation, asked = self.lemma.observe(), None
        noise = self.np_random.random(6)
        if noise[5] < self.near:
            asked = self._start(Hand(observation).robot, noise[:5])
            observation = self.lemma.observe()
        self._hand = Hand(observation, asked)
        info = self.lemma.info()
        self._potential = info["potential"]
        return self._look(observation), info

    def _start(self, robot: int, noise: NDArray[np.float64]) -> float:
        """Put a hand near the goal's first object; return its commanded opening [m]."""
        episode = self.lemma.episode
        scene, goal = episode.simulation.scene, episode.instance.goal
        arm = list(episode.simulation.arms.values())[robot]
        at, quarter = grasp_of(goal.entities[0], scene)
        foot = arm.robot.placement.base
        numbers = (at, (*foot.xy, foot.yaw), arm.measured, noise)
        where, base, angles, drawn = (
            torch.tensor(np.array([row]), dtype=torch.float32) for row in numbers
        )
        arms = Arms.of([arm.robot.arm.name])
        q, opening, asked, possible = starts(where, quarter, base, arms, angles, drawn)
        if not bool(possible[0]):
            return FINGER_OPENING_M
        found = q[0].double().numpy()
        scene.set_joints(arm.robot, found, float(opening[0]))
        arm.sync()
        arm.follow_posture(found)
        arm.opening_m = float(asked[0])
        self.lemma.take_over(episode)
        return arm.opening_m

    def _look(self, observation: dict[str, Any]) -> NDArray[np.float32]:
        found: NDArray[np.float32] = self._hand.look(observation)[0].numpy()
        return found

    def step(
        self, action: Any
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move one hand; the other robots stay where they are."""
        row = torch.as_tensor(action, dtype=torch.float32).reshape(1, len(COLUMNS))
        rows = self._hand.command(row)
        observation, _, terminated, truncated, info = self.lemma.step(rows)
        won = bool(terminated and info["is_success"])
        reward = float(won)
        if won or not terminated:
            reward += info["potential"] - self._potential
            self._potential = info["potential"]
        return self._look(observation), reward, terminated, truncated, info

    def close(self) -> None:
        """Close the wrapped environment."""
        self.lemma.close()
