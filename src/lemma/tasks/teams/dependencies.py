"""Sub-tasks of a plan that depend on earlier ones, by objects and by the rule."""

from collections.abc import Sequence

from lemma.scene.objects.entity import kind_of
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.teams.rule import Rule


def predecessors(
    steps: Sequence[SubTask], regions: Sequence[str], rule: Rule | None = None
) -> tuple[dict[int, str], ...]:
    """Return for each sub-task of a plan the earlier ones that it depends on.

    Args:
        steps: The plan.
        regions: Names of the regions, which have room for several objects.
        rule: The rule of the goal.

    Returns:
        For each sub-task, the indices of earlier ones with the kind of dependency:
        ``"pick"`` if they touch or put down an object that it picks or drags;
        ``"place"`` if they only handle the support of its object, or if the rule
        requires their effect before its own.
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


def meetings(steps: Sequence[SubTask], rule: Rule | None = None) -> dict[int, int]:
    """Return the sub-tasks of a plan that have their effect together with another one.

    Args:
        steps: The plan.
        rule: The rule of the goal.

    Returns:
        The index of the other one, by index.
    """
    if rule is None:
        return {}
    return {
        k: m
        for k, one in enumerate(steps)
        for m, other in enumerate(steps)
        if k != m and rule.meet(one, other)
    }
