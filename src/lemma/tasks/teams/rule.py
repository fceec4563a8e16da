"""Rules: what must not happen on the way to a goal.

A goal says what shall hold in the end; its rule, if it has one, says what holds all the
way: one thing only after another, two at the same time, without a robot, or nothing
about an object. A broken rule ends the episode, which has failed
(:mod:`lemma.tasks.teams.rule_watch`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from lemma.core.errors import InvalidConfigError, UnknownNameError, shown
from lemma.core.robot_names import robot_number
from lemma.scene.objects.entity import entity_named
from lemma.tasks.subtask import SubTask

Pair = tuple[str, str]
"""The (top, bottom) of a part of a goal."""
Has = Callable[[str, str], bool]
"""Whether the top of a pair lies on its bottom, in a planner's state."""
AT_ONCE_S = 2.0
"""Longest time between two moments that count as the same [s]."""


class Rule(ABC):
    """Forbids something on the way to a goal; plain data."""

    kind: ClassVar[str]
    in_turns: ClassVar[bool] = True
    """Whether robots that act one after another can keep it."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """The robots and objects that it names, as :data:`RULES` takes them."""

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The parts of the goal that it names."""
        return ()

    @property
    def robot(self) -> str | None:
        """The robot that must not take part."""
        return None

    @abstractmethod
    def permits(self, subtask: SubTask, has: Has) -> bool:
        """Whether a sub-task keeps the rule.

        Args:
            subtask: In symbols.
            has: The supports of objects before it.
        """

    def orders(self, earlier: SubTask, later: SubTask) -> bool:
        """Whether a sub-task must not have its effect before an earlier one has it."""
        del earlier, later
        return False

    def meet(self, one: SubTask, other: SubTask) -> bool:
        """Whether two sub-tasks must have their effects at the same time."""
        del one, other
        return False

    def forbids(self, one: str, other: str) -> bool:
        """Whether a robot or object must not touch another, ``""`` being the table."""
        del one, other
        return False

    def words(self, robots: Sequence[str]) -> dict[str, str]:
        """Return what fills the slots of its sentences.

        Args:
            robots: Phrases of the team.
        """
        del robots
        return {}


@dataclass(frozen=True, slots=True)
class After(Rule):
    """One part of the goal may become true only after another has been true."""

    kind: ClassVar[str] = "after"
    top: str
    bottom: str
    first_top: str
    first_bottom: str

    @property
    def names(self) -> tuple[str, ...]:
        """The later part, then the one that comes first."""
        return (self.top, self.bottom, self.first_top, self.first_bottom)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The later part and the first one."""
        return (self.top, self.bottom), (self.first_top, self.first_bottom)

    def permits(self, subtask: SubTask, has: Has) -> bool:
        """The later one is put there where the first holds."""
        later, first = self.pairs
        return (subtask.pick, subtask.place) != later or has(*first)

    def orders(self, earlier: SubTask, later: SubTask) -> bool:
        """Whether one makes the first part true and the other the later one."""
        steps = ((later.pick, later.place), (earlier.pick, earlier.place))
        return steps == self.pairs

    def words(self, robots: Sequence[str]) -> dict[str, str]:
        """Both parts."""
        del robots
        slots = ("top", "bottom", "first_top", "first_bottom")
        said = (entity_named(name).phrase for name in self.names)
        return dict(zip(slots, said, strict=True))


@dataclass(frozen=True, slots=True)
class Without(Rule):
    """A robot must not touch any object."""

    kind: ClassVar[str] = "without"
    excluded: str

    @property
    def names(self) -> tuple[str, ...]:
        """The robot."""
        return (self.excluded,)

    @property
    def robot(self) -> str | None:
        """The robot that must not take part."""
        return self.excluded

    def permits(self, subtask: SubTask, has: Has) -> bool:
        """Another robot does it."""
        del has
        return subtask.robot != self.excluded

    def forbids(self, one: str, other: str) -> bool:
        """Whether the robot touches an object, or another robot that may lead one."""
        return one == self.excluded and other not in (one, "")

    def words(self, robots: Sequence[str]) -> dict[str, str]:
        """The robot."""
        return {"robot": robots[robot_number(self.excluded)]}


@dataclass(frozen=True, slots=True)
class But(Rule):
    """An object stays as it is: nothing but the table touches it."""

    kind: ClassVar[str] = "but"
    thing: str

    @property
    def names(self) -> tuple[str, ...]:
        """The object."""
        return (self.thing,)

    def permits(self, subtask: SubTask, has: Has) -> bool:
        """It is about something else."""
        del has
        return self.thing not in (subtask.pick, subtask.place)

    def forbids(self, one: str, other: str) -> bool:
        """Whether something touches the object."""
        return one == self.thing and other not in (one, "")

    def words(self, robots: Sequence[str]) -> dict[str, str]:
        """The object."""
        del robots
        return {"thing": entity_named(self.thing).phrase}


@dataclass(frozen=True, slots=True)
class Together(Rule):
    """Two parts of the goal become true at the same time, to :data:`AT_ONCE_S`."""

    kind: ClassVar[str] = "together"
    in_turns: ClassVar[bool] = False
    top: str
    bottom: str
    other_top: str
    other_bottom: str

    @property
    def names(self) -> tuple[str, ...]:
        """One part, then the other one."""
        return (self.top, self.bottom, self.other_top, self.other_bottom)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Both parts."""
        return (self.top, self.bottom), (self.other_top, self.other_bottom)

    def permits(self, subtask: SubTask, has: Has) -> bool:
        """Any sub-task may keep it; its time decides."""
        del subtask, has
        return True

    def meet(self, one: SubTask, other: SubTask) -> bool:
        """Whether two sub-tasks make the two parts true."""
        steps = {(one.pick, one.place), (other.pick, other.place)}
        return steps == {*self.pairs}

    def words(self, robots: Sequence[str]) -> dict[str, str]:
        """Both parts."""
        del robots
        slots = ("top", "bottom", "other_top", "other_bottom")
        said = (entity_named(name).phrase for name in self.names)
        return dict(zip(slots, said, strict=True))


RULES: dict[str, type[After | Without | But | Together]] = {
    one.kind: one for one in (After, Without, But, Together)
}
"""Every kind of rule by name."""


def rule_from(data: Sequence[str]) -> Rule:
    """Return the rule of plain data: its kind, then its names.

    Raises:
        UnknownNameError: There is no such kind.
        InvalidConfigError: It has another number of names.
    """
    kind, *names = data or ("",)
    if kind not in RULES:
        raise UnknownNameError("kind of rule", kind, RULES)
    try:
        return RULES[kind](*names)
    except TypeError:
        raise InvalidConfigError(
            f"{shown(list(data))} is no rule: {kind!r} takes another number of names."
        ) from None
