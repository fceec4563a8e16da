"""Schedules: the robot and the start time of each sub-task of a plan.

A sub-task takes its predicted duration tau. After the fraction :data:`PICKED` the
gripper has lifted its object; after :data:`PLACED` it has released it and the arm goes
home. A sub-task begins after all objects that it touches have been put down, and places
its object after the support is there. A robot does one sub-task at a time. Two stages
of different robots, picking or placing, exclude each other if the lines from base to
gripper come closer than :data:`.lines.APART_M`, because the sectors that the arms
reserve would then overlap.

The schedule of least makespan extends the paper's allocation by times: the binary v
assigns each sub-task to one robot, sum tau v <= T_max, and among the schedules of least
makespan the one with the highest utility sum u v is chosen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lemma.planning.geometry import GroundedOption
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.lines import Line, are_near
from lemma.planning.planner import Plan, utility
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import SubTask
from lemma.tasks.teams.dependencies import meetings, predecessors

PICKED = 0.41
"""Fraction of its duration after which a sub-task has picked; mean of 38 executions."""
PLACED = 0.79
"""Fraction of its duration after which a sub-task has its effect; mean of the same."""
HORIZON_S = 100.0
"""T_max: largest summed duration (paper, section IV) [s]."""
CS = 100
"""Units of time per second: times are integers in 1/100 s."""
_STAGES = (0, 1)
"""Picking and placing; each stage ends when the next one begins."""

Stay = tuple[int, int, Line]
"""A stage of a sub-task: start and end [1/100 s], and the line from base to gripper."""


@dataclass(frozen=True)
class Job:
    """One sub-task of a plan, with all robots that can do it."""

    subtask: SubTask
    """The sub-task with the robot of the plan."""
    options: Mapping[str, GroundedOption]
    """The grounding by robot, for the robots that can do it at its place in the plan.
    """
    utilities: Mapping[str, float]
    """Utility u by robot."""
    needs: Mapping[int, str]
    """Earlier sub-tasks that it depends on: ``"pick"`` to begin, or ``"place"`` to put
    its object down."""
    lines: Mapping[str, tuple[Line, Line]]
    """Lines from base to gripper by robot, as it picks and as it places [m]. Those of a
    partner as well."""
    meets: int | None = None
    """The sub-task that has its effect at the same time, if the rule says so."""

    def team(self, robot: str) -> tuple[str, ...]:
        """Return the robots that are busy if a robot does it: it, and its partner."""
        partner = self.options[robot].partner
        return (robot, partner) if partner else (robot,)

    def times(self, robot: str) -> tuple[int, ...]:
        """Return begin (0), picked, effect and end, relative to the begin [1/100 s]."""
        tau = self.options[robot].duration_s
        return (0, *(round(CS * part * tau) for part in (PICKED, PLACED, 1.0)))


@dataclass(frozen=True)
class Schedule:
    """The robot and the start time of each sub-task of a plan."""

    jobs: tuple[Job, ...]
    robots: tuple[str, ...]
    """The robot of each sub-task."""
    starts: tuple[int, ...]
    """Start time of each sub-task [1/100 s]."""
    is_optimal: bool = False
    """Whether the schedule is proven to be of least makespan."""

    def at(self, job: int, stage: int) -> int:
        """Return the time of a stage of a sub-task [1/100 s].

        Args:
            job: Index of the sub-task.
            stage: 0: begin, 1: picked, 2: effect, 3: end.
        """
        return self.starts[job] + self.jobs[job].times(self.robots[job])[stage]

    def team(self, job: int) -> tuple[str, ...]:
        """Return who is busy with a sub-task: one robot, or two."""
        return self.jobs[job].team(self.robots[job])

    def share(self, job: int, other: int) -> bool:
        """Whether a robot is busy with both of two sub-tasks."""
        return bool({*self.team(job)} & {*self.team(other)})

    @property
    def status(self) -> str:
        """Status in terms of the solver: ``"optimal"`` or ``"feasible"``."""
        return "optimal" if self.is_optimal else "feasible"

    def order(self, stage: int = 2) -> tuple[int, ...]:
        """Return the indices of the sub-tasks in the order in which they reach a stage.

        Args:
            stage: See :meth:`at`. The order of the default, the effect, satisfies all
                dependencies.
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
        """End of the last sub-task [s]."""
        return max((self.at(k, 3) for k in range(len(self.jobs))), default=0) / CS

    @property
    def sequential_s(self) -> float:
        """Duration of the same sub-tasks one after the other [s]."""
        total = 0
        for job, robot in zip(self.jobs, self.robots, strict=True):
            total += job.times(robot)[3]
        return total / CS

    def to_dict(self) -> dict[str, Any]:
        """Return the schedule for JSON, as a flexible job shop problem with solution.

        ``jobs`` has for each sub-task its robots with durations, its dependencies, and
        the stages (0: pick, 1: place) of earlier ones that exclude its own stages.
        ``schedule`` has its robot and the times of begin, picked, effect and end [s].
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
                    **({} if job.meets is None else {"meets": job.meets}),
                    "excludes": [
                        [i, k, other]
                        for k in range(m)
                        for i in _STAGES
                        for other in _STAGES
                        if not self.share(k, m)
                        and any(
                            are_near(mine[2], theirs[2])
                            for mine in self.stays(m)[i::2]
                            for theirs in self.stays(k)[other::2]
                        )
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
        """Return the sub-tasks on a critical path, first to last.

        Each one waits for the one before it, because of the same robot, a dependency,
        an exclusion, or a common time of their effects.
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
        """Return whether m could begin earlier if k ended earlier."""
        job, same = self.jobs[m], self.share(k, m)
        follows = same and self.at(k, 3) == self.starts[m]
        stage = {"pick": 0, "place": 1}.get(job.needs.get(k, ""))
        needed = stage is not None and self.at(k, 2) == self.at(m, stage)
        if follows or needed or job.meets == k:
            return True
        return not same and any(
            came == left and are_near(line, other)
            for came, _, line in self.stays(m)
            for _, left, other in self.stays(k)
        )

    def stays(self, job: int) -> list[Stay]:
        """Return the stages in which a sub-task excludes others.

        Both stages of its robot come first, then those of a partner.
        """
        lines = self.jobs[job].lines
        return [
            (self.at(job, i), self.at(job, i + 1), lines[robot][i])
            for robot in self.team(job)
            for i in _STAGES
        ]

    def faults(self) -> list[str]:
        """Return descriptions of all violated constraints; empty if there are none."""
        found, count = [], len(self.jobs)
        for m in range(count):
            for k, why in self.jobs[m].needs.items():
                if self.at(m, 0 if why == "pick" else 1) < self.at(k, 2):
                    found.append(f"{m} does not wait for {k}")
            meets = self.jobs[m].meets
            if meets is not None and self.at(m, 2) != self.at(meets, 2):
                found.append(f"{m} does not have its effect together with {meets}")
            for k in range(m):
                same = self.share(k, m)
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
    """Return whether the open intervals (a, b) and (c, d) overlap."""
    return a < d and c < b


def pose_jobs(
    now: SymbolicState, plan: Plan, goal: Goal, grounder: GeometricGrounder
) -> tuple[Job, ...]:
    """Ground every sub-task of a plan for each robot.

    Args:
        now: The state before the plan.
        plan: The plan.
        goal: The goal of the plan.
        grounder: Grounder of the same scene.
    """
    names, jobs = tuple(grounder.robots), []
    needs = predecessors(plan.subtasks, tuple(now.spec.regions), goal.rule)
    meets = meetings(plan.subtasks, goal.rule)
    for k, (step, needed) in enumerate(zip(plan.steps, needs, strict=True)):
        options = {}
        for robot in names:
            given = replace(step.subtask, robot=robot)
            option = grounder.ground(given, now)
            if option is None or not goal.permits(given, now.has):
                continue
            # A pair is one option, whichever of the two is given the order.
            if not option.partner or robot == step.subtask.robot:
                options[robot] = option
        lines = {}
        for option in options.values():
            for one in (option.grounded, option.theirs):
                if one is not None:
                    base = grounder.robots[one.robot].base
                    lines[one.robot] = ((base, one.pick), (base, one.place))
        worth = {robot: utility(of, now, goal) for robot, of in options.items()}
        met = meets.get(k)
        jobs.append(Job(step.subtask, options, worth, needed, lines, met))
        now = step.after
    return tuple(jobs)


def in_order(
    jobs: Sequence[Job],
    order: Sequence[int],
    robots: Sequence[str] | None = None,
    *,
    is_optimal: bool = False,
) -> Schedule:
    """Return the schedule that begins each sub-task, in order, as early as possible.

    Args:
        jobs: The sub-tasks.
        order: Indices of the sub-tasks; dependencies come first.
        robots: The robot of each sub-task; those of the plan if None.
        is_optimal: Whether the result is proven to be of least makespan.
    """
    who = tuple(robots or (job.subtask.robot for job in jobs))
    schedule = Schedule(tuple(jobs), who, (-1,) * len(jobs), is_optimal)
    placed: list[int] = []
    for m in order:
        other = jobs[m].meets
        group = [m] if other is None else [other, m]
        # Two that have their effects together are placed where the second one stands.
        if other is None or order.index(other) < order.index(m):
            schedule = _place(schedule, placed, group)
            placed += group
    return schedule


def _place(schedule: Schedule, placed: Sequence[int], group: list[int]) -> Schedule:
    """Let a sub-task, or two that have their effects together, begin early.

    Two that exclude each other never have; :meth:`Schedule.faults` tells.
    """
    effect = 0
    while True:
        found, there = schedule, [*placed]
        for k in group:
            starts = [*found.starts]
            starts[k] = _earliest(found, k, there, effect)
            found = replace(found, starts=tuple(starts))
            there.append(k)
        effects = [found.at(k, 2) for k in group]
        effect = max(effects)
        if min(effects) == effect or effect > CS * HORIZON_S:
            return found


def _earliest(schedule: Schedule, m: int, placed: Sequence[int], effect: int) -> int:
    """Return when a sub-task can begin at the earliest [1/100 s].

    Args:
        schedule: The start times of the placed sub-tasks.
        m: Index of the sub-task.
        placed: Indices of the placed sub-tasks.
        effect: Earliest time of its effect [1/100 s].
    """
    job, robot = schedule.jobs[m], schedule.robots[m]
    times = job.times(robot)
    first = max(0, effect - times[2])
    for k, why in job.needs.items():
        first = max(first, schedule.at(k, 2) - times[0 if why == "pick" else 1])
    shared = [k for k in placed if schedule.share(k, m)]
    first = max([first, *(schedule.at(k, 3) for k in shared)])
    lines = [job.lines[name] for name in job.team(robot)]
    others = [
        (i, entered, left)
        for k in placed
        if k not in shared
        for entered, left, line in schedule.stays(k)
        for i in _STAGES
        if any(are_near(mine[i], line) for mine in lines)
    ]
    return _after_others(times, first, others)


def _after_others(
    times: Sequence[int], first: int, others: Sequence[tuple[int, int, int]]
) -> int:
    """Return the earliest start at which no stage overlaps an excluded interval.

    Args:
        times: Begin, picked and placed, relative to the start [1/100 s].
        first: Earliest start without exclusions [1/100 s].
        others: A stage, and start and end of an interval excluded for it [1/100 s].
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
