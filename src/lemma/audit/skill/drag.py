"""Attacks that drag what is out of reach into reach, and do the rest alone."""

from collections.abc import Sequence

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.pushes import END_GRASP, GRASPS
from lemma.audit.skill.stick import (
    ANY_WAY,
    HOOKING,
    Ways,
    drag_closer,
    fetch_stick,
    fixed_bottoms,
    grasp_now,
    require_stick,
    touches_by_stick,
)
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.scene.objects.entity import kind_of

_FAR_M = 0.03
_STEPS = 16
_FAILURES = 3


def drag_home(trial: SkillTrial) -> None:
    """Drags of any length and number with the stick, held at its end."""
    _require_near(trial, (END_GRASP,))
    _bring_home(trial, HOOKING)


def drag_any_part(trial: SkillTrial) -> None:
    """Drags and pushes with every side of the stick, held anywhere."""
    _require_near(trial, GRASPS)
    _bring_home(trial, ANY_WAY)


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
    # With such a pad no plan for this robot alone will ever end.
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
        # The one with fewest failures.
        thing = min(far, key=lambda name: failures.get(name, 0))
        number = failures.get(thing, 0)
        if number > _FAILURES:
            return
        if not drag_closer(trial, thing, ways, number):
            failures[thing] = number + 1


ATTACKS.add("drag_home", Attack(drag_home, "skill", cheap=True))
ATTACKS.add("drag_any_part", Attack(drag_any_part, "skill"))
ATTACKS.add("take_the_stick", Attack(take_the_stick, "skill", cheap=True))
