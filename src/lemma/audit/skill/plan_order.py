"""The expert's plan with its whole team, out of order or with one step left out.

These attacks do not ask whether one robot is enough, but whether every sub-task and the
order of the sub-tasks are needed.
"""

from collections.abc import Sequence

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.skill_trial import SkillTrial
from lemma.planning.grounding import GroundedOption
from lemma.planning.planner import find_plan
from lemma.scene.objects.entity import kind_of

# No plan of the suite has more sub-tasks.
_LONGEST = 8
_DRAWS = 50


def out_of_order(trial: SkillTrial) -> None:
    """The team's plan, backwards or in another wrong order."""
    steps = _planned(trial)
    order = list(range(len(steps)))[::-1]
    if trial.attempt > 0:
        wrong = (trial.rng.permutation(len(steps)).tolist() for _ in range(_DRAWS))
        order = next((o for o in wrong if _is_wrong(steps, o)), order)
    _execute(trial, [steps[i] for i in order])


def one_skipped(trial: SkillTrial) -> None:
    """The team's plan without one of its sub-tasks."""
    steps = _planned(trial)
    trial.require(trial.attempt < len(steps))
    _execute(trial, [*steps[: trial.attempt], *steps[trial.attempt + 1 :]])


def _planned(trial: SkillTrial) -> Sequence[GroundedOption]:
    plan = find_plan(trial.state(), trial.goal, trial.grounder)
    steps = plan.steps if plan is not None else ()
    trial.require(steps)
    return steps


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
    """Execute steps grounded in the present state, or else as they were planned."""
    for step in steps:
        now = trial.grounder.ground(step.subtask, trial.state())
        trial.execute((now or step).grounded)


ATTACKS.add("out_of_order", Attack(out_of_order, "skill", attempts=3, team=True))
ATTACKS.add("one_skipped", Attack(one_skipped, "skill", attempts=_LONGEST, team=True))
