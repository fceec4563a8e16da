"""Instructions of a policy and their goals: the instance's own, or a control."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, permutations, product

from lemma.core.errors import InvalidConfigError
from lemma.core.seeding import stream
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.scene.objects.entity import HAND, entity_named, kind_of, known_entities
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance, splits_of
from lemma.tasks.language.blind import blind_templates, instruction
from lemma.tasks.language.relational import say
from lemma.tasks.language.template import BLIND, RELATIONAL, GoalPairs
from lemma.tasks.suite import TASKS, load_instance

LANGUAGES = {
    "full": "the sentence of the instance",
    "none": "nothing",
    "shuffled": "the sentence of the next instance of the list",
    "swapped": "the sentence with other colors: another goal on the same table",
}
"""Instructions of a policy; all except the first are controls."""
FULL = "full"
"""The instruction of the instance."""
_CANDIDATES = 8


@dataclass(frozen=True, slots=True)
class LanguageControl:
    """An instruction that replaces that of the instance."""

    sentence: str | None = None
    """The instruction; None for that of the instance."""
    asks: GoalPairs | None = None
    """Its goal, if it is another one; None if that is impossible in the scene."""


OWN_SENTENCE = LanguageControl()
"""The instruction of the instance."""


def control_of(language: str, instance: Instance, kind: str) -> LanguageControl:
    """Return the instruction of an episode.

    Args:
        language: One of :data:`LANGUAGES`.
        instance: The instance.
        kind: Kind of the instruction.
    """
    if language == "none":
        return LanguageControl("")
    if language == "shuffled":
        task, split = instance.task, instance.split
        following = instance.index + 1
        size = splits_of(task).get(split, following + 1)
        other = load_instance(task, split, following % size)
        there = set(other.goal.entities) <= set(instance.scene.object_names)
        same = set(other.goal.pairs) == set(instance.goal.pairs)
        # Relations of another table say nothing certain about this one.
        there = there and kind != RELATIONAL
        asks = other.goal.pairs if there and not same else None
        return LanguageControl(instruction(other, kind), asks)
    if language == "swapped":
        asks, is_there = _swapped(instance)
        return LanguageControl(
            _reworded(instance, kind, asks), asks if is_there else None
        )
    return OWN_SENTENCE


def _reworded(instance: Instance, kind: str, asks: GoalPairs) -> str:
    """Return an instance's instruction for another goal, from the same template."""
    said = instruction(instance, kind)
    if instance.goal.rule is not None:
        raise InvalidConfigError(
            f"Instructions of {instance.task!r} contain a rule, and cannot be changed "
            "to another goal. Choose another language, or another task."
        )
    if kind == RELATIONAL:
        return say(instance.scene, Goal.from_pairs(asks), stream(instance.key, kind))
    bank = TASKS[instance.task].language
    blind = kind == BLIND
    for template in blind_templates(instance.task) if blind else bank.templates(kind):
        if template.render(instance.goal.pairs) == said:
            return template.render(asks)
    raise InvalidConfigError(
        f"No {kind} template of task {instance.task!r} says {said!r}. Freeze the "
        "instances anew."
    )


def _swapped(instance: Instance) -> tuple[GoalPairs, bool]:
    """Return another goal of the same form, and whether its objects are in the scene.

    Candidates are sorted by the number of exchanged entities, largest first, in an
    order that depends on the instance alone. The result is the first candidate with a
    plan of the expert; without one, the first candidate.
    """
    names = instance.scene.object_names
    rng = stream(instance.key, "swapped colours")
    goals = list(_goals(instance.goal.pairs, names))
    order = rng.permutation(len(goals))
    goals = [goals[int(i)] for i in order]
    goals.sort(key=lambda goal: -_changes(goal, instance.goal.pairs))
    if not goals:
        every = map(entity_named, known_entities())
        everything = [e.name for e in every if e.color in BENCHMARK_COLORS]
        absent = [name for name in everything if name not in names]
        goals = list(_goals(instance.goal.pairs, absent))
        return goals[int(rng.integers(len(goals)))], False
    now = _situation(instance)
    grounder = GeometricGrounder(instance.scene)
    for goal in islice(goals, _CANDIDATES):
        if find_plan(now, Goal.from_pairs(goal), grounder) is not None:
            return goal, True
    return goals[0], True


def _goals(pairs: GoalPairs, names: tuple[str, ...] | list[str]) -> Iterator[GoalPairs]:
    """Yield the goals of the form of ``pairs`` between some objects, but not itself."""
    entities = Goal.from_pairs(pairs).entities
    ways = []
    kinds = {name: kind_of(name) for name in (*entities, *names)}
    # In the benchmark's order of kinds, not that of the goal.
    for kind in map(OBJECT_KINDS.__getitem__, OBJECT_KINDS):
        needed = [name for name in entities if kinds[name] is kind]
        there = [name for name in names if kinds[name] is kind]
        drawn = permutations(there, len(needed))
        ways.append([dict(zip(needed, found, strict=True)) for found in drawn])
    for choice in product(*ways):
        other = {old: new for part in choice for old, new in part.items()}
        other[HAND] = HAND
        goal = tuple((other[top], other[bottom]) for top, bottom in pairs)
        if set(goal) != set(pairs):
            yield goal


def _changes(goal: GoalPairs, pairs: GoalPairs) -> int:
    """Return the number of different conjuncts, and then of different objects."""
    ours, theirs = (Goal.from_pairs(each).entities for each in (goal, pairs))
    places = sum(a != b for a, b in zip(ours, theirs, strict=True))
    return 100 * len(set(goal) - set(pairs)) + places


def _situation(instance: Instance) -> SymbolicState:
    """Return the initial symbolic state from the instance's poses, without physics."""
    poses = {placed.name: placed.pose for placed in instance.scene.objects}
    movable = [name for name in poses if not kind_of(name).fixed]
    return SymbolicState(
        instance.scene,
        poses,
        {name: TABLE for name in movable if kind_of(name).cargo},
        dict.fromkeys(movable, "start"),
    )
