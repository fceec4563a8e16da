"""Whether the rule of a goal is kept, judged by contacts and poses alone.

So it is the same at every level, and however robots act.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lemma.scene.build import TIME_STEP_S
from lemma.scene.scene import Scene
from lemma.tasks.teams.rule import AT_ONCE_S, Pair, Rule, Together


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
    laid_s: tuple[tuple[Pair, float], ...] = ()
    """Parts that shall become true together and have, with simulated times [s]."""


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
        self._laid_s: dict[Pair, float] = {}
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
        if isinstance(self.rule, Together):
            self._look_at_times()
        else:
            self._look_at_order(*self._parts)

    def _look_at_order(self, later: Part, first: Part) -> None:
        # In this order: of two that come true in one tick, neither came before.
        self._has_been = first.holds(self._scene)
        if not self._has_been and later.lies(self._scene):
            (top, bottom), (first_top, first_bottom) = self.rule.pairs
            self.broken = (
                f"The {top} was on the {bottom} before the {first_top} was on the "
                f"{first_bottom}."
            )

    def _look_at_times(self) -> None:
        now_s, laid_s = self._scene.time_s, self._laid_s
        late_s = min(laid_s.values(), default=math.inf) + AT_ONCE_S + 0.5 * TIME_STEP_S
        if now_s > late_s:
            ((top, bottom),) = set(self.rule.pairs) - {*laid_s}
            self.broken = (
                f"The {top} was not on the {bottom} within {AT_ONCE_S:g} s of the "
                "other one."
            )
            return
        for pair, part in zip(self.rule.pairs, self._parts, strict=True):
            if pair not in laid_s and part.lies(self._scene):
                laid_s[pair] = now_s
        self._has_been = len(laid_s) == len(self._parts)

    def info(self) -> dict[str, object]:
        """Return the rule and how it was broken, ready for JSON."""
        found: dict[str, object] = {
            "rule": [self.rule.kind, *self.rule.names],
            "broken": self.broken,
            "has_been": self._has_been,
        }
        if isinstance(self.rule, Together):
            found["laid_s"] = [self._laid_s.get(pair) for pair in self.rule.pairs]
        return found

    def state(self) -> RuleState:
        """Return what is known so far."""
        return RuleState(self.broken, self._has_been, tuple(self._laid_s.items()))

    def restore(self, state: RuleState) -> None:
        """Go back to what was known before."""
        self.broken, self._has_been = state.broken, state.has_been
        self._laid_s = dict(state.laid_s)
        self._scene.forbidden.first[:] = -1
