"""Attacks on the plan: sub-tasks by search, out of order, or with one left out."""

import math
from collections.abc import Iterator, Sequence
from itertools import islice, product

from lemma.audit.attack import attack
from lemma.audit.pushes import CONTACTS, GRASPS, push
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.planning.grounding import GroundedOption
from lemma.planning.planner import find_plan
from lemma.scene.objects.entity import STICK, kind_of
from lemma.tasks.subtask import PAPER_PRIMITIVES, GroundedSubTask, Primitive, SubTask

_STEPS = 12
_DRAWS = 30
_ROLLOUTS = 15
_WIDTH = 3


@attack("skill", attempts=3)
def random_skills(trial: SkillTrial) -> None:
    """Executes sub-tasks from the expert's grounder and random ones."""
    for _ in range(_STEPS):
        _random_step(trial)


@attack("skill", attempts=3)
def lifted_skills(trial: SkillTrial) -> None:
    """Lifts an object before each random sub-task, and begins with it in hand."""
    for _ in range(_STEPS):
        grasps = [trial.pose(name) for name in trial.cargo()]
        if STICK in trial.state().poses:
            grasps += [trial.pose(STICK) @ grasp for grasp in GRASPS]
        grasps = [at for at in grasps if trial.margin(at) > 0.0]
        if grasps:
            at = grasps[int(trial.rng.integers(len(grasps)))]
            trial.do(Primitive.LIFT, at, at)
        _random_step(trial)


def _random_step(trial: SkillTrial) -> None:
    """Execute a sub-task that the expert's grounder proposes, or a random one."""
    proposed = list(_expert_proposals(trial))
    if proposed and trial.rng.random() < 0.5:
        trial.execute(proposed[int(trial.rng.integers(len(proposed)))])
        return
    drawn = next(_random_proposals(trial), None)
    if drawn is not None:
        trial.execute(drawn)


@attack("skill", candidates=_ROLLOUTS, simulated_s=300.0)
def greedy_skills(trial: SkillTrial) -> None:
    """Tries sub-tasks out, and keeps the one that brings the goal nearest."""
    left = _ROLLOUTS
    while left > 0:
        choices = list(_expert_proposals(trial))
        order = trial.rng.permutation(len(choices)).tolist()
        tries = [choices[i] for i in order[: _WIDTH - 1]]
        tries += islice(_random_proposals(trial), _WIDTH - len(tries))
        # An empty round counts as well; otherwise the loop would not end.
        left -= max(1, len(tries))
        start = trial.snapshot()
        best, least = start, _distance_left(trial)

        def attempt(subtask: GroundedSubTask) -> None:
            nonlocal best, least
            trial.execute(subtask)
            if _distance_left(trial) < least - 0.005:
                best, least = trial.snapshot(), _distance_left(trial)

        # If no draw brings the goal nearer, the next round draws others.
        trial.try_each(tries, attempt)
        trial.restore(best)


def _distance_left(trial: SkillTrial) -> float:
    """Return the sum of the distances of the goal's tops from their bottoms [m]."""
    left_m = 0.0
    for on in trial.goal.placements:
        if not on.holds(trial.scene):
            left_m += trial.pose(on.top).distance(trial.pose(on.bottom))
    return left_m


def _expert_proposals(trial: SkillTrial) -> Iterator[GroundedSubTask]:
    """Yield every sub-task for which the expert's grounder finds poses."""
    now = trial.state()
    # Reaching and lifting move no object to another place; see `lifted_skills`.
    for primitive, pick in product(PAPER_PRIMITIVES, now.poses):
        for place in (*now.poses, *now.spec.regions):
            subtask = SubTask(trial.robot, primitive, pick, place)
            option = trial.grounder.ground(subtask, now)
            if option is not None:
                yield option.grounded


def _random_proposals(trial: SkillTrial) -> Iterator[GroundedSubTask]:
    """Yield sub-tasks with random poses in reach."""
    rng, cargo = trial.rng, trial.cargo()
    within = [name for name in cargo if trial.margin(trial.pose(name)) > 0.0]
    has_stick = STICK in trial.state().poses
    for _ in range(_DRAWS):
        if has_stick and rng.random() < 0.7:
            grasp = GRASPS[int(rng.integers(len(GRASPS)))]
            pick = trial.pose(STICK) @ grasp
            contact = CONTACTS[int(rng.integers(len(CONTACTS)))]
            thing = trial.pose(cargo[int(rng.integers(len(cargo)))])
            heading, length_m = rng.uniform(-math.pi, math.pi), rng.uniform(0.05, 0.5)
            way = push(contact, grasp, thing, heading, length_m)
            if min(trial.margin(pick), trial.margin(way.start)) > 0.0:
                yield GroundedSubTask(trial.robot, Primitive.PREHOOK, pick, way.start)
            elif trial.margin(pick) > 0.0:
                end = pick @ (way.start.inverse() @ way.end)
                yield GroundedSubTask(trial.robot, Primitive.HOOK, pick, end)
        elif within:
            name = within[int(rng.integers(len(within)))]
            pose = trial.grounder.grasp(trial.robot, name, trial.state())
            assert pose is not None
            near = Pose2(*rng.uniform(-0.02, 0.02, 2).tolist())
            place = Pose2(*(rng.uniform(-1.0, 1.0, 3) * (1.5, 1.5, math.pi)).tolist())
            if trial.margin(place) > 0.0:
                yield GroundedSubTask(trial.robot, Primitive.MOVE, pose @ near, place)


# No plan of the suite has more sub-tasks.
_LONGEST = 8
_ORDERS = 50


@attack("skill", attempts=3, team=True)
def out_of_order(trial: SkillTrial) -> None:
    """Executes the team's plan backwards or in another wrong order."""
    steps = _planned(trial)
    # A plan of one sub-task has no other order.
    trial.require(len(steps) > 1)
    order = list(range(len(steps)))[::-1]
    if trial.attempt > 0:
        wrong = (trial.rng.permutation(len(steps)).tolist() for _ in range(_ORDERS))
        order = next((o for o in wrong if _is_wrong(steps, o)), order)
    _execute(trial, [steps[i] for i in order])


@attack("skill", attempts=_LONGEST, team=True)
def one_skipped(trial: SkillTrial) -> None:
    """Executes the team's plan without one of its sub-tasks."""
    steps = _planned(trial)
    trial.require(trial.attempt < len(steps))
    _execute(trial, [*steps[: trial.attempt], *steps[trial.attempt + 1 :]])


def _planned(trial: SkillTrial) -> Sequence[GroundedOption]:
    plan = find_plan(trial.state(), trial.goal, trial.grounder)
    steps = plan.steps if plan is not None else ()
    trial.require(steps)
    return steps


def _is_wrong(steps: Sequence[GroundedOption], order: Sequence[int]) -> bool:
    """Whether an order swaps two steps that act on the same object, tools excepted."""
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
    """Execute steps, grounded in the present state if possible, else as planned."""
    for step in steps:
        now = trial.grounder.ground(step.subtask, trial.state())
        trial.execute((now or step).grounded)
