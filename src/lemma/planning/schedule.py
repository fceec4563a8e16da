"""Schedules: which robot does each sub-task of a plan, and when.

A sub-task takes its predicted time tau. After :data:`PICKED` of it the hand has risen
with what it picked, after :data:`PLACED` it has let go and goes home. A sub-task
begins when what it touches has been put down, and reaches its place when what it puts
things on is there. A robot does one thing at a time. Two stages of different robots,
picking or placing, exclude each other where the lines from base to hand come nearer
than :data:`APART_M`: the sectors that the arms reserve would overlap.

The least makespan is the paper's allocation with times: binary v says who does what,
each sub-task once, sum tau v <= T_max, and among the schedules of least makespan that
of the highest utility sum u v.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lemma.core.poses import Pose2
from lemma.motion.reservations import MARGIN_M
from lemma.planning.geometry import GroundedOption
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import Plan, utility
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.teams.rule import Rule

PICKED = 0.41
"""Share of its time after which a sub-task has picked; mean of 38 executed ones."""
PLACED = 0.79
"""Share of its time after which a sub-task has had its effect; of the same."""
APART_M = 2 * MARGIN_M
"""Least distance between the lines from base to hand of two arms at work [m]."""
HORIZON_S = 100.0
"""T_max: largest summed duration (paper, section IV) [s]."""
CS = 100
"""Times are whole hundredths of a second while they are compared."""
_STAGES = (0, 1)
"""Picking and placing; each ends when the next one begins."""

Line = tuple[Pose2, Pose2]
Stay = tuple[int, int, Line]
"""A stage of a schedule: from when to when [1/100 s], and where."""


@dataclass(frozen=True)
class Job:
    """One sub-task of a plan, whoever does it."""

    subtask: SubTask
    """With the robot that the plan names."""
    options: Mapping[str, GroundedOption]
    """By robot: those who can, where the plan does it."""
    utilities: Mapping[str, float]
    """u of each."""
    needs: Mapping[int, str]
    """Earlier sub-tasks that it depends on, ``"pick"`` to begin, ``"place"`` to put
    down."""
    lines: Mapping[str, tuple[Line, Line]]
    """By robot: from its base to its hand, as it picks and as it places."""

    def times(self, robot: str) -> tuple[int, ...]:
        """Return begin, picked, effect and end, from its beginning [1/100 s]."""
        tau = self.options[robot].duration_s
        return (0, *(round(CS * part * tau) for part in (PICKED, PLACED, 1.0)))


@dataclass(frozen=True)
class Schedule:
    """The robot and the beginning of each sub-task of a plan."""

    jobs: tuple[Job, ...]
    robots: tuple[str, ...]
    """The robot of each."""
    starts: tuple[int, ...]
    """When each begins [1/100 s]."""
    is_optimal: bool = False
    """Whether no schedule of these sub-tasks is shorter."""

    def at(self, job: int, stage: int) -> int:
        """Return when a sub-task has begun, picked, had its effect, ended [1/100 s]."""
        return self.starts[job] + self.jobs[job].times(self.robots[job])[stage]

    @property
    def status(self) -> str:
        """Whether it is known to be of least makespan, as the solver says it."""
        return "optimal" if self.is_optimal else "feasible"

    def order(self, stage: int = 2) -> tuple[int, ...]:
        """Return the sub-tasks in the order in which they get to a stage.

        Args:
            stage: See :meth:`at`. By default the effect, which each has after all that
                it needs.
        """
        return tuple(sorted(range(len(self.jobs)), key=lambda k: self.at(k, stage)))

    @property
    def steps(self) -> tuple[SubTask, ...]:
        """The plan in the order of effects, with the robots of the schedule."""
        return tuple(
            replace(self.jobs[k].subtask, robot=self.robots[k]) for k in self.order()
        )

    @property
    def makespan_s(self) -> float:
        """When the last sub-task ends [s]."""
        return max((self.at(k, 3) for k in range(len(self.jobs))), default=0) / CS

    @property
    def sequential_s(self) -> float:
        """How long the same sub-tasks take one after the other [s]."""
        total = 0
        for job, robot in zip(self.jobs, self.robots, strict=True):
            total += job.times(robot)[3]
        return total / CS

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, in the way of flexible job shops.

        ``jobs`` holds for each sub-task who could do it in which time, what must come
        before, and which stages (0 to pick, 1 to place) of earlier ones exclude its
        own; ``schedule`` who does it, and when it begins, has picked, has put down and
        ends [s].
        """
        jobs, schedule = [], []
        for m, job in enumerate(self.jobs):
            sub = job.subtask
            jobs.append(
                {
                    "primitive": str(sub.primitive),
                    "pick": sub.pick,
                    "place": sub.place,
                    "duration_s": {
                        robot: job.times(robot)[3] / CS for robot in job.options
                    },
                    "needs": {str(i): why for i, why in job.needs.items()},
                    "excludes": [
                        [i, k, other]
                        for k in range(m)
                        for i in _STAGES
                        for other in _STAGES
                        if self.robots[k] != self.robots[m]
                        and are_near(self.stays(m)[i][2], self.stays(k)[other][2])
                    ],
                }
            )
            times = [self.at(m, stage) / CS for stage in range(4)]
            schedule.append({"robot": self.robots[m], "times_s": times})
        return {
            "jobs": jobs,
            "shares": [0.0, PICKED, PLACED, 1.0],
            "status": self.status,
            "makespan_s": self.makespan_s,
            "sequential_s": self.sequential_s,
            "critical_path": list(self.critical_path()),
            "schedule": schedule,
        }

    def critical_path(self) -> tuple[int, ...]:
        """Return sub-tasks, first to last, none of which could end later.

        Each but the first begins, or reaches its place, as soon as the one before it
        lets it: the same robot, what it depends on, or a region.
        """
        if not self.jobs:
            return ()
        path = [max(range(len(self.jobs)), key=lambda k: self.at(k, 3))]
        while self.starts[path[0]] > 0:
            before = next(
                (
                    k
                    for k in self.order()
                    if k not in path and self._holds_up(k, path[0])
                ),
                None,
            )
            if before is None:
                break
            path.insert(0, before)
        return tuple(path)

    def _holds_up(self, k: int, m: int) -> bool:
        """Whether m could begin sooner if k were done sooner."""
        job, robot = self.jobs[m], self.robots[m]
        same = self.robots[k] == robot
        follows = same and self.at(k, 3) == self.starts[m]
        stage = {"pick": 0, "place": 1}.get(job.needs.get(k, ""))
        needed = stage is not None and self.at(k, 2) == self.at(m, stage)
        return (
            follows
            or needed
            or (
                not same
                and any(
                    came == left and are_near(line, other)
                    for came, _, line in self.stays(m)
                    for _, left, other in self.stays(k)
                )
            )
        )

    def stays(self, job: int) -> list[Stay]:
        """Return where a sub-task keeps others away, from when to when."""
        lines = self.jobs[job].lines[self.robots[job]]
        return [(self.at(job, i), self.at(job, i + 1), lines[i]) for i in _STAGES]

    def faults(self) -> list[str]:
        """Return what is wrong with it, nothing if it can be carried out."""
        found, count = [], len(self.jobs)
        for m in range(count):
            for k, why in self.jobs[m].needs.items():
                if self.at(m, 0 if why == "pick" else 1) < self.at(k, 2):
                    found.append(f"{m} does not wait for {k}")
            for k in range(m):
                same = self.robots[k] == self.robots[m]
                if same and _meet(*(self.at(i, e) for i in (k, m) for e in (0, 3))):
                    found.append(f"{self.robots[m]} does {k} and {m} at once")
                clash = any(
                    _meet(*stay, *other) and are_near(line, line_of_other)
                    for *stay, line in self.stays(k)
                    for *other, line_of_other in self.stays(m)
                )
                if clash and not same:
                    found.append(f"{k} and {m} are in each other's way")
        return found


def _meet(a: int, b: int, c: int, d: int) -> bool:
    """Whether the times from a to b and from c to d have a moment in common."""
    return a < d and c < b


def are_near(one: Line, another: Line) -> bool:
    """Whether two arms at work keep each other away."""
    for line, other in ((one, another), (another, one)):
        if any(_distance_m(end, other) < APART_M for end in line):
            return True
    sides = [
        [_side(line, end) > 0.0 for end in other]
        for line, other in ((one, another), (another, one))
    ]
    return all(a != b for a, b in sides)


def _side(line: Line, point: Pose2) -> float:
    (a, b), (x, y) = (line[0].xy, line[1].xy), point.xy
    return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])


def _distance_m(point: Pose2, line: Line) -> float:
    (ax, ay), (bx, by), (x, y) = (pose.xy for pose in (*line, point))
    length = max((bx - ax) ** 2 + (by - ay) ** 2, 1e-9)
    t = min(1.0, max(0.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length))
    return math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay))


def predecessors(
    steps: Sequence[SubTask], regions: Sequence[str], rule: Rule | None = None
) -> tuple[dict[int, str], ...]:
    """Return for each sub-task of a plan the earlier ones that it depends on.

    Args:
        steps: The plan.
        regions: Places that are no objects, and have room for several.
        rule: That of the goal.

    Returns:
        For each, earlier ones that touch or put down what it picks or drags
        (``"pick"``), or only what it puts something on (``"place"``); this too where
        a rule wants their effect before its own.
    """
    found = []
    for j, step in enumerate(steps):
        needs: dict[int, str] = {}
        for i, earlier in enumerate(steps[:j]):
            things = {earlier.pick, earlier.place} - set(regions)
            if step.pick in things:
                needs[i] = "pick"
            elif step.place in things:
                needs[i] = "place" if step.primitive is Primitive.MOVE else "pick"
            elif rule is not None and rule.orders(earlier, step):
                needs[i] = "place"
            elif _lays_across(step, regions) and kind_of(earlier.pick).cargo:
                # Any thing may be its second support.
                needs[i] = "place"
        found.append(needs)
    return tuple(found)


def _lays_across(step: SubTask, regions: Sequence[str]) -> bool:
    """Whether a sub-task lays a plank on two things."""
    moves = step.primitive is Primitive.MOVE and step.place not in regions
    return moves and kind_of(step.pick).span_m is not None


def pose_jobs(
    now: SymbolicState, plan: Plan, goal: Goal, grounder: GeometricGrounder
) -> tuple[Job, ...]:
    """Ask for every sub-task of a plan what each robot would make of it.

    Args:
        now: The situation that the plan begins in.
        plan: The plan.
        goal: Its goal.
        grounder: Says what can be done.
    """
    names, jobs = tuple(grounder.robots), []
    needs = predecessors(plan.subtasks, tuple(now.spec.regions), goal.rule)
    for step, needed in zip(plan.steps, needs, strict=True):
        options = {}
        for robot in names:
            given = replace(step.subtask, robot=robot)
            option = grounder.ground(given, now)
            if option is not None and goal.permits(given, now.has):
                options[robot] = option
        lines = {
            robot: (
                (grounder.robots[robot].base, option.grounded.pick),
                (grounder.robots[robot].base, option.grounded.place),
            )
            for robot, option in options.items()
        }
        worth = {robot: utility(of, now, goal) for robot, of in options.items()}
        jobs.append(Job(step.subtask, options, worth, needed, lines))
        now = step.after
    return tuple(jobs)


def in_order(
    jobs: Sequence[Job],
    order: Sequence[int],
    robots: Sequence[str] | None = None,
    *,
    is_optimal: bool = False,
) -> Schedule:
    """Return the schedule in which each sub-task in turn begins as soon as it can.

    Args:
        jobs: The sub-tasks.
        order: Of the sub-tasks; what one depends on comes before it.
        robots: The robot of each; as the plan says if None.
        is_optimal: Whether that is known to be of least makespan.
    """
    who = tuple(robots or (job.subtask.robot for job in jobs))
    starts = [-1] * len(jobs)
    schedule = Schedule(tuple(jobs), who, tuple(starts), is_optimal)
    placed: list[int] = []
    for m in order:
        times, first = jobs[m].times(who[m]), 0
        for k, why in jobs[m].needs.items():
            first = max(first, schedule.at(k, 2) - times[0 if why == "pick" else 1])
        first = max([first, *(schedule.at(k, 3) for k in placed if who[k] == who[m])])
        lines = jobs[m].lines[who[m]]
        others = [
            (i, entered, left)
            for k in placed
            if who[k] != who[m]
            for entered, left, line in schedule.stays(k)
            for i in _STAGES
            if are_near(lines[i], line)
        ]
        first = _after_others(times, first, others)
        starts[m] = first
        schedule = replace(schedule, starts=tuple(starts))
        placed.append(m)
    return schedule


def _after_others(
    times: Sequence[int], first: int, others: Sequence[tuple[int, int, int]]
) -> int:
    """Return the first time to begin, from which on no stage meets one of others.

    Args:
        times: When it begins, has picked and has placed, from its beginning.
        first: The first time otherwise.
        others: A stage, and a time from which and to which it must not be.
    """
    while True:
        later = max(
            (
                left - times[i]
                for i, entered, left in others
                if _meet(first + times[i], first + times[i + 1], entered, left)
            ),
            default=first,
        )
        if later == first:
            return first
        first = later
