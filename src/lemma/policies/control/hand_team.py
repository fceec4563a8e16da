"""A team of hands that act in turns with one network that has learned to place.

The network of :class:`~lemma.policies.control.hand_steps.HandPolicy` moves one object
to a place within the same robot's reach. Rules combine such motions to hand-overs,
towers and relays. They choose the next robot and the place of a hand-over, open the
fingers, and park the arm. Like that policy, it gets privileged state, the goal state.
"""

import math
from collections.abc import Callable, Mapping
from copy import copy
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.policies.control.hand_steps import (
    HOLDS,
    OBJECT,
    PLACE,
    STEP_M,
    Arms,
    HandPolicy,
    advance,
    arm_of,
    features,
    hands_of,
    joints,
    openings,
    pace,
)
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.scene.objects.entity import kind_of

_OPEN, _RISE = ((0.0, 0.0, 0.0, 0.0, 1.0),), ((0.0, 0.0, 1.0, 0.0, 1.0),)
_OPEN_STEPS, _RISE_STEPS, _PARK_STEPS, _ACT_STEPS = 3, 20, 60, 250
"""Longest durations of the phases [control steps]."""
_RISEN_M = 0.25
"""Height of a hand from which it moves to the parking pose [m]."""
_PARK_RAD, _PARKED_RAD = 0.12, 0.1
"""Largest step of a joint while parking, and tolerance of the parking pose [rad]."""
_CARRY_M, _CARRY_BESIDE_M, _CARRY_SLOPE = 0.12, 0.04, 2.0
"""Smallest height of a carrying hand [m], which passes over objects; distance from the
place within which it may be lower [m], and slope of the height from there."""
_LEVEL_M, _ON_M, _AT_M, _HOVER_STEPS = 0.012, 0.01, 0.02, 3
"""Tolerances of height, of a place on an object, and of a spot on the table [m], and
the number of control steps within them after which the fingers open."""
_DROPPED_M = 0.03
"""Largest distance from the place at which a release by the network counts [m]."""
_PAD_M = kind_of("red_pad").top_m
"""Height of a pad [m], on which objects were placed in training."""
_SPOT_M, _LOWER_STEPS = 0.004, 6
"""Height of a release above the object's rest on a bare table [m], and the largest
number of control steps to lower it."""
_OTHER_M = 0.1
"""A larger change of the object's position in a step [m] means another conjunct."""
_CELL_M, _HALF_M = 0.02, 1.6
"""Side of a cell of the grid of spots, and half the side of its square [m]."""
_MARGIN_M, _NEAR_WEIGHT = 0.06, 0.02
"""Margin inside of both reaches above which spots score equally [m], and weight of the
distance to object and place."""

_Phase = Literal["choose", "act", "lower", "open", "rise", "park"]
Network = Callable[[Tensor], Tensor]


class HandTeam:
    """The hands of an episode: one acts, the others stay at their parking poses."""

    def __init__(self, seen: Mapping[str, Any]) -> None:
        """Begin the episode.

        Args:
            seen: An observation ``"goal_state"`` of the control level.
        """
        self._rows = np.asarray(seen["agent_pos"], np.float32).reshape(-1, 7).copy()
        self._target = hands_of(seen["tcp_pose"])
        heights = self._target[:, 2]
        both = zip(self._rows, heights, strict=True)
        self._arms = Arms.of([arm_of(row[:6], height) for row, height in both])
        self._phase: _Phase = "choose"
        self._steps = self._hovered = 0
        self.robot = 0
        """Number of the acting robot."""
        self.spot: Tensor | None = None
        """World x, y of a hand-over to another robot, (2,) [m]; None without one."""
        self._rest_m = 0.0
        self._held = False
        self._object: Tensor | None = None

    def step(self, seen: Mapping[str, Any], network: Network) -> NDArray[np.float32]:
        """Return joint positions and openings of all robots, (robots, 7).

        Args:
            seen: The observation.
            network: From features (1, FEATURES) of the acting hand to its row (1, 5).
        """
        self._look(seen)
        self._steps += 1
        if self._phase == "choose":
            self._choose()
        k = self.robot
        goal = self._goal[[k]].clone()
        if self._phase == "act":
            self._as_learned(goal)
            self._judge(goal)
        if self._phase == "lower" and self._steps > _LOWER_STEPS:
            self._enter("open")
        if self._phase == "open" and self._steps > _OPEN_STEPS:
            self._enter("rise")
        risen = self._here[k, 2] > _RISEN_M or self._steps > _RISE_STEPS
        if self._phase == "rise" and risen:
            self._enter("park")
        if self._phase == "park":
            return self._go_home()
        slow = torch.ones(1, 1)
        row = torch.tensor(_OPEN if self._phase == "open" else _RISE)
        if self._phase == "lower":
            way_m = self._rest_m + _SPOT_M - float(self._height_m(goal))
            row = torch.tensor([[0.0, 0.0, way_m / STEP_M, 0.0, 0.0]])
        if self._phase == "act":
            slow = pace(goal)
            asked = torch.from_numpy(self._rows[[k], 6])
            parts = (self._target[[k]], self._here[[k]], self._base[[k]], asked)
            row = network(features(goal, *parts))
        return self._moved(row, slow, goal)

    def _look(self, seen: Mapping[str, Any]) -> None:
        """Store an observation; open the fingers if the goal's object has changed."""
        self._here = hands_of(seen["tcp_pose"])
        self._base = hands_of(seen["base_pose"])[:, [0, 1, 3]]
        self._goal = torch.tensor(seen["goal_state"]).reshape(len(self._rows), -1)
        joints_now = np.asarray(seen["agent_pos"], np.float32).reshape(-1, 7)
        self._joints = torch.from_numpy(joints_now.copy())
        away = self._here[:, :2] - self._base[:, :2]
        self._ahead = away / torch.linalg.vector_norm(away, dim=1, keepdim=True)
        first = self._goal[0]
        at = self._here[0, :2] + self._world(first[OBJECT : OBJECT + 2])
        self._place = at + self._world(first[PLACE : PLACE + 2])
        before, self._object = self._object, at
        if before is None or self._phase != "act":
            return
        if torch.linalg.vector_norm(at - before) > _OTHER_M:
            self._enter("open")

    def _world(self, way: Tensor) -> Tensor:
        """Return a vector in the first hand's frame in the world frame, (2,)."""
        x, y = self._ahead[0]
        return torch.stack([x * way[0] - y * way[1], y * way[0] + x * way[1]])

    def _enter(self, phase: _Phase) -> None:
        self._phase, self._steps, self._hovered = phase, 0, 0

    def _choose(self) -> None:
        """Choose the next robot, and a spot if another one must continue."""
        assert self._object is not None
        has, puts = self.margins(self._object), self.margins(self._place)
        direct = torch.minimum(has, puts)
        self.spot = None
        first, last = int(has.argmax()), int(puts.argmax())
        if direct.max() > 0.0 or first == last:
            self.robot = int(direct.argmax())
        else:
            self.robot = first
            self.spot = self._spot_towards(last)
        k = self.robot
        self._target = self._here.clone()
        self._rows = self._rows.copy()
        self._rows[k, 6] = self._joints[k, 6]
        self._rest_m = self._height_m(self._goal[[k]])
        self._held = False
        self._enter("act")

    def margins(self, points: Tensor) -> Tensor:
        """Return margins of points inside each robot's reach, (robots, ...) [m]."""
        extra = (1,) * (points.dim() - 1)
        base = self._base[:, :2].view(-1, *extra, 2)
        far = torch.linalg.vector_norm(points - base, dim=-1)
        inner, outer = (r.view(-1, *extra) for r in self._arms.radii.unbind(1))
        return torch.minimum(far - inner, outer - far)

    def _spot_towards(self, last: int) -> Tensor:
        """Return the spot where the acting robot places the object, (2,) [m].

        The next robot in the shortest chain to the last one reaches the spot, too.
        """
        assert self._object is not None
        line = torch.arange(-_HALF_M, _HALF_M, _CELL_M)
        grid = torch.cartesian_prod(line, line)
        margins = self.margins(grid)
        fetched = torch.linalg.vector_norm(grid - self._object, dim=1)
        left = torch.linalg.vector_norm(grid - self._place, dim=1)
        count = len(margins)
        shared = torch.minimum(margins[:, None], margins[None])
        widths = shared.amax(2)
        chains: list[tuple[int, ...]] = [(self.robot,)]
        while chains and chains[0][-1] != last:
            chain = chains.pop(0)
            rest = [k for k in range(count) if k not in chain]
            chains += [(*chain, k) for k in rest if widths[chain[-1], k] > 0.0]
        chain = chains[0] if chains else (self.robot, last)
        here, after = next(pairwise(chain))
        score = shared[here, after].clamp(max=_MARGIN_M) - _NEAR_WEIGHT * (
            fetched + left
        )
        return grid[int(score.argmax())]

    def _height_m(self, goal: Tensor) -> float:
        """Return the present height of the object's grasp [m]."""
        return float(self._here[self.robot, 2] + goal[0, OBJECT + 2])

    def _as_learned(self, goal: Tensor) -> None:
        """Set the place of the acting robot's goal state, (1, 13), as in training.

        For an empty hand the place is a pad, and a spot counts as the top of a pad.
        """
        holds = goal[0, HOLDS] > 0.5
        if self.spot is not None:
            assert self._object is not None
            way, (x, y) = self.spot - self._object, self._ahead[self.robot]
            goal[0, PLACE] = x * way[0] + y * way[1]
            goal[0, PLACE + 1] = x * way[1] - y * way[0]
            goal[0, PLACE + 2] = self._rest_m + _PAD_M - self._height_m(goal)
        if not holds and not self._held:
            goal[0, PLACE + 2] = _PAD_M

    def _judge(self, goal: Tensor) -> None:
        """Open the fingers if the object is at its place, or after a time limit."""
        holds = bool(goal[0, HOLDS] > 0.5)
        beside = math.hypot(*goal[0, PLACE : PLACE + 2].tolist())
        above = -float(goal[0, PLACE + 2])
        # A spot has no pad, so the hand may be lower there.
        level = above < _LEVEL_M and (self.spot is not None or above > -_LEVEL_M)
        near = beside < (_ON_M if self.spot is None else _AT_M) and level
        self._hovered = self._hovered + 1 if holds and near else 0
        dropped = self._held and not holds and beside < _DROPPED_M and level
        self._held |= holds
        if self._hovered > _HOVER_STEPS and self.spot is not None:
            self._enter("lower")
        elif dropped or self._hovered > _HOVER_STEPS or self._steps > _ACT_STEPS:
            self._enter("open")

    def _go_home(self) -> NDArray[np.float32]:
        """Return rows with a step of the acting robot towards its parking pose."""
        k, self._rows = self.robot, self._rows.copy()
        park, now = self._arms.park[k], torch.from_numpy(self._rows[k, :6])
        step = (park - now).clamp(-_PARK_RAD, _PARK_RAD)
        self._rows[k, :6] = (now + step).numpy()
        left = float((self._joints[k, :6] - park).abs().max())
        if left < _PARKED_RAD or self._steps > _PARK_STEPS:
            self._phase = "choose"
        return self._rows

    def _moved(self, row: Tensor, slow: Tensor, goal: Tensor) -> NDArray[np.float32]:
        """Return rows with one step of the acting robot."""
        k = [self.robot]
        one = Arms(*(part[k] for part in self._arms.parts))
        base = self._base[k]
        target = advance(self._target[k], row, self._here[k], base, one, slow)
        if self._phase == "act" and goal[0, HOLDS] > 0.5:
            beside = math.hypot(*goal[0, PLACE : PLACE + 2].tolist())
            least = _CARRY_SLOPE * (beside - _CARRY_BESIDE_M)
            target[0, 2] = target[0, 2].clamp(min=min(max(least, 0.0), _CARRY_M))
        self._rows = self._rows.copy()
        near = torch.from_numpy(self._rows[k, :6])
        self._rows[k, :6] = joints(target, base, one, near).numpy()
        self._rows[k, 6] = openings(row, torch.from_numpy(self._rows[k, 6])).numpy()
        self._target = self._target.clone()
        self._target[k] = target
        return self._rows


class HandTeamPolicy(HandPolicy):
    """Executes a network that has learned to place, for all robots in turns.

    ``weights`` are those of :class:`~lemma.policies.control.hand_steps.HandPolicy`. It
    supports tasks whose goal is cubes on other objects, without the stick, for teams of
    any size. It does not read the instruction.
    """

    def _act(self, control_input: ControlInput) -> Actions:
        seen, memory = control_input.observation, control_input.memory
        # Copy the memory: an episode may continue from it more than once.
        team = HandTeam(seen) if memory is None else copy(memory)
        numbers = self._numbers
        return Actions(team.step(seen, lambda x: self.actor(x[:, :numbers])), team)
