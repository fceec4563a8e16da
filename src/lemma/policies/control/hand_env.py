"""The control level for one hand that points down and is moved step by step.

A small environment for learners: the robot that reaches the object acts by five
numbers, sees the named numbers of
:data:`~lemma.policies.control.hand_steps.FEATURE_NAMES`, and is paid for coming
further, stage by stage. The same functions move, show and pay hands in
:mod:`lemma.warp`, and :class:`~lemma.policies.control.hand_steps.HandPolicy` plays what
was learned here or there.
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
    """A robot moves its hand forward, left and up, turns it, and moves its fingers.

    It is the one that reaches the goal's first object.

    The reward of a step is the rise of the potential of ``reward="dense"``, and 1 more
    for success. An end because something was thrown costs nothing but what could have
    been earned later, so that hands do not learn to keep away from things.
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
                object, around it or closed on it; may be changed at any time.

        Raises:
            UnknownNameError: No such task or split.
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
        """Set the table, as the environment inside does."""
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
        """Put a hand near the goal's first object; return its asked opening [m]."""
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
        """Free what the environment inside uses."""
        self.lemma.close()
