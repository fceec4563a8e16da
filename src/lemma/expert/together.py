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
from lemma.expert.expert import ExpertStep
from lemma.planning.grounding import GeometricGrounder, GroundedOption
from lemma.planning.planner import find_plan
from lemma.planning.schedule import predecessors
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.tasks.subtask import SubTask

_MOST_PLANS = 4
_LOOK_S = 0.05
"""Time between two looks for effects [s]."""
_AS_PREDICTED_M = 0.03
_UnderWay = dict[str, tuple[int, GroundedOption, SymbolicState]]
"""By robot: number of the sub-task, with poses, and the state it was grounded in."""


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
    under_way: _UnderWay = {}
    while True:
        now = SymbolicState.observe(episode.simulation.scene)
        have = done | _effects(episode, under_way, now)
        for robot in () if failed or episode.is_over else grounder.robots:
            mine = (k for k in todo if steps[k].robot == robot)
            k = next((k for k in mine if needs[k].keys() <= have), None)
            if robot in under_way or k is None or failed:
                continue
            expected = now
            for number, other, before in under_way.values():
                if number not in have:
                    expected = _with_effect(expected, other, before)
            option = grounder.ground(steps[k], expected)
            if option is None:
                failed = True
                continue
            todo.remove(k)
            under_way[robot] = (k, option, expected)
            episode.begin(option.grounded)
        if not under_way:
            return
        # Where somebody is free and has work, it may begin before another robot is.
        waits = any(steps[k].robot not in under_way for k in todo) and not failed
        until_s = episode.simulation.time_s + _LOOK_S if waits else math.inf
        for ended in episode.advance(until_s):
            k, option, _ = under_way.pop(ended.grounded.robot)
            done.add(k)
            failed |= not ended.result.ok
            yield ExpertStep(
                option.subtask, ended.grounded, ended.result, ended.start_s
            )


def _effects(episode: Episode, under_way: _UnderWay, now: SymbolicState) -> set[int]:
    """Return the sub-tasks under way that have had their effect."""
    found = set()
    for robot, (k, option, before) in under_way.items():
        after = option.after
        if episode.simulation.reservations.is_going_home(robot) and all(
            now.supports.get(name) == after.supports.get(name)
            and now.poses[name].distance(pose) < _AS_PREDICTED_M
            for name, pose in after.poses.items()
            if pose != before.poses[name] and name in now.poses
        ):
            found.add(k)
    return found


def _with_effect(
    now: SymbolicState, option: GroundedOption, before: SymbolicState
) -> SymbolicState:
    """Return a state in which a sub-task that is under way has ended well."""
    for name, pose in option.after.poses.items():
        if pose != before.poses[name]:
            support = option.after.supports.get(name, TABLE)
            now = now.moved(name, pose, support, option.after.labels[name])
    return now
