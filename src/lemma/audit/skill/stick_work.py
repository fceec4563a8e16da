"""What attacks with the stick share: to fetch it, to choose a push, to carry it out."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lemma.audit.attack import GiveUp
from lemma.audit.pushes import (
    BAR_GRASPS,
    CONTACTS,
    END_GRASP,
    GRASPS,
    HANDLE_GRASPS,
    HOOK,
    Contact,
    Push,
    overlap_m,
    pushes,
)
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2, wrap
from lemma.motion.outcome import SkillResult
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M
from lemma.tasks.drags import stick_gap
from lemma.tasks.subtask import GroundedSubTask, Primitive

HOME_M = 0.045
"""So far inside its reach a robot wants what it is going to pick up."""
_SURE_M = 0.004
_OVERLAP_COST = 3.0
_LENGTH_COST = 0.1
_LEAST_GAIN_M = 0.01

Worth = Callable[[Pose2], float]
"""How good it is if a thing lies at a pose."""


@dataclass(frozen=True)
class Ways:
    """Which pushes an attack considers."""

    contacts: tuple[Contact, ...] = (HOOK,)
    grasps: tuple[Pose2, ...] = (END_GRASP,)
    headings: int = 36
    lengths_m: tuple[float, ...] = tuple(round(0.06 + 0.02 * i, 2) for i in range(25))


HOOKING = Ways()
"""As the expert does it, but of any length and direction."""
ANY_WAY = Ways(
    CONTACTS,
    (*HANDLE_GRASPS[:6:2], HANDLE_GRASPS[-1], BAR_GRASPS[1]),
    headings=24,
    lengths_m=tuple(round(0.08 + 0.06 * i, 2) for i in range(9)),
)
"""With every side of the stick, and other grasps."""


def touches_by_stick(trial: SkillTrial, pose: Pose2) -> bool:
    """Whether the stick could touch a thing while it is held, pointing down."""
    longest = math.hypot(HANDLE_LENGTH_M, HOOK_LENGTH_M) + CUBE_EDGE_M
    return trial.radius(pose) <= trial.reach.grasp_m + longest


def require_stick(trial: SkillTrial, grasps: Sequence[Pose2] = GRASPS) -> None:
    """Give up where there is no stick, or no part of it that can be grasped.

    A sub-task picks what lies below its pick pose, and that pose must be in reach.
    """
    if STICK not in trial.scene.spec.object_names or grasp_now(trial, grasps) is None:
        raise GiveUp


def grasp_now(trial: SkillTrial, grasps: Sequence[Pose2]) -> Pose2 | None:
    """Return the first grasp, in the stick's frame, that is in reach as it lies."""
    stick = trial.pose(STICK)
    for grasp in grasps:
        if trial.margin(stick @ grasp) > _SURE_M:
            return grasp
    return None


def fetch_stick(trial: SkillTrial) -> None:
    """Take the stick by what can be reached, and lay it down to be held at its end."""
    base, reach = trial.placement.base, trial.reach
    for _ in range(3):
        if grasp_now(trial, (END_GRASP,)) is not None:
            return
        grasp = grasp_now(trial, GRASPS)
        if grasp is None:
            return
        best, least = None, math.inf
        for i in range(-6, 7):
            bearing = base.yaw + math.radians(10.0 * i)
            for radius in (0.45, 0.6, 0.75, 0.9):
                for turn in (0.0, 0.6, -0.6, 1.2, -1.2):
                    r = radius * reach.travel_m
                    grip = Pose2(
                        base.x + r * math.cos(bearing),
                        base.y + r * math.sin(bearing),
                        wrap(bearing + turn),
                    )
                    stick = grip @ END_GRASP.inverse()
                    if trial.margin(stick @ grasp) < _SURE_M:
                        continue
                    cost = _blocked(trial, stick) + 0.01 * abs(turn)
                    if cost < least:
                        best, least = stick @ grasp, cost
        if best is None:
            return
        trial.move(trial.pose(STICK) @ grasp, best)


def _blocked(trial: SkillTrial, stick: Pose2) -> float:
    discs = trial.grounder.discs(trial.state(), but=STICK)
    return sum(
        max(0.0, radius + 0.035 - stick_gap(stick, x, y)) for x, y, radius in discs
    )


def best_pushes(
    trial: SkillTrial, thing: str, worth: Worth, ways: Ways
) -> list[tuple[float, Push]]:
    """Return pushes that the hand can follow and that are worth it, best first."""
    now = trial.pose(thing)
    discs = trial.grounder.discs(trial.state(), but=thing)
    turn = math.tau / ways.headings
    headings = [i * turn for i in range(ways.headings)]
    reach, least = trial.reach, worth(now) + _LEAST_GAIN_M
    found = []
    for way in pushes(ways.contacts, ways.grasps, now, headings, ways.lengths_m):
        if trial.margin(way.start) < _SURE_M:
            continue
        # The hand need not rise where the push ends.
        if not reach.inner_m + _SURE_M < trial.radius(way.end) < reach.grasp_m - 0.003:
            continue
        gain = worth(way.moved)
        if gain >= least:
            found.append((gain - _LENGTH_COST * way.length_m, way))
    found.sort(key=lambda pair: -pair[0])
    # Only the best are worth a look at what is in their way.
    looked = [(s - _OVERLAP_COST * overlap_m(w, discs), w) for s, w in found[:200]]
    return sorted(looked, key=lambda pair: -pair[0])


def carry_out(trial: SkillTrial, way: Push, hooks: bool) -> SkillResult:
    """Put the stick down beside a thing, and push."""
    before, after = (
        (Primitive.PREHOOK, Primitive.HOOK)
        if hooks
        else (Primitive.PREPOKE, Primitive.POKE)
    )
    options = (way.grasp, *GRASPS)
    stick = trial.pose(STICK)
    grasp = next(
        (
            g
            for g in options
            if min(trial.margin(stick @ g), trial.margin(way.stick @ g)) > 0.0
        ),
        way.grasp,
    )
    result = trial.do(
        GroundedSubTask(trial.robot, before, stick @ grasp, way.stick @ grasp)
    )
    if not result.ok:
        return result
    # Along the stick as it lies, which is not to the millimetre where it should.
    pick = trial.pose(STICK) @ way.grasp
    end = pick @ (way.start.inverse() @ way.end)
    return trial.do(GroundedSubTask(trial.robot, after, pick, end))


def home_worth(trial: SkillTrial) -> Worth:
    """Return how far inside its own reach a robot has something."""

    def worth(pose: Pose2) -> float:
        return min(trial.margin(pose), HOME_M + 0.03)

    return worth


def bring_home(trial: SkillTrial, ways: Ways, steps: int = 16) -> None:
    """Drag what the goal needs into one's own reach, then do the rest alone."""
    tries: dict[str, int] = {}
    for _ in range(steps):
        plan = trial.plan_alone()
        if plan is not None:
            if not plan.steps:
                return
            trial.do(plan.steps[0].grounded)
            continue
        far = far_cubes(trial)
        if not far or min(tries.get(name, 0) for name in far) > 3:
            return
        thing = min(far, key=lambda name: (tries.get(name, 0), far.index(name)))
        tries[thing] = tries.get(thing, 0) + 1
        if drag_closer(trial, thing, ways, tries[thing] - 1):
            tries[thing] -= 1


def far_cubes(trial: SkillTrial) -> list[str]:
    """Return what the goal needs and the robot has not home."""
    return [
        name
        for name in trial.goal.entities
        if kind_of(name).cargo and trial.margin(trial.pose(name)) < 0.03
    ]


def drag_closer(trial: SkillTrial, thing: str, ways: Ways, number: int = 0) -> bool:
    """Push a thing homewards; return whether it came closer.

    Args:
        trial: The attempt.
        thing: What shall come.
        ways: Pushes to choose from.
        number: Which of the best to take; another one after a failure.
    """
    options = best_pushes(trial, thing, home_worth(trial), ways)
    if not options:
        return False
    before = trial.margin(trial.pose(thing))
    way = options[min(3 * number, len(options) - 1)][1]
    carry_out(trial, way, hooks=True)
    return trial.margin(trial.pose(thing)) > before + _LEAST_GAIN_M


def fixed_bottoms(trial: SkillTrial) -> list[str]:
    """Return what the goal wants something on and nobody can move."""
    return [on.bottom for on in trial.goal.conjuncts if kind_of(on.bottom).fixed]
