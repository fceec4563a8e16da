"""The stick as a tray: a cube lies on it while it is carried farther than the hand."""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.pushes import END_GRASP
from lemma.audit.skill.stick_work import (
    HOOKING,
    drag_closer,
    require_stick,
)
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_SECTION_M,
)
from lemma.tasks.goal import On
from lemma.tasks.subtask import GroundedSubTask, Primitive

_ON_BAR = (HANDLE_LENGTH_M - STICK_SECTION_M / 2, 0.35 * HOOK_LENGTH_M)
_BEYOND = (HANDLE_LENGTH_M + 0.005, 0.3 * HOOK_LENGTH_M)
_WAYS = (
    (_ON_BAR, Primitive.POKE),
    (_ON_BAR, Primitive.PREPOKE),
    (_BEYOND, Primitive.POKE),
)
"""Where on the stick the cube lies, in its frame, and how it is carried: slowly along
the table, or through the air; by attempt."""
_PULL_M = 0.25


def carry_on_stick(trial: SkillTrial) -> None:
    """Play an attempt."""
    require_stick(trial, (END_GRASP,))
    longest = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M) + 0.1
    for on in trial.goal.conjuncts:
        if trial.radius(trial.pose(on.bottom)) > trial.reach.travel_m + longest:
            raise GiveUp
    for on in trial.goal.conjuncts:
        _carry(trial, on)


def _carry(trial: SkillTrial, on: On) -> None:
    for number in range(3):
        if trial.margin(trial.pose(on.top)) > 0.02:
            break
        drag_closer(trial, on.top, HOOKING, number)
    pick = trial.grounder.grasp(trial.robot, on.top, trial.state())
    spot, carrying = _WAYS[trial.attempt]
    if pick is None or not _bring_stick_near(trial, spot):
        return
    on_stick = trial.pose(STICK) @ Pose2(*spot)
    if not trial.move(pick, on_stick).ok:
        return
    # What lies on it must come along.
    hand = _hand_for(trial, trial.pose(on.bottom), trial.pose(on.top))
    if hand is None:
        return
    grasp = trial.pose(STICK) @ END_GRASP
    trial.do(GroundedSubTask(trial.robot, carrying, grasp, hand))
    # Pulled away below it.
    grasp = trial.pose(STICK) @ END_GRASP
    back = grasp @ Pose2(-_PULL_M, 0.0)
    trial.do(GroundedSubTask(trial.robot, Primitive.HOOK, grasp, back))


def _bring_stick_near(trial: SkillTrial, spot: tuple[float, float]) -> bool:
    """Lay the stick so that a cube can be put on it, and its end be grasped."""
    if trial.margin(trial.pose(STICK) @ Pose2(*spot)) > 0.005:
        return True
    base, reach = trial.placement.base, trial.reach
    for degrees in (60, 75, 45, 90, -60, -75):
        # Across the robot's front, both ends in reach.
        turn = base.yaw + math.radians(degrees)
        for side in (-0.55, 0.55, -0.7, 0.7):
            grip = Pose2(
                base.x + 0.75 * reach.travel_m * math.cos(base.yaw + side),
                base.y + 0.75 * reach.travel_m * math.sin(base.yaw + side),
                turn if side < 0.0 else -turn,
            )
            stick = grip @ END_GRASP.inverse()
            if min(trial.margin(grip), trial.margin(stick @ Pose2(*spot))) > 0.01:
                return trial.do(
                    GroundedSubTask(
                        trial.robot,
                        Primitive.PREPOKE,
                        trial.pose(STICK) @ END_GRASP,
                        grip,
                    )
                ).ok
    return False


def _hand_for(trial: SkillTrial, target: Pose2, cube: Pose2) -> Pose2 | None:
    """Return the hand's pose that has what lies on the stick over a target."""
    stick = trial.pose(STICK)
    local = stick.inverse() @ cube
    base = trial.placement.base
    out = math.atan2(target.y - base.y, target.x - base.x)
    best, most = None, 0.0
    for i in range(-12, 13):
        yaw = out + math.radians(8.0 * i)
        there = Pose2(target.x, target.y, yaw) @ Pose2(-local.x, -local.y)
        hand = there @ END_GRASP
        if trial.margin(hand) > most:
            best, most = hand, trial.margin(hand)
    return best


ATTACKS.add(
    "carry_on_stick",
    Attack(
        name="carry_on_stick",
        summary="Lays a cube on the stick, and carries it farther than the hand.",
        level="skill",
        play=carry_on_stick,
        attempts=len(_WAYS),
    ),
)
