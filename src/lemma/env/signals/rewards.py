"""Rewards: sparse ones, and dense ones by potential-based shaping.

Every reward begins with the sparse one: 1 when the episode ends in success, else 0. A
dense reward adds F = gamma phi(s') - phi(s), where phi is a potential of the state
alone (Ng, Harada and Russell, "Policy invariance under reward transformations", 1999).
Over T steps the discounted sum of F is gamma^T phi(s_T) - phi(s_0), independent
of the states in between, so going in circles earns nothing.

An episode that is terminated ends in a potential of 1 if it succeeded and of 0 if not.
Its discounted return is then a multiple of the sparse one, less phi(s_0): the same
policies are best. A truncated episode keeps the potential of its last state, for
learners that bootstrap from the value of that state.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from lemma.core.registry import Registry
from lemma.core.seeding import ordered_sum
from lemma.env.episode import Episode
from lemma.env.signals.goal_state import grasp_of, place_of
from lemma.env.simulation import Simulation
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import HOVER_M, LIFTED_M, Lifted, Predicate, Reached

Potential = Callable[[Episode], float]
"""Progress of an episode in [0, 1], as a function of the state of its scene."""

_ROOM_M = 2.0
_FINE_M = 0.1
_LEVEL_M = 0.01
AROUND_M = 0.03
"""The fingers are around an object if they are this near to its grasp position [m]."""
ASIDE_M, SLOPE, HIGH_M = 0.015, 2.0, 0.06
"""Hands approach from above: the height rises from the first horizontal distance on,
with this slope, up to the last [m, 1, m]."""
_GRIP, _HOLD, _LIFT, _PLACE = 0.25, 0.1, 0.15, 0.4


def goal_potential(episode: Episode) -> float:
    """Return the mean progress of the goal's conjuncts.

    A conjunct that holds counts 1. Else ``Reached(bottom)`` is 0.9 x the nearness of
    the nearest hand to 5 cm above it. ``Lifted(top)`` is the sum of

    - 0.5 x the grasp readiness of a hand, see :func:`grip`,
    - 0.15 if a gripper holds it,
    - 0.3 x its height while it is held, up to 5 cm,

    and ``On(top, bottom)`` is the sum of 0.25, 0.1 and 0.15 times the same terms, where
    less height is required within 5 cm of the place, seen from above, and of 0.4 x the
    nearness of the top to its place on the bottom. The first three count in full once
    it is in its place. For nearness see :func:`nearness`.
    """
    simulation = episode.simulation
    held = set(simulation.held().values())
    parts = [
        1.0 if on.holds(simulation.scene) else _advance(simulation, on, held)
        for on in episode.instance.goal.conjuncts
    ]
    return ordered_sum(parts) / len(parts)


def _advance(simulation: Simulation, on: Predicate, held: set[str]) -> float:
    """Return the progress of a conjunct that does not hold, in [0, 0.95]."""
    scene = simulation.scene
    if isinstance(on, Reached):
        x, y, z = scene.position(on.bottom)
        over = (x, y, z + kind_of(on.bottom).top_m + 0.5 * HOVER_M)
        hands = [arm.tcp_pose()[:3, 3].tolist() for arm in simulation.arms.values()]
        return 0.9 * nearness(min(math.dist(over, tcp) for tcp in hands))
    upper = kind_of(on.top)
    top, holds = scene.position(on.top), on.top in held
    about = 1.0 if holds else _best_grip(simulation, on.top)
    height = min(max(top[2] - upper.origin_m, 0.0), LIFTED_M) / LIFTED_M
    if isinstance(on, Lifted):
        return 0.5 * about + (0.15 + 0.3 * height if holds else 0.0)
    place = place_of(on, scene)
    hand, beside = _GRIP * about, math.dist(top[:2], place[:2])
    if _is_placed(top, place, kind_of(on.bottom).support_m or 0.0):
        hand = _GRIP + _HOLD + _LIFT
    elif holds:
        hand += _HOLD + _LIFT * max(height, 1.0 - beside / LIFTED_M)
    return hand + _PLACE * nearness(math.dist(top, place))


def _is_placed(
    top: Sequence[float], place: tuple[float, ...], support_m: float
) -> bool:
    beside = math.dist(top[:2], place[:2])
    return beside <= support_m and abs(top[2] - place[2]) <= _LEVEL_M


def _best_grip(simulation: Simulation, name: str) -> float:
    """Return the largest grasp readiness of a hand for an object."""
    scene = simulation.scene
    at, turn_rad = grasp_of(name, scene)
    found = 0.0
    for arm in simulation.arms.values():
        tcp = arm.tcp_pose()
        x, y, z = np.subtract(tcp[:3, 3], at[:3]).tolist()
        turn = at[3] - math.atan2(tcp[1, 0], tcp[0, 0])
        turn = 2.0 * math.remainder(turn, turn_rad) / turn_rad if turn_rad else 0.0
        opening = scene.opening_m(arm.robot) / FINGER_OPENING_M
        found = max(found, grip(math.hypot(x, y), z, turn, opening))
    return found


def grip(beside_m: float, above_m: float, turn: float, opening: float) -> float:
    """Return the readiness of a hand to grasp an object, in [0, 1].

    The hand should approach from above, so that its fingers do not push the object. On
    this path, readiness grows with nearness, alignment with the object and open
    fingers; around the object, it grows with closed fingers.

    Args:
        beside_m: Horizontal distance of the tool centre point from the grasp position
            [m].
        above_m: Height of the tool centre point above the grasp position [m].
        turn: Yaw error as a fraction of the largest one, in [-1, 1].
        opening: Opening of the fingers as a fraction of the largest one.
    """
    way = min(max(SLOPE * (beside_m - ASIDE_M), 0.0), HIGH_M)
    far_m = math.hypot(beside_m, max(above_m, way)) + max(way - above_m, 0.0)
    around = max(0.0, 1.0 - far_m / AROUND_M)
    closed = min(1.0, 2.0 - 2.0 * opening)
    fingers = (1.0 - around) * opening + around * (1.0 + 2.0 * closed)
    return 0.7 * nearness(far_m) * (1.0 - 0.15 * abs(turn)) + 0.1 * fingers


def nearness(distance_m: float) -> float:
    """Return (1 - d / 2 m) / 2 + (1 - tanh(d / 0.1 m)) / 2 of a distance d.

    It is 1 at distance 0, falls linearly up to 2 m, and steeply near 0.
    """
    coarse = 1.0 - min(1.0, distance_m / _ROOM_M)
    return 0.5 * coarse + 0.5 * (1.0 - math.tanh(distance_m / _FINE_M))


REWARDS: Registry[Potential | None] = Registry("reward", Potential | None)
"""The rewards by name: the potential for shaping, or None for the sparse reward."""
REWARDS.add("sparse", None)
REWARDS.add("dense", goal_potential)
REWARDS.add("stages", lambda episode: episode.progress)


class RewardMeter:
    """Computes the rewards of consecutive steps of an episode."""

    def __init__(self, reward: str, discount: float) -> None:
        """Prepare.

        Args:
            reward: A name in :data:`REWARDS`.
            discount: The learner's discount gamma, for shaping.

        Raises:
            UnknownNameError: No such reward.
        """
        self._potential = REWARDS[reward]
        self._discount = discount
        self.potential: float | None = None
        """Potential of the present state; None without shaping."""

    def begin(self, episode: Episode) -> None:
        """Start from the present state of an episode."""
        if self._potential is not None:
            self.potential = self._potential(episode)

    def reward(self, episode: Episode) -> float:
        """Return the reward of the last step."""
        succeeded = episode.is_over and episode.is_success
        if self._potential is None or self.potential is None:
            return float(succeeded)
        before = self.potential
        if episode.stopped or episode.has_failed:
            self.potential = float(succeeded)
        else:
            self.potential = self._potential(episode)
        return float(succeeded) + self._discount * self.potential - before
