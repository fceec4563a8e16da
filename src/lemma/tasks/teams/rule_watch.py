"""Whether the rule of a goal is kept, judged by contacts and poses alone.

So it is the same at every level, and however robots act.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lemma.scene.scene import Scene
from lemma.tasks.teams.rule import Pair, Rule


class Part(Protocol):
    """A part of a goal that says where something shall lie."""

    def holds(self, scene: Scene) -> bool:
        """Whether it is true now."""

    def lies(self, scene: Scene) -> bool:
        """Whether the top lies there at all, be it askew."""


@dataclass(frozen=True, slots=True)
class RuleState:
    """The state of a :class:`RuleWatch`; plain data."""

    broken: str | None
    has_been: bool


class RuleWatch:
    """Whether a rule is kept, from the first state of an episode on."""

    def __init__(self, scene: Scene, rule: Rule, parts: Mapping[Pair, Part]) -> None:
        """Watch a scene; call :meth:`look` as time passes.

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
        bad = [[rule.forbids(a, b) for b in self._names] for a in self._names]
        scene.forbidden.bad[:] = np.array(bad) | np.array(bad).T

    def look(self) -> None:
        """Look at the contacts since the last call, and at the present state.

        Call it once a servo tick.
        """
        touched = self._scene.forbidden.first.tolist()
        if touched[0] >= 0 and self.broken is None:
            one, other = sorted(self._names[number] for number in touched)
            self.broken = f"The {one} and the {other} touched."
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
        self._scene.forbidden.first[:] = -1
