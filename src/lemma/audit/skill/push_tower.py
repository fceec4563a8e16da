"""Build a tower on a cube that the goal does not need, and push it against the pad."""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.skill.push_onto_pad import direct_pushes, place_in_line
from lemma.audit.skill.stick_work import (
    HOOKING,
    carry_out,
    drag_closer,
    fixed_bottoms,
    require_stick,
    touches_by_stick,
)
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_PUSHES = 3
_OVERHANGS_M = (0.0, 0.015, 0.018)
"""How far the upper cube stands out towards the pad, by attempt: where the lower one is
stopped, it tips over."""


def push_tower(trial: SkillTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    pads = fixed_bottoms(trial)
    if not pads or not all(touches_by_stick(trial, trial.pose(pad)) for pad in pads):
        raise GiveUp
    spare = [
        name
        for name in trial.state().poses
        if kind_of(name).cargo
        and name not in trial.goal.entities
        and trial.margin(trial.pose(name)) > 0.0
    ]
    if not spare:
        raise GiveUp
    for on in trial.goal.conjuncts:
        _push_tower(trial, on, spare[0])


def _push_tower(trial: SkillTrial, on: On, lower: str) -> None:
    for number in range(3):
        if trial.margin(trial.pose(on.top)) > 0.0:
            break
        drag_closer(trial, on.top, HOOKING, number)
    pad = trial.pose(on.bottom)
    place = place_in_line(trial, lower, pad)
    if place is None or not _move(trial, lower, place):
        return
    below = trial.pose(lower)
    ahead = math.atan2(pad.y - below.y, pad.x - below.x)
    out_m = _OVERHANGS_M[trial.attempt]
    x = below.x + out_m * math.cos(ahead)
    y = below.y + out_m * math.sin(ahead)
    if not _move(trial, on.top, Pose2(x, y, below.yaw)):
        return
    for number in range(_PUSHES):
        ways = direct_pushes(trial, lower, trial.pose(lower), pad)
        if not ways:
            return
        carry_out(trial, ways[min(number, len(ways) - 1)], hooks=False)


def _move(trial: SkillTrial, name: str, place: Pose2) -> bool:
    pick = trial.grounder.grasp(trial.robot, name, trial.state())
    return pick is not None and trial.move(pick, place).ok


ATTACKS.add(
    "push_tower",
    Attack(
        name="push_tower",
        summary="Pushes a tower against the pad with the stick; its top may go on.",
        level="skill",
        play=push_tower,
        attempts=len(_OVERHANGS_M),
    ),
)
