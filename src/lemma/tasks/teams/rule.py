"""Rules: what must not happen on the way to a goal.

A goal says what shall hold in the end; its rule, if it has one, says what holds all the
way: one thing only after another, without a robot, or nothing about an object. A broken
rule ends the episode, which has failed. It is judged by contacts and poses alone, so it
is the same at every level and however robots act.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from lemma.core.errors import InvalidConfigError, UnknownNameError, shown
from lemma.core.robot_names import robot_number
from lemma.scene.objects.entity import entity_named
from lemma.scene.scene import Scene
from lemma.tasks.subtask import SubTask

Pair = tuple[str, str]
"""The (top, bottom) of a part of a goal."""
Has = Callable[[str, str], bool]
"""Whether the top of a pair lies on its bottom, in a planner's state."""


class Part(Protocol):
    """A part of a goal that says where something shall lie."""

    def holds(self, scene: Scene) -> bool:
        """Whether it is true now."""

    def lies(self, scene: Scene) -> bool:
        """Whether the top lies there at all, be it askew."""


class Rule(ABC):
    """What must not happen on the way to a goal; plain data."""

    kind: ClassVar[str]

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
            has: What lies on what before it.
        """

    def orders(self, earlier: SubTask, later: SubTask) -> bool:
        """Whether a sub-task must not have its effect before an earlier one has it."""
        del earlier, later
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


RULES: dict[str, type[After | Without | But]] = {
    one.kind: one for one in (After, Without, But)
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


@dataclass(frozen=True, slots=True)
class RuleState:
    """The state of a :class:`RuleWatch`; plain data."""

    broken: str | None
    has_been: bool


class RuleWatch:
    """Whether a rule is kept, from the first state of an episode on."""

    def __init__(self, scene: Scene, rule: Rule, parts: Mapping[Pair, Part]) -> None:
        """Watch a scene; call :meth:`note` and :meth:`look` as time passes.

        Args:
            scene: The world.
            rule: The rule.
            parts: The parts of the goal that the rule names.
        """
        self.rule = rule
        self.broken: str | None = None
        """How it was broken, as a sentence; None as long as it is kept."""
        self._scene = scene
        self._parts = tuple(parts[pair] for pair in rule.pairs)
        self._has_been = False
        objects, robots = scene.coasting.names, scene.spec.robot_names
        self._names = (*objects, *robots, "")
        owner, arm = scene.coasting.owner, scene.parts[:, 0]
        self._who = np.where(owner >= 0, owner, len(self._names) - 1)
        self._who = np.where(arm >= 0, len(objects) + arm, self._who)
        bad = [[rule.forbids(a, b) for b in self._names] for a in self._names]
        self._bad = np.array(bad) | np.array(bad).T

    def note(self) -> None:
        """Note who touches whom. Call it after every physics step: a knock is short."""
        who = self._who[self._scene.data.contact.geom]
        bad = self._bad[who[:, 0], who[:, 1]]
        if self.broken is None and bad.any():
            pair = who[int(np.argmax(bad))]
            one, other = sorted(self._names[k] for k in pair)
            self.broken = f"The {one} and the {other} touched."

    def look(self) -> None:
        """Look at the present state. Call it once a servo tick."""
        if not self._parts or self._has_been or self.broken is not None:
            return
        later, first = self._parts
        # In this order: of two that come true in one tick, neither came before.
        self._has_been = first.holds(self._scene)
        if not self._has_been and later.lies(self._scene):
            (top, bottom), (first_top, first_bottom) = self.rule.pairs
            self.broken = (
                f"The {top} was on the {bottom} before the {first_top} was on the "
                f"{first_bottom}."
            )

    def info(self) -> dict[str, object]:
        """Return the rule and how it was broken, ready for JSON."""
        rule = [self.rule.kind, *self.rule.names]
        return {"rule": rule, "broken": self.broken, "has_been": self._has_been}

    def state(self) -> RuleState:
        """Return what is known so far."""
        return RuleState(self.broken, self._has_been)

    def restore(self, state: RuleState) -> None:
        """Go back to what was known before."""
        self.broken, self._has_been = state.broken, state.has_been
