"""Tasks: arrangement of objects, goals, and instructions."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gymnasium.envs import registration

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry, check_fields
from lemma.robots.hand import HANDS, STANDARD
from lemma.tasks.goal import NOT_IN_TURNS, Goal
from lemma.tasks.language.bank import add_bank
from lemma.tasks.language.template import LanguageBank
from lemma.tasks.names import gym_id
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.teams.layouts import LAYOUTS
from lemma.tasks.teams.rule import RULES

TEAMS: tuple[tuple[str, ...], ...] = (
    ("ur5", "ur5"),
    ("ur5", "ur10"),
    ("ur10", "ur10"),
)
"""The benchmark's three teams; a mixed team is used in either order."""

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task: data, and a function that places the objects.

    Raises:
        InvalidConfigError: A field has a wrong type or value.
        UnknownNameError: No such layout, hand or kind of rule.
    """

    name: str
    """Name in the registry, lower-case words such as ``"poke_stack"``."""
    summary: str
    """One sentence for humans."""
    subtasks: int
    """Number of sub-tasks of the shortest plan."""
    distractors: tuple[int, int]
    """Smallest and largest number of distractors, objects that the goal does not need.
    """
    arrange: Callable[[ObjectPlacer], Goal]
    """Places the objects of the goal, and returns the goal."""
    language: LanguageBank
    """The templates of its instructions."""
    teams: tuple[tuple[str, ...], ...] = TEAMS
    """Arm types of the teams, which are drawn with equal probability. A pair is used in
    either order, a larger team in the order of the layout."""
    rules: tuple[str, ...] = ()
    """Kinds of rules, names in :data:`~lemma.tasks.teams.rule.RULES`. Each instance has
    one, drawn with equal probability; ``arrange`` gets it as ``placer.rule``."""
    hands: tuple[str, ...] = ()
    """Hands of the robots by role, names in ``lemma.robots.hand.HANDS``, that of
    ``placer.order[0]`` first. If empty, all have the standard one."""
    kinds: tuple[str, ...] = ()
    """Unlisted kinds of objects on its tables, such as ``"plank"``, names in
    :data:`~lemma.scene.objects.kind.OBJECT_KINDS`. Its actions and observations have
    numbers for them, after those of all other entities."""
    layout: str = "pair"
    """Layout of the robots: a name in :data:`~lemma.tasks.teams.layouts.LAYOUTS`."""
    fixed: bool = False
    """Whether poses, arms and colors of the robots are the same in all instances: those
    of the first team."""
    alone: bool = False
    """Whether one robot can solve it alone. The audit then attacks with the robots that
    cannot."""
    apart: bool = False
    """Whether the robots share no region, but a gap that only the stick bridges."""

    def __post_init__(self) -> None:
        """Check types, name and numbers."""
        check_fields("task", self.name, self)
        if not _NAME.fullmatch(self.name):
            raise InvalidConfigError(
                f"{self.name!r} cannot name a task. Use lower-case words and digits "
                "with underscores between them: 'sort_colors'."
            )
        least, most = self.distractors
        if not 0 <= least <= most or self.subtasks < 1:
            raise InvalidConfigError(
                f"Task {self.name!r}: {self.subtasks} sub-tasks and {least} to {most} "
                "distractors. There must be at least one sub-task, and the range of "
                "distractors must ascend from zero or more."
            )
        size = LAYOUTS[self.layout].size
        if not self.teams or any(len(team) != size for team in self.teams):
            raise InvalidConfigError(
                f"Task {self.name!r} has the teams {self.teams!r}. There must be one "
                f"or more, of {size} arm types each, such as "
                f"{(('ur5',) * (size - 1) + ('ur10',),)!r}."
            )

        if self.hands and len(self.hands) != size:
            raise InvalidConfigError(
                f"Task {self.name!r} has {len(self.hands)} hands for {size} robots."
            )
        for hand in self.hands:
            HANDS[hand]
        for kind in self.rules:
            known("kind of rule", kind, RULES)

    def hands_of(self, order: Sequence[int]) -> list[str]:
        """Return the hands of the robots by number.

        Args:
            order: The robots by role.
        """
        hands = self.hands or (STANDARD,) * len(order)
        return [hands[order.index(robot)] for robot in range(len(order))]

    @property
    def in_turns(self) -> bool:
        """Whether robots that act in turns can solve it; see :attr:`.Rule.in_turns`."""
        return all(RULES[kind].in_turns for kind in self.rules)

    def check_in_turns(self) -> None:
        """Check that robots that act in turns can solve it.

        Raises:
            InvalidConfigError: They cannot; the message says what to do.
        """
        if not self.in_turns:
            raise InvalidConfigError(NOT_IN_TURNS.format(what=f"Task {self.name!r}"))

    @property
    def gym_id(self) -> str:
        """Gymnasium id, such as ``"lemma/PokeStack-v0"``."""
        return gym_id(self.name)


def _make_known(name: str, task: Task) -> None:
    """Register a task with Gymnasium, and its templates.

    Raises:
        InvalidConfigError: Gymnasium has another task of this id.
    """
    known = registration.registry.get(task.gym_id)
    if known is None:
        registration.register(
            id=task.gym_id, entry_point="lemma.registration:make", kwargs={"task": name}
        )
    elif known.kwargs.get("task") != name:
        raise InvalidConfigError(
            f"Gymnasium would call task {name!r} {task.gym_id}, as it calls "
            f"{known.kwargs.get('task')!r}. Choose another name."
        )
    add_bank(name, task.language)


TASKS: Registry[Task] = Registry("task", Task, on_add=_make_known)
"""All tasks, built-in ones first. An added task is available in Gymnasium, in all
functions that take the name of a task, and on the command line."""
