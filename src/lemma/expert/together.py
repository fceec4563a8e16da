"""The expert with all robots working at the same time.

The plan is that of :mod:`lemma.expert.expert`, or the order of a schedule. Each robot
begins the first of its sub-tasks whose dependencies are satisfied: every earlier
sub-task with a common object has had its effect, and the arm that did it is on its way
home. A sub-task is grounded when it begins, in the predicted state after all running
sub-tasks. Where the goal's rule wants two sub-tasks to end together, the shorter one
begins later (:mod:`lemma.expert.timing`).
"""

import math
from collections.abc import Callable, Iterator, Sequence

from lemma.env.episode import Episode
from lemma.env.team.orders import LOOK_S, Team
from lemma.env.team.records import Done
from lemma.expert.expert import ExpertStep
from lemma.expert.timing import Aim
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.subtask import SubTask
from lemma.tasks.teams.dependencies import predecessors

_MOST_PLANS = 4
Watcher = Callable[[SubTask], None]
"""Called with each sub-task when it begins."""


def unwatched(subtask: SubTask) -> None:
    """Do nothing: the default watcher."""


def solve_together(
    episode: Episode, order: Sequence[SubTask] = (), watcher: Watcher = unwatched
) -> Iterator[ExpertStep]:
    """Solve an episode with all robots at once; yield every sub-task that ended.

    After a failure, running sub-tasks are finished before the expert plans again. It
    makes at most four plans.

    Args:
        episode: The episode in progress.
        order: The first plan, such as ``Schedule.steps``; if empty, the planner's.
        watcher: Called with each sub-task when it begins.
    """
    grounder = GeometricGrounder(episode.instance.scene)
    for _ in range(_MOST_PLANS):
        scene, goal = episode.simulation.scene, episode.instance.goal
        if episode.is_over or goal.progress(scene) == 1.0:
            break
        if not order and not scene.time_s:
            # The stages need it as well, and the search takes seconds for four robots.
            order = episode.stages.plan
        elif not order:
            plan = find_plan(SymbolicState.observe(scene), goal, grounder)
            order = () if plan is None else plan.subtasks
        if not order:
            break
        yield from carry_out(episode, order, grounder, watcher)
        order = ()
    if not episode.is_over:
        episode.stop()


def carry_out(
    episode: Episode,
    steps: Sequence[SubTask],
    grounder: GeometricGrounder,
    watcher: Watcher = unwatched,
) -> Iterator[ExpertStep]:
    """Execute a plan with all robots at once; yield every sub-task that ended.

    After a sub-task has failed, or could not be grounded, no further one begins.

    Args:
        episode: The episode in progress.
        steps: The plan, in an order in which sequential execution is possible.
        grounder: Grounder of the same scene.
        watcher: Called with each sub-task when it begins.
    """
    work = TeamWork(Team(episode, grounder), steps, watcher=watcher)
    while True:
        work.begin_ready()
        if not work.team.orders:
            return
        # A free robot with sub-tasks left may begin before any running sub-task ends.
        until_s = episode.simulation.time_s + LOOK_S if work.waits else math.inf
        for ended in work.pass_time(until_s):
            assert ended.subtask is not None
            assert ended.grounded is not None
            yield ExpertStep(ended.subtask, ended.grounded, ended.result, ended.start_s)


class TeamWork:
    """Execution of a plan: each robot begins its next sub-task as soon as possible."""

    def __init__(
        self,
        team: Team,
        steps: Sequence[SubTask],
        *,
        patient: bool = False,
        watcher: Watcher = unwatched,
    ) -> None:
        """Start the execution of a plan.

        Args:
            team: The robots; busy ones finish their sub-tasks first.
            steps: The plan, in an order in which sequential execution is possible.
            patient: Whether a sub-task that cannot be grounded is tried again while
                other robots are busy, for example because its object is still below
                another one.
            watcher: Called with each sub-task when it begins.
        """
        self.team, self.failed, self._patient = team, False, patient
        self._watcher = watcher
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
        self._aim = Aim(team, self._steps, self._needs)

    @property
    def todo(self) -> tuple[SubTask, ...]:
        """Sub-tasks that have not begun, in the order of the plan."""
        return tuple(self._steps[k] for k in self._todo)

    @property
    def waits(self) -> bool:
        """Whether a free robot has sub-tasks left."""
        free = (not self.team.works_on(step.robot) for step in self.todo)
        return any(free) and not self.failed

    def begin_ready(self, may: Callable[[SubTask], bool] = lambda _: True) -> None:
        """Begin all sub-tasks that are ready; none after a sub-task has failed.

        Args:
            may: Returns whether a sub-task may begin.
        """
        team, episode = self.team, self.team.episode
        now, lost = team.observe(), False
        settled = team.settled(now)
        have = self._done | {
            self._numbers[robot] for robot in settled if robot in self._numbers
        }
        begun = {k: team.orders[robot].start_s for robot, k in self._numbers.items()}
        now_s = episode.simulation.time_s
        for robot in () if self.failed or episode.is_over else team.grounder.robots:
            mine = [k for k in self._todo if self._steps[k].robot == robot]
            mine = [k for k in mine if may(self._steps[k])]
            k = next((k for k in mine if self._needs[k].keys() <= have), None)
            if team.works_on(robot) or k is None or self.failed:
                continue
            if not self._aim.is_due(k, now_s, begun, have):
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
            self._watcher(self._steps[k])
        self.failed |= lost and not team.orders

    def pass_time(self, until_s: float) -> list[Done]:
        """Simulate until a sub-task ends or until a time; return the ended ones.

        Args:
            until_s: Latest simulated time [s].
        """
        ended = self.team.pass_time(until_s)
        for one in ended:
            number = self._numbers.pop(one.robot, None)
            self._done |= set() if number is None else {number}
            self.failed |= not one.result.ok
        return ended
