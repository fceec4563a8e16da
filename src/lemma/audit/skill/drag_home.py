"""Drag what is out of reach into one's own, as often and as far as it takes."""

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.pushes import END_GRASP, GRASPS
from lemma.audit.skill.stick_work import (
    ANY_WAY,
    HOOKING,
    bring_home,
    far_cubes,
    fetch_stick,
    fixed_bottoms,
    grasp_now,
    require_stick,
    touches_by_stick,
)
from lemma.audit.skill_trial import SkillTrial


def _require_near(trial: SkillTrial) -> None:
    """Give up where a pad stays out of reach, or the stick touches no cube."""
    if any(trial.margin(trial.pose(pad)) <= 0.0 for pad in fixed_bottoms(trial)):
        # No plan for this robot alone will ever end there.
        raise GiveUp
    if not all(touches_by_stick(trial, trial.pose(cube)) for cube in far_cubes(trial)):
        raise GiveUp


def drag_home(trial: SkillTrial) -> None:
    """Play an attempt."""
    require_stick(trial, (END_GRASP,))
    _require_near(trial)
    bring_home(trial, HOOKING)


def drag_any_part(trial: SkillTrial) -> None:
    """Play an attempt."""
    require_stick(trial, GRASPS)
    _require_near(trial)
    bring_home(trial, ANY_WAY)


def take_the_stick(trial: SkillTrial) -> None:
    """Play an attempt."""
    require_stick(trial, GRASPS)
    if grasp_now(trial, (END_GRASP,)) is not None:
        # It need not be taken by another part: drag_home does that.
        raise GiveUp
    _require_near(trial)
    fetch_stick(trial)
    bring_home(trial, HOOKING)


ATTACKS.add(
    "drag_home",
    Attack(
        name="drag_home",
        summary="Drags of any length and number with the stick, held at its end.",
        level="skill",
        play=drag_home,
        cheap=True,
    ),
)
ATTACKS.add(
    "drag_any_part",
    Attack(
        name="drag_any_part",
        summary="Drags and pushes with every side of the stick, held anywhere.",
        level="skill",
        play=drag_any_part,
    ),
)
ATTACKS.add(
    "take_the_stick",
    Attack(
        name="take_the_stick",
        summary="Who cannot grasp the stick's end takes it by another part, and drags.",
        level="skill",
        play=take_the_stick,
        cheap=True,
    ),
)
