"""Rewards: sparse ones, and dense ones by potential-based shaping.

Every reward begins with the sparse one: 1 when the episode ends in success, else 0. A
dense reward adds F = gamma phi(s') - phi(s), where phi is a potential of the state
alone (Ng, Harada and Russell, "Policy invariance under reward transformations", 1999).
Over T steps the discounted sum of F is gamma^T phi(s_T) - phi(s_0), independent
of the states in between, so going in circles earns nothing.

An episode that is terminated ends in a potential of 1 if it succeeded and of 0 if not.
Its discounted return is then a multiple of the sparse one, less phi(s_0): the same
policies are best. Where it is truncated its potential is that of the state it was left
in, for learners that go on from the value of that state.
"""

import math
from collections.abc import Callable

from lemma.core.registry import Registry
from lemma.core.seeding import ordered_sum
from lemma.env.episode import Episode
from lemma.env.signals.goal_state import place_of
from lemma.scene.objects.entity import kind_of
from lemma.scene.scene import Scene
from lemma.tasks.goal import HOVER_M, LIFTED_M, Lifted, Predicate, Reached

Potential = Callable[[Episode], float]
"""How far an episode has come, in [0, 1]: a function of the state of its scene."""

_ROOM_M = 2.0
_FINE_M = 0.1
_LIFT_M = 0.1
_LEVEL_M = 0.01
_REACH, _GRASP, _LIFT, _PLACE = 0.2, 0.15, 0.15, 0.4


def goal_potential(episode: Episode) -> float:
    """Return the mean over the goal's conjuncts of how far each has come.

    A conjunct that holds has 1. Else ``On(top, bottom)`` is the sum of

    - 0.2 x how near the nearest hand is to the top,
    - 0.15 if a gripper holds the top,
    - 0.15 x its height above the table while it is held, up to 10 cm,
    - 0.4 x how near it is to its place on the bottom,

    and the first three count in full once it is in its place. ``Lifted(top)`` is 0.4 x
    how near the nearest hand is, 0.2 if a gripper holds it, and 0.3 x its height while
    it is held, up to that which the goal asks for. ``Reached(bottom)`` is 0.9 x how
    near the nearest hand is to 5 cm above it. How near something is
    falls with its distance, see :func:`nearness`.
    """
    simulation = episode.simulation
    hands = [arm.tcp_pose()[:3, 3].tolist() for arm in simulation.arms.values()]
    held = set(simulation.held().values())
    parts = [
        1.0
        if on.holds(simulation.scene)
        else _advance(simulation.scene, on, hands, held)
        for on in episode.instance.goal.conjuncts
    ]
    return ordered_sum(parts) / len(parts)


def _advance(
    scene: Scene, on: Predicate, hands: list[list[float]], held: set[str]
) -> float:
    """Return how far a conjunct has come that does not hold, in [0, 0.9]."""
    if isinstance(on, Reached):
        x, y, z = scene.position(on.bottom)
        over = (x, y, z + kind_of(on.bottom).top_m + 0.5 * HOVER_M)
        return 0.9 * nearness(min(math.dist(over, tcp) for tcp in hands))
    if isinstance(on, Lifted):
        at = scene.position(on.top)
        share = 0.4 * nearness(min(math.dist(at, tcp) for tcp in hands))
        if on.top in held:
            height_m = min(max(at[2] - kind_of(on.top).origin_m, 0.0), LIFTED_M)
            share += 0.2 + 0.3 * height_m / LIFTED_M
        return share
    top, place = scene.pose(on.top).position, place_of(on, scene)
    upper = kind_of(on.top)
    if _is_placed(top, place, kind_of(on.bottom).support_m or 0.0):
        hand = _REACH + _GRASP + _LIFT
    else:
        hand = _REACH * nearness(min(math.dist(top, tcp) for tcp in hands))
        if on.top in held:
            lifted_m = min(max(top[2] - upper.origin_m, 0.0), _LIFT_M)
            hand += _GRASP + _LIFT * lifted_m / _LIFT_M
    return hand + _PLACE * nearness(math.dist(top, place))


def _is_placed(
    top: tuple[float, ...], place: tuple[float, ...], support_m: float
) -> bool:
    beside = math.dist(top[:2], place[:2])
    return beside <= support_m and abs(top[2] - place[2]) <= _LEVEL_M


def nearness(distance_m: float) -> float:
    """Return (1 - d / 2 m) / 2 + (1 - tanh(d / 0.1 m)) / 2 of a distance d.

    1 where there is none; it falls evenly up to 2 m, and steeply nearby.
    """
    coarse = 1.0 - min(1.0, distance_m / _ROOM_M)
    return 0.5 * coarse + 0.5 * (1.0 - math.tanh(distance_m / _FINE_M))


REWARDS: Registry[Potential | None] = Registry("reward", Potential | None)
"""The rewards by name: the potential that each adds to the sparse one, or None."""
REWARDS.add("sparse", None)
REWARDS.add("dense", goal_potential)
REWARDS.add("stages", lambda episode: episode.progress)


class RewardMeter:
    """Rewards the steps of an episode, one after the other."""

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
        """Return the reward of the step that has just been done."""
        succeeded = episode.is_over and episode.is_success
        if self._potential is None or self.potential is None:
            return float(succeeded)
        before = self.potential
        if episode.stopped or episode.is_thrown:
            self.potential = float(succeeded)
        else:
            self.potential = self._potential(episode)
        return float(succeeded) + self._discount * self.potential - before
