"""One network for both hands of a team of two, in batches of tensors.

The network is applied to each robot: its inputs are the features of the robot's own
hand, then those of the other robot's hand, so its outputs do not depend on the order of
the robots. Its outputs are an action row of :mod:`~lemma.policies.control.hand_steps`
for each hand. All hands move at the same time. It gets privileged state, the goal
state, and does not read the instruction.
"""

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.motion.arm_motion import park_joints
from lemma.policies.control.hand_steps import (
    FEATURES,
    OBJECT,
    PLACE,
    TURN_RAD,
    Arms,
    HandPolicy,
    advance,
    arm_of,
    features,
    hands_of,
    joints,
    openings,
    pace,
    wrapped,
)
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.robots.gripper import FINGER_OPENING_M, TCP_OFFSET_M
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.kinematics import forward

_NEAR_M, _MARGIN_M, _FAR_M = 0.05, 0.1, 0.3
CUBE_M = 0.025
"""Height of the grasp position of a cube on the table [m]."""
LAYOUT_NAMES = (
    "object_margin",
    "place_margin",
    *(f"{part}_{way}" for part in ("shared", "home") for way in ("forward", "left")),
    "home_up",
    "shared_forward_nearby",
    "shared_left_nearby",
    "home_turn",
    "asked",
    "object_height_nearby",
)
"""Names of the features of a hand that depend on the layout of the team."""
TEAM_FEATURES = FEATURES + len(LAYOUT_NAMES)
"""Number of features of one hand; the network has twice as many inputs."""


def homes_of(names: Any) -> Tensor:
    """Return the hands of parked arms in the frame of the base, (robots, 4) [m, rad].

    Args:
        names: Names of the arm types.
    """
    found = []
    for name in names:
        pose = forward(ARMS[name].dh, np.asarray(park_joints(name)))
        x, y, z = pose[:3, 3] + TCP_OFFSET_M * pose[:3, 2]
        found.append([x, y, z, math.atan2(pose[1, 0], pose[0, 0])])
    return torch.tensor(found, dtype=torch.float32)


@dataclass(frozen=True, eq=False)
class Team:
    """The state of a team of two hands, (..., 2, numbers), as the network observes it.

    ``target``, ``here`` and ``base`` are as in
    :mod:`~lemma.policies.control.hand_steps`.
    """

    goal: Tensor
    """Goal state, (..., 2, 13); see :mod:`lemma.env.signals.goal_state`."""
    target: Tensor
    here: Tensor
    base: Tensor
    asked: Tensor
    """The last commanded openings, (..., 2) [m]."""
    arms: Arms
    homes: Tensor
    """Of :func:`homes_of`."""

    def world(self, way: Tensor) -> Tensor:
        """Return vectors in the frames of the hands in the world frame, (..., 2, 2)."""
        a, b = self.ahead.unbind(-1)
        x, y = way[..., 0], way[..., 1]
        return torch.stack([a * x - b * y, a * y + b * x], -1)

    def seen(self, way: Tensor) -> Tensor:
        """Return horizontal vectors in the world as forward and left, (..., 2, 2)."""
        a, b = self.ahead.unbind(-1)
        x, y = way[..., 0], way[..., 1]
        return torch.stack([a * x + b * y, a * y - b * x], -1)

    @property
    def ahead(self) -> Tensor:
        """The forward directions of the hands, (..., 2, 2)."""
        away = self.here[..., :2] - self.base[..., :2]
        found: Tensor = away / torch.linalg.vector_norm(away, dim=-1, keepdim=True)
        return found

    @property
    def object(self) -> Tensor:
        """The grasp position of the goal's object, x and y, (..., 2, 2) [m]."""
        return self.here[..., :2] + self.world(self.goal[..., OBJECT : OBJECT + 2])

    @property
    def height(self) -> Tensor:
        """The height of the grasp position, (..., 2) [m]."""
        return self.here[..., 2] + self.goal[..., OBJECT + 2]

    @property
    def place(self) -> Tensor:
        """Its place, x and y, (..., 2, 2) [m]."""
        return self.object + self.world(self.goal[..., PLACE : PLACE + 2])

    @property
    def shared(self) -> Tensor:
        """The middle of the region that both robots reach, (..., 1, 2) [m]."""
        first, second = self.base[..., :1, :2], self.base[..., 1:, :2]
        between = second - first
        far = torch.linalg.vector_norm(between, dim=-1, keepdim=True)
        outer = self.arms.radii[:, 1]
        found: Tensor = first + between * (0.5 + 0.5 * (outer[0] - outer[1]) / far)
        return found

    @property
    def home(self) -> Tensor:
        """Parking poses of the hands in the world: x, y, z, yaw, (..., 2, 4)."""
        c, s = torch.cos(self.base[..., 2]), torch.sin(self.base[..., 2])
        x, y, z, yaw = self.homes.unbind(-1)
        found = [
            self.base[..., 0] + c * x - s * y,
            self.base[..., 1] + s * x + c * y,
            z.expand_as(c),
            self.base[..., 2] + yaw,
        ]
        return torch.stack(found, -1)

    def margins(self, points: Tensor) -> Tensor:
        """Return how far points are inside each robot's reach, (..., 2) [m]."""
        far = torch.linalg.vector_norm(points - self.base[..., :2], dim=-1)
        inner, outer = self.arms.radii.unbind(-1)
        return torch.minimum(far - inner, outer - far)

    def features(self) -> Tensor:
        """Return the inputs of the network, (..., 2, 2 * TEAM_FEATURES)."""
        parts = (self.goal, self.target, self.here, self.base, self.asked)
        home, at = self.home, self.object
        shared = self.seen(self.shared - at)
        margins = torch.stack([self.margins(at), self.margins(self.place)], -1)
        turn = wrapped(home[..., 3:] - self.here[..., 3:])
        own = [
            features(*parts),
            (margins / _MARGIN_M).clamp(-2.0, 2.0),
            shared / _FAR_M,
            self.seen(home[..., :2] - self.here[..., :2]) / _FAR_M,
            (home[..., 2:3] - self.here[..., 2:3]) / _FAR_M,
            torch.tanh(shared / _NEAR_M),
            (turn / TURN_RAD).clamp(-2.0, 2.0),
            self.asked[..., None] / FINGER_OPENING_M,
            torch.tanh((self.height[..., None] - CUBE_M) / _NEAR_M),
        ]
        mine = torch.cat(own, -1)
        return torch.cat([mine, mine.flip(-2)], -1)


def team_network(hidden: int = 256, out: int = 5) -> torch.nn.Sequential:
    """Return the network from the features of a hand to its action row.

    Args:
        hidden: Width of the hidden layers.
        out: Number of outputs.
    """
    return torch.nn.Sequential(
        torch.nn.Linear(2 * TEAM_FEATURES, hidden), torch.nn.ELU(),
        torch.nn.Linear(hidden, hidden), torch.nn.ELU(),
        torch.nn.Linear(hidden, hidden), torch.nn.ELU(),
        torch.nn.Linear(hidden, out),
    )  # fmt: skip


class TeamHands:
    """Both hands of an episode on the CPU."""

    def __init__(self, seen: Mapping[str, Any]) -> None:
        """Begin the episode.

        Args:
            seen: An observation ``"goal_state"`` of the control level.
        """
        self._rows = np.asarray(seen["agent_pos"], np.float32).reshape(-1, 7).copy()
        self._target = hands_of(seen["tcp_pose"])
        both = zip(self._rows, self._target[:, 2], strict=True)
        names = [arm_of(row[:6], height) for row, height in both]
        self._arms, self._homes = Arms.of(names), homes_of(names)

    def look(self, seen: Mapping[str, Any]) -> Team:
        """Return the state of the team in an observation."""
        self._team = Team(
            torch.tensor(seen["goal_state"]).reshape(len(self._rows), -1),
            self._target,
            hands_of(seen["tcp_pose"]),
            hands_of(seen["base_pose"])[:, [0, 1, 3]],
            torch.from_numpy(self._rows[:, 6].copy()),
            self._arms,
            self._homes,
        )
        return self._team

    def command(self, rows: Tensor) -> NDArray[np.float32]:
        """Return joint positions [rad] and openings [m], (robots, 7).

        Args:
            rows: Actions, (robots, 5).
        """
        team, arms = self._team, self._arms
        slow = pace(team.goal)
        target = advance(team.target, rows, team.here, team.base, arms, slow)
        found = self._rows.copy()
        near = torch.from_numpy(self._rows[:, :6])
        found[:, :6] = joints(target, team.base, arms, near).numpy()
        found[:, 6] = openings(rows, team.asked).numpy()
        self._target, self._rows = target, found
        return found


class TeamPolicy(HandPolicy):
    """Executes a network that moves both hands of a team of two at once.

    It supports tasks whose goal is cubes on other objects, without the stick. It gets
    privileged state, the goal state, and does not read the instruction, so its results
    are not comparable with those of other policies.
    """

    def __init__(self, weights: str) -> None:
        """Load a network.

        Args:
            weights: File of the state of a :func:`team_network`, by ``torch.save``.
        """
        state = torch.load(weights, weights_only=True, map_location="cpu")
        self.actor = team_network(len(state["0.weight"]))
        self.actor.load_state_dict(state)

    def rows(self, team: Team) -> Tensor:
        """Return the action of both hands, (2, 5)."""
        found: Tensor = self.actor(team.features())
        return found

    def _act(self, control_input: ControlInput) -> Actions:
        seen, memory = control_input.observation, control_input.memory
        # Copy the memory: an episode may continue from it more than once.
        hands = TeamHands(seen) if memory is None else copy(memory)
        return Actions(hands.command(self.rows(hands.look(seen))), hands)
