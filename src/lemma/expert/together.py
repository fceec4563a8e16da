"""The expert with all robots at work at the same time.

The plan is the one of :mod:`lemma.expert.expert`, or an order of a schedule. Each robot
begins the first of its sub-tasks for which nothing is missing: every earlier one that
shares an object with it has had its effect, so what it needs lies where it should, and
the arm that brought it goes home. Sub-tasks are grounded when they begin, in the state
that those under way will leave behind.
"""

import math
from collections.abc import Iterator, Sequence

from lemma.env.episode import Episode
from lemma.env.team.orders import LOOK_S, Team
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
    needs = predecessors(steps, tuple(episode.instance.scene.regions))
    todo, done, failed = list(range(len(steps))), set[int](), False
    team, numbers = Team(episode, grounder), dict[str, int]()
    while True:
        now = team.observe()
        settled = team.settled(now)
        have = done | {numbers[robot] for robot in settled}
        for robot in () if failed or episode.is_over else grounder.robots:
            mine = (k for k in todo if steps[k].robot == robot)
            k = next((k for k in mine if needs[k].keys() <= have), None)
            if robot in team.orders or k is None or failed:
                continue
            expected = team.expected(now, settled)
            option = grounder.ground(steps[k], expected)
            if option is None:
                failed = True
                continue
            todo.remove(k)
            numbers[robot] = k
            team.begin(option, expected)
        if not team.orders:
            return
        # Where somebody is free and has work, it may begin before another robot is.
        waits = any(steps[k].robot not in team.orders for k in todo) and not failed
        until_s = episode.simulation.time_s + LOOK_S if waits else math.inf
        for ended in team.pass_time(until_s):
            done.add(numbers[ended.robot])
            failed |= not ended.result.ok
            assert ended.subtask is not None
            assert ended.grounded is not None
            yield ExpertStep(ended.subtask, ended.grounded, ended.result, ended.start_s)
