"""Cartesian steps of hands that point down, in batches of tensors.

An action row has five numbers in [-1, 1] for each robot: forward, left, up, turn,
fingers. *Forward* is horizontally away from the axis of the robot's base, *left* is to
the left of that. *Fingers* changes the commanded opening, which otherwise stays, so
that a zero action does not release an object. An empty hand makes shorter steps near
its object, so that it does not push it away. These functions move thousands of hands on
a GPU, in :mod:`lemma.warp`, and one on the CPU, in :class:`Hand`.

Targets are (x, y, z, yaw) of tool centre points in the world, (..., robots, 4); bases
(x, y, yaw), (..., robots, 3) [m, rad].
"""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.core.poses import matrix_from_quaternion
from lemma.env.control.pose_controllers import LEASH_STEPS
from lemma.env.signals.goal_state import NUMBERS
from lemma.motion.arm_motion import park_joints
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.robots.gripper import FINGER_OPENING_M, TCP_OFFSET_M
from lemma.robots.reach import reach_of
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.kinematics import forward

COLUMNS = ("forward", "left", "up", "turn", "fingers")
CONTROL_HZ = 10.0
STEP_M, TURN_RAD, GRIP_M = 0.03, 0.25, 0.025
"""Largest step along each axis [m], about the vertical [rad], and of the opening
[m]."""
SLOW_M, SLOWEST = 0.1, 0.3
"""Distance from the grasp pose of its object [m] within which an empty hand makes
shorter steps, and the smallest length as a share."""
LOWEST_M, HIGHEST_M = 0.016, 0.5
"""Range of a target's height [m], with the fingertips above the table."""
UNITS = (1.0, 1.0, 1.0, 1.0, 0.1, 1.0, *[0.3] * 3, 0.5, *[0.3] * 3)
"""Divisors that scale the numbers of a goal state to about 1."""
OBJECT, PLACE = NUMBERS.index("object_forward"), NUMBERS.index("place_forward")
"""Columns of a goal state where object and place begin."""
HOLDS = NUMBERS.index("holds")
"""Column of a goal state: whether the hand holds the object."""
_NEAR_M = 0.05
_NEAR = (OBJECT, PLACE)
FEATURE_NAMES = (
    *NUMBERS,
    *(f"{part}_{way}_nearby" for part in ("object", "place") for way in COLUMNS[:3]),
    *(f"lead_{column}" for column in COLUMNS),
)
"""Names of the features of one robot; see :func:`features`."""
FEATURES = len(FEATURE_NAMES)


@dataclass(frozen=True, eq=False)
class Arms:
    """Parameters of the arms of a team, one row for each robot."""

    dh: Tensor
    """Denavit-Hartenberg lengths, (robots, 6) [m]."""
    radii: Tensor
    """Smallest and largest radius of a target around the base, (robots, 2) [m]."""
    park: Tensor
    """Joint angles of the parking pose, (robots, 6) [rad]."""
    branch: Tensor
    """Signs of shoulder, wrist and elbow of the parking pose's branch of the inverse
    kinematics, (robots, 3)."""

    @property
    def parts(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """All fields, in the order of the arguments."""
        return self.dh, self.radii, self.park, self.branch

    @classmethod
    def of(cls, names: Sequence[str], device: Any = "cpu") -> "Arms":
        """Return the parameters of arms by name."""
        dh = torch.tensor(np.array([ARMS[name].dh for name in names]))
        park = torch.tensor([park_joints(name) for name in names])
        reach = [reach_of(name) for name in names]
        radii = torch.tensor([(one.inner_m + 0.02, one.grasp_m) for one in reach])
        branch = torch.ones(len(names), 3)
        for k, name in enumerate(names):
            pose = forward(ARMS[name].dh, park[k].double().numpy())
            x, y, z = pose[:3, 3] + TCP_OFFSET_M * pose[:3, 2]
            here = [x, y, z, math.atan2(pose[1, 0], pose[0, 0])]
            signs = torch.cartesian_prod(*[torch.tensor([1.0, -1.0])] * 3)
            arms = cls(dh[[k] * 8], radii[[k] * 8], park[[k] * 8], signs)
            ways = joints(
                torch.tensor(here).expand(8, 4), torch.zeros(8, 3), arms, arms.park
            )
            branch[k] = signs[(ways - park[k]).abs().amax(1).argmin()]
        return cls(*(part.float().to(device) for part in (dh, radii, park, branch)))


def joints(target: Tensor, base: Tensor, arms: Arms, near: Tensor) -> Tensor:
    """Return the inverse kinematics of hands that point down, (..., robots, 6) [rad].

    For a target out of reach the arm is stretched towards it.

    Args:
        target: See the module.
        base: See the module.
        arms: The robots' arms.
        near: Joint angles, (..., robots, 6) [rad]; full turns are added to the result
            to come near them.
    """
    d1, a2, a3, d4, d5, d6 = arms.dh.unbind(-1)
    shoulder, wrist, elbow = arms.branch.unbind(-1)
    away, turn = target[..., :2] - base[..., :2], base[..., 2]
    radius = torch.linalg.vector_norm(away, dim=-1).clamp_min(1e-6)
    heading = torch.atan2(away[..., 1], away[..., 0]) - turn
    q1 = heading + shoulder * torch.acos((d4 / radius).clamp(-1, 1)) + math.pi / 2
    yaw = target[..., 3] - turn
    q5 = wrist * math.pi / 2 + torch.zeros_like(q1)
    q6 = torch.atan2(-wrist * torch.cos(yaw - q1), wrist * torch.sin(q1 - yaw))
    x = radius * torch.cos(heading - q1) - wrist * d5
    y = target[..., 2] + TCP_OFFSET_M + d6 - d1
    cos_q3 = (x * x + y * y - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
    q3 = elbow * torch.acos(cos_q3.clamp(-1, 1))
    q2 = torch.atan2(-y, -x) - torch.atan2(a3 * torch.sin(q3), a2 + a3 * torch.cos(q3))
    found = torch.stack([q1, q2, q3, q5 - q2 - q3, q5, q6], -1)
    turned = found - math.tau * torch.round((found - near) / math.tau)
    # Joint limits are one full turn; half a turn for the elbow.
    return torch.where(turned.abs() > math.tau, found, turned)


def pace(goal_state: Tensor) -> Tensor:
    """Return the length of steps near the goal's object, as a share, (..., robots, 1).

    Args:
        goal_state: (..., robots, 13); see :mod:`lemma.env.signals.goal_state`.
    """
    at = _NEAR[0]
    far = torch.linalg.vector_norm(goal_state[..., at : at + 3], dim=-1, keepdim=True)
    holds = goal_state[..., HOLDS : HOLDS + 1] > 0.5
    return torch.where(holds, 1.0, (far / SLOW_M).clamp(SLOWEST, 1.0))


def advance(
    target: Tensor, rows: Tensor, here: Tensor, base: Tensor, arms: Arms, slow: Tensor
) -> Tensor:
    """Return the next targets.

    Args:
        target: The last targets; see the module.
        rows: Actions, (..., robots, 5).
        here: Poses of the hands, like targets.
        base: Poses of the bases; see the module.
        arms: The robots' arms.
        slow: Length of the steps, (..., robots, 1); see :func:`pace`.
    """
    rows = slow * rows.clamp(-1.0, 1.0)
    away = here[..., :2] - base[..., :2]
    ahead = away / torch.linalg.vector_norm(away, dim=-1, keepdim=True).clamp_min(1e-6)
    left = torch.stack([-ahead[..., 1], ahead[..., 0]], -1)
    flat = rows[..., :1] * ahead + rows[..., 1:2] * left
    wanted = target[..., :3] + STEP_M * torch.cat([flat, rows[..., 2:3]], -1)
    lead = wanted - here[..., :3]
    length = torch.linalg.vector_norm(lead, dim=-1, keepdim=True).clamp_min(1e-6)
    wanted = here[..., :3] + lead * (LEASH_STEPS * STEP_M / length).clamp_max(1.0)
    out = wanted[..., :2] - base[..., :2]
    radius = torch.linalg.vector_norm(out, dim=-1).clamp_min(1e-6)
    bounded = torch.minimum(torch.maximum(radius, arms.radii[:, 0]), arms.radii[:, 1])
    flat = base[..., :2] + out * (bounded / radius)[..., None]
    height = wanted[..., 2:].clamp(LOWEST_M, HIGHEST_M)
    turn = wrapped(target[..., 3] + TURN_RAD * rows[..., 3] - here[..., 3])
    most = LEASH_STEPS * TURN_RAD
    yaw = here[..., 3:] + turn.clamp(-most, most)[..., None]
    return torch.cat([flat, height, yaw], -1)


def wrapped(angle: Tensor) -> Tensor:
    """Return angles in [-pi, pi] [rad]."""
    return torch.remainder(angle + math.pi, math.tau) - math.pi


def openings(rows: Tensor, asked: Tensor) -> Tensor:
    """Return the next commanded openings of grippers, (..., robots) [m].

    Args:
        rows: Actions, (..., robots, 5).
        asked: The last commanded openings, (..., robots) [m].
    """
    wanted = asked + GRIP_M * rows[..., 4].clamp(-1.0, 1.0)
    return wanted.clamp(0.0, FINGER_OPENING_M)


def features(
    goal_state: Tensor, target: Tensor, here: Tensor, base: Tensor, asked: Tensor
) -> Tensor:
    """Return the features of each hand, (..., robots, FEATURES).

    They are the goal state scaled to about 1; its vectors to the object and to the
    place once more, with a larger scale at short distances; and the differences between
    the commands and the state of the hand and its fingers, in steps.

    Args:
        goal_state: (..., robots, 13); see :mod:`lemma.env.signals.goal_state`.
        target: Targets of the hands; see the module.
        here: Poses of the hands, like targets.
        base: Poses of the bases; see the module.
        asked: The last commanded openings, (..., robots) [m].
    """
    near = [torch.tanh(goal_state[..., at : at + 3] / _NEAR_M) for at in _NEAR]
    away = here[..., :2] - base[..., :2]
    x, y = (away / torch.linalg.vector_norm(away, dim=-1, keepdim=True)).unbind(-1)
    lead = (target - here)[..., :3] / STEP_M
    opening = goal_state[..., NUMBERS.index("opening")]
    ahead = torch.stack(
        [
            x * lead[..., 0] + y * lead[..., 1],
            x * lead[..., 1] - y * lead[..., 0],
            lead[..., 2],
            wrapped(target[..., 3] - here[..., 3]) / TURN_RAD,
            (asked - opening) / GRIP_M,
        ],
        -1,
    )
    return torch.cat([goal_state / _units(goal_state.device), *near, ahead], -1)


@cache
def _units(device: torch.device) -> Tensor:
    """Return :data:`UNITS` on a device; a copy at each step would wait for it."""
    return torch.tensor(UNITS, device=device)


def able(goal_state: Tensor, arms: Arms) -> Tensor:
    """Return the number of the robot that reaches the goal's object, (...).

    Among several, it is the one with the smallest distance relative to its reach.

    Args:
        goal_state: (..., robots, 13); see :mod:`lemma.env.signals.goal_state`.
        arms: The robots' arms.
    """
    ahead = goal_state[..., 0] + goal_state[..., _NEAR[0]]
    far = torch.hypot(ahead, goal_state[..., _NEAR[0] + 1])
    return (far / arms.radii[:, 1]).argmin(-1)


def network(
    hidden: int = 128, out: int = len(COLUMNS), numbers: int = FEATURES
) -> torch.nn.Sequential:
    """Return a small network from the features of one hand to its action row.

    Args:
        hidden: Width of the hidden layers.
        out: Number of outputs.
        numbers: Number of inputs.
    """
    return torch.nn.Sequential(
        torch.nn.Linear(numbers, hidden), torch.nn.ELU(),
        torch.nn.Linear(hidden, hidden), torch.nn.ELU(),
        torch.nn.Linear(hidden, out),
    )  # fmt: skip


class Hand:
    """One hand of an episode on the CPU; the other robots do not move."""

    def __init__(self, seen: Mapping[str, Any], asked_m: float | None = None) -> None:
        """Choose the robot that reaches the goal's object.

        Args:
            seen: An observation ``"goal_state"`` of the control level.
            asked_m: Commanded opening of its fingers; the present opening if None [m].
        """
        parts = np.asarray(seen["agent_pos"], np.float32).reshape(-1, 7)
        heights = hands_of(seen["tcp_pose"])[:, 2]
        names = [arm_of(row[:6], z) for row, z in zip(parts, heights, strict=True)]
        goal = torch.tensor(seen["goal_state"]).reshape(len(names), -1)
        self.robot = int(able(goal, Arms.of(names)))
        """Number of the robot."""
        self._arms, self._one = Arms.of([names[self.robot]]), [self.robot]
        self._rows = parts.copy()
        if asked_m is not None:
            self._rows[self.robot, 6] = asked_m
        self._target = hands_of(seen["tcp_pose"])[self._one]

    def look(self, seen: Mapping[str, Any]) -> Tensor:
        """Store an observation; return the features of this hand, (1, FEATURES)."""
        self._here = hands_of(seen["tcp_pose"])[self._one]
        self._base = hands_of(seen["base_pose"])[self._one][:, [0, 1, 3]]
        goal = torch.tensor(seen["goal_state"]).reshape(len(self._rows), -1)
        goal = goal[self._one]
        self._slow = pace(goal)
        self._asked = torch.from_numpy(self._rows[self._one, 6])
        return features(goal, self._target, self._here, self._base, self._asked)

    def command(self, row: Tensor) -> NDArray[np.float32]:
        """Return joint positions [rad] and openings [m] of all robots, (robots, 7).

        Args:
            row: Action of the hand, (1, 5).
        """
        arms, base = self._arms, self._base
        target = advance(self._target, row, self._here, base, arms, self._slow)
        near = torch.from_numpy(self._rows[self._one, :6])
        self._rows = self._rows.copy()
        self._rows[self.robot, :6] = joints(target, base, arms, near)[0].numpy()
        self._rows[self.robot, 6] = float(openings(row, self._asked)[0])
        self._target = target
        return self._rows


class HandPolicy:
    """Executes a learned network on the CPU; one robot acts, the others do not move.

    It gets privileged state, the goal state, and does not read the instruction, so its
    results are not comparable with those of other policies.
    """

    control_options = {  # noqa: RUF012 - read, never changed
        "control": "joint_position",
        "control_hz": CONTROL_HZ,
        "clip_actions": True,
        "observation": "goal_state",
    }

    def __init__(self, weights: str) -> None:
        """Load a network.

        Args:
            weights: File of the state of a :func:`network`, by ``torch.save``.
        """
        state = torch.load(weights, weights_only=True, map_location="cpu")
        hidden, self._numbers = state["0.weight"].shape
        self.actor = network(hidden, numbers=self._numbers)
        self.actor.load_state_dict(state)

    @torch.no_grad()
    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return the next action for each episode."""
        return [self._act(control_input) for control_input in inputs]

    def _act(self, control_input: ControlInput) -> Actions:
        seen, memory = control_input.observation, control_input.memory
        # Copy the memory: an episode may continue from it more than once.
        hand = Hand(seen) if memory is None else copy(memory)
        # Older networks have fewer inputs, without the last features.
        row = self.actor(hand.look(seen)[:, : self._numbers])
        return Actions(hand.command(row), hand)


def hands_of(poses: Any) -> Tensor:
    """Return (x, y, z, yaw) of poses with quaternions, (robots, 4)."""
    found = []
    for row in np.asarray(poses, float).reshape(-1, 7):
        turn = matrix_from_quaternion(tuple(row[3:].tolist()))
        found.append([*row[:3], math.atan2(turn[1, 0], turn[0, 0])])
    return torch.tensor(found, dtype=torch.float32)


def arm_of(q: Any, height_m: Any) -> str:
    """Return the arm whose hand has a height [m] at joint angles (6,) [rad]."""

    def error(name: str) -> float:
        pose = forward(ARMS[name].dh, np.asarray(q, float))
        return abs(float(pose[2, 3] + TCP_OFFSET_M * pose[2, 2]) - float(height_m))

    return min(ARMS, key=error)
