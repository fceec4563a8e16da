"""The expert with all robots at work at the same time.

The plan is the one of :mod:`lemma.expert.expert`, or an order of a schedule. Each robot
begins the first of its sub-tasks for which nothing is missing: every earlier one that
shares an object with it has had its effect, so what it needs lies where it should, and
the arm that brought it goes home. Sub-tasks are grounded when they begin, in the state
that those under way will leave behind.
"""

import math
from collections.abc import Callable, Iterator, Sequence

from lemma.env.episode import Episode
from lemma.env.team.orders import LOOK_S, Team
from lemma.env.team.records import Done
from lemma.expert.expert import ExpertStep
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.schedule import predecessors
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.subtask import SubTask

_MOST_PLANS = 4


def solve_together(
    episode: Episode, order: Sequence[SubTask] = ()
) -> Iterator[ExpertStep]:
    """Let all robots work on an episode to its end, yielding every sub-task.

    After a failure what is under way is finished, and then a new plan is made, up to
    four plans in all.

    Args:
        episode: The instance being worked on.
        order: The first plan, such as ``Schedule.steps``; the planner's if empty.
    """
    grounder = GeometricGrounder(episode.instance.scene)
    for _ in range(_MOST_PLANS):
        scene, goal = episode.simulation.scene, episode.instance.goal
        if episode.is_over or goal.progress(scene) == 1.0:
            break
        if not order:
            plan = find_plan(SymbolicState.observe(scene), goal, grounder)
            order = () if plan is None else plan.subtasks
        if not order:
            break
        yield from carry_out(episode, order, grounder)
        order = ()
    if not episode.is_over:
        episode.stop()


def carry_out(
    episode: Episode, steps: Sequence[SubTask], grounder: GeometricGrounder
) -> Iterator[ExpertStep]:
    """Carry out a plan, with as many robots at a time as can; yields what ended.

    Nothing new begins once a sub-task has failed or finds no poses.

    Args:
        episode: The instance being worked on.
        steps: The plan, in an order in which it can be carried out one by one.
        grounder: Of the same scene.
    """
    work = TeamWork(Team(episode, grounder), steps)
    while True:
        work.begin_ready()
        if not work.team.orders:
            return
        # Where somebody is free and has work, it may begin before another robot is.
        until_s = episode.simulation.time_s + LOOK_S if work.waits else math.inf
        for ended in work.pass_time(until_s):
            assert ended.subtask is not None
            assert ended.grounded is not None
            yield ExpertStep(ended.subtask, ended.grounded, ended.result, ended.start_s)


class TeamWork:
    """A plan under way: each robot begins its next sub-task as soon as it can."""

    def __init__(
        self, team: Team, steps: Sequence[SubTask], *, patient: bool = False
    ) -> None:
        """Take over a team.

        Args:
            team: Its robots; those at work finish what they do.
            steps: The sub-tasks after that, in an order in which they can be done one
                by one.
            patient: Whether a sub-task that finds no poses is tried again while others
                are at work; it may be about what lies below something else.
        """
        self.team, self.failed, self._patient = team, False, patient
        running = [(name, order.subtask) for name, order in team.orders.items()]
        before = [subtask for _, subtask in running if subtask is not None]
        self._steps = (*before, *steps)
        regions = tuple(team.episode.instance.scene.regions)
        rule = team.episode.instance.goal.rule
        self._needs = predecessors(self._steps, regions, rule)
        self._todo = list(range(len(before), len(self._steps)))
        names = [name for name, subtask in running if subtask is not None]
        self._numbers = {name: number for number, name in enumerate(names)}
        self._done = set[int]()

    @property
    def todo(self) -> tuple[SubTask, ...]:
        """Sub-tasks that have not begun, in the order of the plan."""
        return tuple(self._steps[k] for k in self._todo)

    @property
    def waits(self) -> bool:
        """Whether a robot is free that has work left."""
        free = (not self.team.works_on(step.robot) for step in self.todo)
        return any(free) and not self.failed

    def begin_ready(self, may: Callable[[SubTask], bool] = lambda _: True) -> None:
        """Let free robots begin that can; nobody once a sub-task has failed.

        Args:
            may: Whether a sub-task may begin.
        """
        team, episode = self.team, self.team.episode
        now, lost = team.observe(), False
        settled = team.settled(now)
        have = self._done | {
            self._numbers[robot] for robot in settled if robot in self._numbers
        }
        for robot in () if self.failed or episode.is_over else team.grounder.robots:
            mine = [k for k in self._todo if self._steps[k].robot == robot]
            mine = [k for k in mine if may(self._steps[k])]
            k = next((k for k in mine if self._needs[k].keys() <= have), None)
            if team.works_on(robot) or k is None or self.failed:
                continue
            expected = team.expected(now, settled)
            option = team.grounder.ground(self._steps[k], expected)
            if option is None:
                lost, self.failed = True, not self._patient
                continue
            if team.works_on(option.partner):
                continue
            self._todo.remove(k)
            self._numbers[robot] = k
            team.begin(option, expected)
        self.failed |= lost and not team.orders

    def pass_time(self, until_s: float) -> list[Done]:
        """Let time pass until a sub-task ends, or up to a time [s]; return what ended.

        Args:
            until_s: Simulated time [s].
        """
        ended = self.team.pass_time(until_s)
        for one in ended:
            number = self._numbers.pop(one.robot, None)
            self._done |= set() if number is None else {number}
            self.failed |= not one.result.ok
        return ended
