"""The expert with all robots at work at the same time.

The plan is the one of :mod:`lemma.expert.expert`. Each robot begins the first of its
sub-tasks for which nothing is missing: every earlier one that shares an object with it
has ended. Sub-tasks are grounded when they begin, in the state that those under way
will leave behind.
"""

from collections.abc import Iterator, Sequence

from lemma.env.episode import Episode
from lemma.expert.expert import ExpertStep
from lemma.planning.grounding import GeometricGrounder, GroundedOption
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.tasks.subtask import SubTask

_MOST_PLANS = 4


def predecessors(
    steps: Sequence[SubTask], regions: Sequence[str]
) -> tuple[frozenset[int], ...]:
    """Return for each sub-task of a plan the earlier ones that it depends on.

    Those are the ones that touch or put down what it touches or puts something on.

    Args:
        steps: The plan.
        regions: Places that are no objects, and have room for several.
    """
    things = [{step.pick, step.place} - set(regions) for step in steps]
    return tuple(
        frozenset(i for i in range(j) if things[i] & things[j])
        for j in range(len(steps))
    )


def solve_together(episode: Episode) -> Iterator[ExpertStep]:
    """Let all robots work on an episode to its end, yielding every sub-task.

    After a failure what is under way is finished, and then a new plan is made, up to
    four plans in all.

    Args:
        episode: The instance being worked on.
    """
    grounder = GeometricGrounder(episode.instance.scene)
    for _ in range(_MOST_PLANS):
        scene, goal = episode.simulation.scene, episode.instance.goal
        if episode.is_over or goal.progress(scene) == 1.0:
            break
        plan = find_plan(SymbolicState.observe(scene), goal, grounder)
        if plan is None or not plan.steps:
            break
        yield from carry_out(episode, plan.subtasks, grounder)
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
    under_way: dict[str, tuple[int, GroundedOption, SymbolicState]] = {}
    while True:
        for robot in () if failed or episode.is_over else grounder.robots:
            ready = (k for k in todo if steps[k].robot == robot and needs[k] <= done)
            k = next(ready, None)
            if robot in under_way or k is None or failed:
                continue
            now = SymbolicState.observe(episode.simulation.scene)
            for _, other, before in under_way.values():
                now = _with_effect(now, other, before)
            option = grounder.ground(steps[k], now)
            if option is None:
                failed = True
                continue
            todo.remove(k)
            under_way[robot] = (k, option, now)
            episode.begin(option.grounded)
        if not under_way:
            return
        for ended in episode.advance():
            k, option, _ = under_way.pop(ended.grounded.robot)
            done.add(k)
            failed |= not ended.result.ok
            yield ExpertStep(
                option.subtask, ended.grounded, ended.result, ended.start_s
            )


def _with_effect(
    now: SymbolicState, option: GroundedOption, before: SymbolicState
) -> SymbolicState:
    """Return a state in which a sub-task that is under way has ended well."""
    for name, pose in option.after.poses.items():
        if pose != before.poses[name]:
            support = option.after.supports.get(name, TABLE)
            now = now.moved(name, pose, support, option.after.labels[name])
    return now
