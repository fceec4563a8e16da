"""The interface of an attack, and the registry of all attacks.

An attack is a function that plays one attempt at an instance with one robot, while the
others stay parked. It acts through a :class:`~lemma.audit.skill_trial.SkillTrial` or a
:class:`~lemma.audit.control_trial.ControlTrial`, which offer only the actions that a
policy of that level has. It may read the whole state.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from lemma.audit.control_trial import ControlTrial
from lemma.audit.skill_trial import SkillTrial
from lemma.core.arguments import known, real, whole
from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry, calling_module
from lemma.env.simulation import HORIZON_S

TRIALS: dict[str, type[SkillTrial] | type[ControlTrial]] = {
    "skill": SkillTrial,
    "control": ControlTrial,
}
"""The trial class of each level: grounded sub-tasks, or motor commands."""

Play = Callable[[SkillTrial], None] | Callable[[ControlTrial], None]
"""Plays one attempt; ``trial.attempt`` is its number, from 0."""


@dataclass(frozen=True)
class Attack:
    """One method to reach a goal without the other robots."""

    play: Play
    """Plays one attempt. The function's name is the name of the attack, and the first
    paragraph of its docstring is the summary."""
    level: str
    """``"skill"`` or ``"control"``."""
    attempts: int = 1
    """Maximum number of attempts with each robot; each begins at the initial state."""
    candidates: int = 1
    """Maximum number of variants that an attempt plays from one state."""
    simulated_s: float = HORIZON_S
    """Simulated time after which an attempt ends [s], including time that was undone.
    The default is the time limit of an episode."""
    cheap: bool = False
    """Whether geometry alone mostly rules it out, within milliseconds. The sampling of
    lists runs these attacks on every instance."""
    team: bool = False
    """Whether it acts with the whole team; it then tests something other than whether
    one robot is enough. ``trial.robot`` is then the first robot."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            UnknownNameError: No such level.
            InvalidConfigError: Less than one attempt or candidate, less than 1 s, or
                a function without docstring.
        """
        known("level of an attack", self.level, TRIALS)
        whole("attempts", self.attempts, 1)
        whole("candidates", self.candidates, 1)
        real("simulated_s", self.simulated_s, 1.0)
        if not self.summary:
            raise InvalidConfigError(
                f"The attack {self.name} has no docstring. Write one sentence about "
                "what it does: `lemma audit` and the documentation show it."
            )

    @property
    def name(self) -> str:
        """Lower-case words joined by underscores: ``"drag_home"``."""
        return getattr(self.play, "__name__", "")

    @property
    def summary(self) -> str:
        """The first paragraph of the docstring, on one line."""
        return " ".join((inspect.getdoc(self.play) or "").split("\n\n")[0].split())

    @property
    def budget(self) -> dict[str, str | float]:
        """Its level and its limits for one robot, ready for JSON."""
        return {
            "level": self.level,
            "attempts": self.attempts,
            "candidates": self.candidates,
            "simulated_s": self.simulated_s,
        }


ATTACKS: Registry[Attack] = Registry("attack", Attack)
"""Every attack by name."""

P = TypeVar("P", bound=Play)


def attack(level: str, **record: Any) -> Callable[[P], P]:
    """Return a decorator that registers a function as an attack.

    Args:
        level: ``"skill"`` or ``"control"``.
        record: Further fields of :class:`Attack`.
    """
    module = calling_module()

    def add(play: P) -> P:
        made = Attack(play, level, **record)
        ATTACKS.add(play.__name__, made, module=module)
        return play

    return add
