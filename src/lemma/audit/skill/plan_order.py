"""The expert's own plan with its whole team, out of order or with a step left out.

These do not ask whether one robot is enough, but whether every sub-task is needed, and
where it stands.
"""

from collections.abc import Sequence

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.skill_trial import SkillTrial
from lemma.expert.grounding import GroundedOption
from lemma.expert.planner import find_plan
from lemma.scene.objects.entity import kind_of

_LONGEST = 8
"""No plan of the suite has more sub-tasks."""
_DRAWS = 50


def out_of_order(trial: SkillTrial) -> None:
    """Execute the plan backwards; in later attempts, in another wrong order."""
    steps = _planned(trial)
    order = list(range(len(steps)))[::-1]
    if trial.attempt > 0:
        wrong = (trial.rng.permutation(len(steps)).tolist() for _ in range(_DRAWS))
        order = next((o for o in wrong if _is_wrong(steps, o)), order)
    _execute(trial, [steps[i] for i in order])


def one_skipped(trial: SkillTrial) -> None:
    """Execute the plan without one of its steps."""
    steps = _planned(trial)
    if trial.attempt >= len(steps):
        raise GiveUp
    _execute(trial, [*steps[: trial.attempt], *steps[trial.attempt + 1 :]])


def _planned(trial: SkillTrial) -> Sequence[GroundedOption]:
    plan = find_plan(trial.state(), trial.goal, trial.grounder)
    if plan is None or not plan.steps:
        raise GiveUp
    return plan.steps


def _is_wrong(steps: Sequence[GroundedOption], order: Sequence[int]) -> bool:
    """Whether two steps change places that act on the same thing, the tool apart."""
    things = [
        {
            name
            for name in (step.subtask.pick, step.subtask.place)
            if name in step.after.poses and not kind_of(name).tool
        }
        for step in steps
    ]
    return any(
        things[first] & things[second]
        for i, second in enumerate(order)
        for first in order[i + 1 :]
        if first < second
    )


def _execute(trial: SkillTrial, steps: Sequence[GroundedOption]) -> None:
    """Execute steps where things are now, or else where they were expected."""
    for step in steps:
        now = trial.grounder.ground(step.subtask, trial.state())
        trial.do((now or step).grounded)


ATTACKS.add(
    "out_of_order",
    Attack(
        name="out_of_order",
        summary="The team's plan, backwards or in another wrong order.",
        level="skill",
        play=out_of_order,
        attempts=3,
        team=True,
    ),
)
ATTACKS.add(
    "one_skipped",
    Attack(
        name="one_skipped",
        summary="The team's plan without one of its sub-tasks.",
        level="skill",
        play=one_skipped,
        attempts=_LONGEST,
        team=True,
    ),
)
