"""Attacks with the stick at skill level: fetching it, dragging, carrying on it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

from lemma.audit.attack import attack
from lemma.audit.pushes import (
    BAR_GRASPS,
    CONTACTS,
    END_GRASP,
    GRASPS,
    HANDLE_GRASPS,
    HOOK,
    LONGEST_M,
    Contact,
    Push,
    overlap_m,
    push,
)
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2, wrap
from lemma.core.seeding import ordered_sum
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_SECTION_M,
)
from lemma.tasks.drags import stick_gap
from lemma.tasks.goal import On
from lemma.tasks.subtask import Primitive

SURE_M = 0.004
# A larger margin inside the reach has no further value.
_HOME_M = 0.075
_FAR_M = 0.03
_OVERLAP_COST = 3.0
_LENGTH_COST = 0.1
_LEAST_GAIN_M = 0.01
# Number of pushes, best first, that are checked against obstacles.
_LOOKS = 200


@dataclass(frozen=True)
class Ways:
    """The set of pushes that an attack considers; headings in [rad]."""

    contacts: tuple[Contact, ...] = (HOOK,)
    grasps: tuple[Pose2, ...] = (END_GRASP,)
    headings: tuple[float, ...] = tuple(i * (math.tau / 36) for i in range(36))
    lengths_m: tuple[float, ...] = tuple(round(0.06 + 0.02 * i, 2) for i in range(25))

    def pushes(self, thing: Pose2) -> Iterator[Push]:
        """Yield all combinations for an object at a pose."""
        parts = (self.contacts, self.grasps, self.headings, self.lengths_m)
        for contact, grasp, heading, length_m in product(*parts):
            yield push(contact, grasp, thing, heading, length_m)


HOOKING = Ways()
"""The expert's hooking, but of any length and direction."""
ANY_WAY = Ways(
    CONTACTS,
    (*HANDLE_GRASPS[:6:2], HANDLE_GRASPS[-1], BAR_GRASPS[1]),
    headings=tuple(i * (math.tau / 24) for i in range(24)),
    lengths_m=tuple(round(0.08 + 0.06 * i, 2) for i in range(9)),
)
"""Pushes with every side of the stick and with other grasps."""
STRAIGHT = Ways(CONTACTS[1:], (*HANDLE_GRASPS[:3], BAR_GRASPS[1]))
"""Sides (without the hook) and grasps for pushes of one heading and length."""


def require_stick(trial: SkillTrial, grasps: Sequence[Pose2] = GRASPS) -> None:
    """Give up where there is no stick, or none of the grasps is in reach."""
    trial.require(STICK in trial.scene.spec.object_names and grasp_now(trial, grasps))


def touches_by_stick(trial: SkillTrial, name: str) -> bool:
    """Whether the stick, held by a hand that points down, could touch an object."""
    limit_m = trial.reach.grasp_m + LONGEST_M + CUBE_EDGE_M
    return trial.radius(trial.pose(name)) <= limit_m


def grasp_now(trial: SkillTrial, grasps: Sequence[Pose2]) -> Pose2 | None:
    """Return the first grasp, in the stick's frame, that is in reach now, else None."""
    stick = trial.pose(STICK)
    return next((g for g in grasps if trial.margin(stick @ g) > SURE_M), None)


def fetch_stick(trial: SkillTrial) -> None:
    """Grasp any part of the stick, and lay it down with its end in reach."""
    yaw, travel_m = trial.placement.base.yaw, trial.reach.travel_m
    for _ in range(3):
        grasp = grasp_now(trial, GRASPS)
        if grasp is None or grasp_now(trial, (END_GRASP,)) is not None:
            return
        discs = trial.grounder.discs(trial.state(), but=STICK)
        best, least = None, math.inf
        for i, share, turn in product(
            range(-6, 7), (0.45, 0.6, 0.75, 0.9), (0.0, 0.6, -0.6, 1.2, -1.2)
        ):
            bearing = yaw + math.radians(10.0 * i)
            at = trial.at(share * travel_m, bearing)
            grip = Pose2(at.x, at.y, wrap(bearing + turn))
            stick = grip @ END_GRASP.inverse()
            if trial.margin(stick @ grasp) < SURE_M:
                continue
            gaps = (r + 0.035 - stick_gap(stick, x, y) for x, y, r in discs)
            cost = ordered_sum(max(0.0, gap_m) for gap_m in gaps) + 0.01 * abs(turn)
            if cost < least:
                best, least = stick @ grasp, cost
        if best is None:
            return
        trial.move(trial.pose(STICK) @ grasp, best)


def best_pushes(trial: SkillTrial, thing: str, ways: Ways) -> list[Push]:
    """Return feasible pushes that bring an object into reach, best first.

    A push is better if it brings the object farther inside the robot's reach.
    """

    def worth(pose: Pose2) -> float:
        return min(trial.margin(pose), _HOME_M)

    now, reach, found = trial.pose(thing), trial.reach, []
    discs = trial.grounder.discs(trial.state(), but=thing)
    least = worth(now) + _LEAST_GAIN_M
    for way in ways.pushes(now):
        if trial.margin(way.start) < SURE_M:
            continue
        # The hand need not rise where the push ends.
        if not reach.inner_m + SURE_M < trial.radius(way.end) < reach.grasp_m - 0.003:
            continue
        gain = worth(way.moved)
        if gain >= least:
            found.append((gain - _LENGTH_COST * way.length_m, way))
    found.sort(key=lambda pair: -pair[0])
    looked = [(w - _OVERLAP_COST * overlap_m(p, discs), p) for w, p in found[:_LOOKS]]
    return [way for _, way in sorted(looked, key=lambda pair: -pair[0])]


def carry_out(
    trial: SkillTrial, way: Push, primitive: Primitive = Primitive.POKE
) -> None:
    """Put the stick down beside an object, and push it: ``HOOK`` or ``POKE``."""
    hooks = primitive is Primitive.HOOK
    stick, before = trial.pose(STICK), Primitive.PREHOOK if hooks else Primitive.PREPOKE

    def free_m(grasp: Pose2) -> float:
        return min(trial.margin(stick @ grasp), trial.margin(way.stick @ grasp))

    options = (way.grasp, *GRASPS)
    grasp = next((g for g in options if free_m(g) > 0.0), way.grasp)
    if trial.do(before, stick @ grasp, way.stick @ grasp).ok:
        # The stick's real pose differs from the planned one by some millimetres.
        pick = trial.pose(STICK) @ way.grasp
        trial.do(primitive, pick, pick @ (way.start.inverse() @ way.end))


def drag_closer(trial: SkillTrial, thing: str, ways: Ways, number: int = 0) -> bool:
    """Push an object towards the robot; return whether it came closer.

    Args:
        trial: The attempt.
        thing: Name of the object to bring closer.
        ways: Pushes to choose from.
        number: Number of failures so far, which selects the next push.
    """
    options = best_pushes(trial, thing, ways)
    if not options:
        return False
    before = trial.margin(trial.pose(thing))
    way = options[min(3 * number, len(options) - 1)]
    carry_out(trial, way, Primitive.HOOK)
    return trial.margin(trial.pose(thing)) > before + _LEAST_GAIN_M


def bring_within(trial: SkillTrial, thing: str, inside_m: float) -> None:
    """Hook an object at most three times, until it is in reach by a margin [m]."""
    for number in range(3):
        if trial.margin(trial.pose(thing)) > inside_m:
            break
        drag_closer(trial, thing, HOOKING, number)


def fixed_bottoms(trial: SkillTrial) -> list[str]:
    """Return the bottoms of the goal that are fixed."""
    return [on.bottom for on in trial.goal.placements if kind_of(on.bottom).fixed]


_STEPS = 16
_FAILURES = 3


@attack("skill", cheap=True)
def drag_home(trial: SkillTrial) -> None:
    """Drags of any length and number with the stick, held at its end."""
    _require_near(trial, (END_GRASP,))
    _bring_home(trial, HOOKING)


@attack("skill")
def drag_any_part(trial: SkillTrial) -> None:
    """Drags and pushes with every side of the stick, held anywhere."""
    _require_near(trial, GRASPS)
    _bring_home(trial, ANY_WAY)


@attack("skill", cheap=True)
def take_the_stick(trial: SkillTrial) -> None:
    """Takes the stick by another part if its end is out of reach, and drags."""
    _require_near(trial, GRASPS)
    trial.require(grasp_now(trial, (END_GRASP,)) is None)
    fetch_stick(trial)
    _bring_home(trial, HOOKING)


def _require_near(trial: SkillTrial, grasps: Sequence[Pose2]) -> None:
    """Give up where a pad stays out of reach, or the stick touches no cube."""
    require_stick(trial, grasps)
    pads, cubes = fixed_bottoms(trial), _far_cubes(trial)
    # With a pad out of reach, this robot alone never has a plan.
    trial.require(all(trial.margin(trial.pose(pad)) > 0.0 for pad in pads))
    trial.require(all(touches_by_stick(trial, cube) for cube in cubes))


def _far_cubes(trial: SkillTrial) -> list[str]:
    """Return the cubes of the goal that are out of reach, or at its edge."""
    cubes = [name for name in trial.goal.entities if kind_of(name).cargo]
    return [name for name in cubes if trial.margin(trial.pose(name)) < _FAR_M]


def _bring_home(trial: SkillTrial, ways: Ways) -> None:
    """Drag all objects of the goal into reach, then do the rest alone."""
    failures: dict[str, int] = {}
    for _ in range(_STEPS):
        plan = trial.plan_alone()
        if plan is not None:
            if not plan.steps:
                return
            trial.execute(plan.steps[0].grounded)
            continue
        far = _far_cubes(trial)
        if not far:
            return
        thing = min(far, key=lambda name: failures.get(name, 0))
        number = failures.get(thing, 0)
        if number > _FAILURES:
            return
        if not drag_closer(trial, thing, ways, number):
            failures[thing] = number + 1


_ON_BAR = Pose2(HANDLE_LENGTH_M - STICK_SECTION_M / 2, 0.35 * HOOK_LENGTH_M)
_BEYOND = Pose2(HANDLE_LENGTH_M + 0.005, 0.3 * HOOK_LENGTH_M)
# Position of the cube on the stick, in the stick's frame, and how it is carried: slowly
# along the table, or through the air; by attempt.
_WAYS = (
    (_ON_BAR, Primitive.POKE),
    (_ON_BAR, Primitive.PREPOKE),
    (_BEYOND, Primitive.POKE),
)
_TURNS_RAD = tuple(math.radians(d) for d in (60, 75, 45, 90, -60, -75))
_SIDES_RAD = (-0.55, 0.55, -0.7, 0.7)
_PULL_M = 0.25


@attack("skill", attempts=len(_WAYS))
def carry_on_stick(trial: SkillTrial) -> None:
    """Lays a cube on the stick, and carries it farther than the hand."""
    require_stick(trial, (END_GRASP,))
    limit_m = trial.reach.travel_m + LONGEST_M + 0.1
    for on in trial.goal.placements:
        trial.require_near(on.bottom, limit_m)
    for on in trial.goal.placements:
        _carry(trial, on)


def _carry(trial: SkillTrial, on: On) -> None:
    bring_within(trial, on.top, 0.02)
    pick = trial.grounder.grasp(trial.robot, on.top, trial.state())
    spot, carrying = _WAYS[trial.attempt]
    if pick is None or not _bring_stick_near(trial, spot):
        return
    if not trial.move(pick, trial.pose(STICK) @ spot).ok:
        return
    hand = _hand_over(trial, on)
    if hand is None:
        return
    trial.do(carrying, trial.pose(STICK) @ END_GRASP, hand)
    # Pull the stick away from below the cube.
    grasp = trial.pose(STICK) @ END_GRASP
    trial.do(Primitive.HOOK, grasp, grasp @ Pose2(-_PULL_M, 0.0))


def _bring_stick_near(trial: SkillTrial, spot: Pose2) -> bool:
    """Lay the stick so that both a spot on it and its end are in reach."""
    stick, yaw = trial.pose(STICK), trial.placement.base.yaw
    if trial.margin(stick @ spot) > 0.005:
        return True
    for degrees, side in product(_TURNS_RAD, _SIDES_RAD):
        # Across the robot's front, both ends in reach.
        turn = yaw + degrees
        at = trial.at(0.75 * trial.reach.travel_m, yaw + side)
        grip = Pose2(at.x, at.y, turn if side < 0.0 else -turn)
        there = grip @ END_GRASP.inverse() @ spot
        if min(trial.margin(grip), trial.margin(there)) > 0.01:
            return trial.do(Primitive.PREPOKE, stick @ END_GRASP, grip).ok
    return False


def _hand_over(trial: SkillTrial, on: On) -> Pose2 | None:
    """Return the hand's pose at which the cube on the stick is over its bottom."""
    local = trial.pose(STICK).inverse() @ trial.pose(on.top)
    target = trial.pose(on.bottom)
    outward = trial.outward(target)
    best, most = None, 0.0
    for i in range(-12, 13):
        yaw = outward + math.radians(8.0 * i)
        there = Pose2(target.x, target.y, yaw) @ Pose2(-local.x, -local.y)
        hand = there @ END_GRASP
        if trial.margin(hand) > most:
            best, most = hand, trial.margin(hand)
    return best
