"""Tasks: how a table is set, and the sentences that ask for the goal."""

import re
from collections.abc import Callable
from dataclasses import dataclass

from gymnasium.envs import registration

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry, check_fields
from lemma.tasks.goal import Goal
from lemma.tasks.language.bank import add_bank
from lemma.tasks.language.template import LanguageBank
from lemma.tasks.names import gym_id
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.teams.layouts import LAYOUTS

TEAMS: tuple[tuple[str, ...], ...] = (
    ("ur5", "ur5"),
    ("ur5", "ur10"),
    ("ur10", "ur10"),
)
"""The benchmark's three teams; a mixed one stands in either order."""

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task: data, and one function that sets the table."""

    name: str
    """Registry name, of lower-case words: ``"poke_stack"``."""
    summary: str
    """One sentence for people."""
    subtasks: int
    """Sub-tasks of the shortest plan."""
    distractors: tuple[int, int]
    """Fewest and most objects that the goal does not need."""
    arrange: Callable[[ObjectPlacer], Goal]
    """Places the objects that matter, and returns the goal."""
    language: LanguageBank
    """Its instructions."""
    teams: tuple[tuple[str, ...], ...] = TEAMS
    """Arm types of the teams that instances are drawn from, each as likely. A pair
    stands in either order; a larger team in the order of the layout."""
    rules: tuple[str, ...] = ()
    """Kinds of rules of which each instance has one, each as likely; ``arrange`` finds
    it as ``placer.rule``. Names in :data:`~lemma.tasks.teams.rule.RULES`."""
    kinds: tuple[str, ...] = ()
    """Kinds of objects on its tables that others do not have, such as ``"plank"``: its
    actions and observations count them. Names in
    :data:`~lemma.scene.objects.kind.OBJECT_KINDS`."""
    layout: str = "pair"
    """Where the robots stand: a name in :data:`~lemma.tasks.teams.layouts.LAYOUTS`."""
    fixed: bool = False
    """Whether the robots of all its instances stand in the same places, of the same
    arms and colors: those of the first team."""
    alone: bool = False
    """Whether the robot that can do it needs no other one. The audit attacks with those
    that cannot."""
    apart: bool = False
    """Whether the robots share no region, but stand so far apart that only the stick
    bridges the gap."""

    def __post_init__(self) -> None:
        """Check types, the name and the numbers."""
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

    @property
    def gym_id(self) -> str:
        """Gymnasium name: ``"lemma/PokeStack-v0"``."""
        return gym_id(self.name)


def _make_known(name: str, task: Task) -> None:
    """Tell Gymnasium of a task, and whoever draws its instructions.

    Raises:
        InvalidConfigError: Another one has its name there.
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
"""Every task that can be sampled, built-in ones first. An added task is known to
Gymnasium, to every function that takes the name of a task, and to the command line."""
