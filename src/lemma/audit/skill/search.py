"""Search over sub-tasks, without a thought of what they are good for."""

import math
from collections.abc import Iterator

from lemma.audit.attack import ATTACKS, Attack, Lost
from lemma.audit.pushes import CONTACTS, GRASPS, push
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.scene.objects.entity import STICK, kind_of
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

_STEPS = 12
_DRAWS = 30
_ROLLOUTS = 15
_WIDTH = 3


def random_skills(trial: SkillTrial) -> None:
    """Do what the expert could do next, or something with random poses."""
    for _ in range(_STEPS):
        known = list(expert_proposals(trial))
        if known and trial.rng.random() < 0.5:
            trial.do(known[int(trial.rng.integers(len(known)))])
            continue
        drawn = next(random_proposals(trial), None)
        if drawn is not None:
            trial.do(drawn)


def greedy_skills(trial: SkillTrial) -> None:
    """Try some sub-tasks, take back all but the one that helps most, and go on."""
    left = _ROLLOUTS
    while left > 0:
        choices = list(expert_proposals(trial))
        order = trial.rng.permutation(len(choices)).tolist()
        tries = [choices[i] for i in order[: _WIDTH - 1]]
        tries += list(random_proposals(trial))[: _WIDTH - len(tries)]
        if not tries:
            return
        start, best, least = trial.snapshot(), None, distance_left(trial)
        for subtask in tries:
            trial.restore(start)
            left -= 1
            try:
                trial.do(subtask)
            except Lost:
                continue
            if distance_left(trial) < least - 0.005:
                best, least = trial.snapshot(), distance_left(trial)
        if best is None:
            trial.restore(start)
            return
        trial.restore(best)


def distance_left(trial: SkillTrial) -> float:
    """Return how far the goal's tops are from their bottoms [m], summed up."""
    return sum(
        trial.pose(on.top).distance(trial.pose(on.bottom))
        for on in trial.goal.conjuncts
        if not on.holds(trial.scene)
    )


def expert_proposals(trial: SkillTrial) -> Iterator[GroundedSubTask]:
    """Yield every sub-task that the expert's grounder finds poses for."""
    now = trial.state()
    for primitive in Primitive:
        for pick in now.poses:
            for place in (*now.poses, *now.spec.regions):
                subtask = SubTask(trial.robot, primitive, pick, place)
                option = trial.grounder.ground(subtask, now)
                if option is not None:
                    yield option.grounded


def random_proposals(trial: SkillTrial) -> Iterator[GroundedSubTask]:
    """Yield sub-tasks with poses that are drawn, as long as the draws are in reach."""
    rng, there = trial.rng, trial.state().poses
    cargo = [name for name in there if kind_of(name).cargo]
    within = [name for name in cargo if trial.margin(there[name]) > 0.0]
    for _ in range(_DRAWS):
        if STICK in there and rng.random() < 0.7:
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
            x, y, yaw = (rng.uniform(-1.0, 1.0, 3) * (1.5, 1.5, math.pi)).tolist()
            place = Pose2(x, y, yaw)
            if trial.margin(place) > 0.0:
                yield GroundedSubTask(trial.robot, Primitive.MOVE, pose @ near, place)


ATTACKS.add(
    "random_skills",
    Attack(
        name="random_skills",
        summary="Sub-tasks that the expert's grounder proposes, and random ones.",
        level="skill",
        play=random_skills,
        attempts=3,
    ),
)
ATTACKS.add(
    "greedy_skills",
    Attack(
        name="greedy_skills",
        summary="Tries sub-tasks out, and keeps what brings the goal nearer.",
        level="skill",
        play=greedy_skills,
    ),
)
