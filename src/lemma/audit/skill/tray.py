"""The stick as a tray: an attack that lays a cube on it, and carries both."""

import math
from itertools import product

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.pushes import END_GRASP, LONGEST_M
from lemma.audit.skill.stick import bring_within, require_stick
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_SECTION_M,
)
from lemma.tasks.goal import On
from lemma.tasks.subtask import Primitive

_ON_BAR = Pose2(HANDLE_LENGTH_M - STICK_SECTION_M / 2, 0.35 * HOOK_LENGTH_M)
_BEYOND = Pose2(HANDLE_LENGTH_M + 0.005, 0.3 * HOOK_LENGTH_M)
# Where on the stick the cube lies, in its frame, and how it is carried: slowly along
# the table, or through the air; by attempt.
_WAYS = (
    (_ON_BAR, Primitive.POKE),
    (_ON_BAR, Primitive.PREPOKE),
    (_BEYOND, Primitive.POKE),
)
_TURNS_RAD = tuple(math.radians(d) for d in (60, 75, 45, 90, -60, -75))
_SIDES_RAD = (-0.55, 0.55, -0.7, 0.7)
_PULL_M = 0.25


def carry_on_stick(trial: SkillTrial) -> None:
    """Lays a cube on the stick, and carries it farther than the hand."""
    require_stick(trial, (END_GRASP,))
    limit_m = trial.reach.travel_m + LONGEST_M + 0.1
    for on in trial.goal.conjuncts:
        trial.require_near(on.bottom, limit_m)
    for on in trial.goal.conjuncts:
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
    # The stick is pulled away below the cube.
    grasp = trial.pose(STICK) @ END_GRASP
    trial.do(Primitive.HOOK, grasp, grasp @ Pose2(-_PULL_M, 0.0))


def _bring_stick_near(trial: SkillTrial, spot: Pose2) -> bool:
    """Lay the stick so that a cube can be put on it, and its end be grasped."""
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
    """Return the hand's pose that has the cube on the stick over its bottom."""
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


ATTACKS.add("carry_on_stick", Attack(carry_on_stick, "skill", attempts=len(_WAYS)))
