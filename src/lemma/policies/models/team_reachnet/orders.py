"""The parts of a plan that free robots can be given now."""

from collections.abc import Collection, Sequence

from lemma.policies.models.team_reachnet.teams import REGIONS
from lemma.tasks.subtask import SubTask
from lemma.tasks.teams.dependencies import meetings, predecessors
from lemma.tasks.teams.rule import Rule


def next_orders(
    steps: Sequence[SubTask],
    todo: Sequence[int],
    free: Collection[str],
    ended: Collection[SubTask],
    rule: Rule | None,
) -> list[int]:
    """Return the indices of orders for free robots, in the order of the plan.

    A robot gets its first sub-task that needs nothing more. If there is none, it gets
    the first one whose predecessors have all been ordered: it waits for their effects,
    as far as these concern objects that it touches. A rule about parts of the goal is
    not visible in objects: where one comes after another, that one must have ended, and
    where two come at the same time, both are ordered at once when nothing else is left.

    Args:
        steps: The plan.
        todo: Indices of the sub-tasks that have not been ordered.
        free: Robots without an order.
        ended: Sub-tasks that have ended.
        rule: The rule of the goal.
    """
    needs = [set(found) for found in predecessors(steps, REGIONS, rule)]
    meet = set(meetings(steps, rule))
    apart = {steps[k].robot for k in meet}
    if meet and meet <= {*todo} and len(apart) == len(meet):
        if all(one in ended for k, one in enumerate(steps) if k not in meet):
            return sorted(meet) if apart <= {*free} else []
        todo = [k for k in todo if k not in meet]
    late = [k for k in todo if any(steps[i] not in ended for i in needs[k])]
    waiting, robots, orders = set(todo), set(free), list[int]()
    for k in (*(k for k in todo if k not in late), *late):
        before = [steps[i] for i in needs[k] if steps[i] not in ended]
        held = rule is not None and any(rule.orders(one, steps[k]) for one in before)
        if steps[k].robot in robots and not held and not waiting & needs[k]:
            orders.append(k)
            waiting.remove(k)
            robots.remove(steps[k].robot)
    return sorted(orders)
