"""What an attack is, and the registry of all of them.

An attack is a function that plays one attempt at an instance with one robot, while the
others stay parked. It acts through a trial,
:class:`~lemma.audit.skill_trial.SkillTrial` or
:class:`~lemma.audit.control_trial.ControlTrial`, which lets it do what a user of that
level may do, and nothing else. It may look at everything.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lemma.core.arguments import known, whole
from lemma.core.registry import Registry

if TYPE_CHECKING:
    from lemma.audit.control_trial import ControlTrial
    from lemma.audit.skill_trial import SkillTrial

LEVELS = ("skill", "control")
"""What attacks act by: grounded sub-tasks, or commands to the motors."""


class GiveUp(Exception):
    """Geometry says that this robot cannot do it, so no further attempt is made.

    To be raised where that is certain: when in doubt, an attack is executed.
    """


class AttemptOver(Exception):
    """The goal is reached, or the time is up. Trials raise it; attacks let it pass."""


class Lost(AttemptOver):
    """Something that the goal needs has fallen off the table."""


Play = Callable[["SkillTrial"], None] | Callable[["ControlTrial"], None]
"""Plays one attempt; ``trial.attempt`` says the how-manieth."""


@dataclass(frozen=True, kw_only=True)
class Attack:
    """One way to try to do without a partner."""

    name: str
    """Lower-case words joined by underscores: ``"drag_home"``."""
    summary: str
    """One line for people."""
    level: str
    """A name in :data:`LEVELS`."""
    play: Play
    """Plays one attempt."""
    attempts: int = 1
    """How many are made at most, each from the start with other numbers."""
    cheap: bool = False
    """Whether it mostly ends by geometry alone, within milliseconds: such attacks are
    run on every instance that is sampled for a list."""
    team: bool = False
    """Whether it acts with the whole team, to test something else than that one robot
    is not enough; ``trial.robot`` is the first then."""

    def __post_init__(self) -> None:
        """Check level and number.

        Raises:
            UnknownNameError: No such level.
            InvalidConfigError: Less than one attempt.
        """
        known("level of an attack", self.level, LEVELS)
        whole("attempts", self.attempts, 1)


ATTACKS: Registry[Attack] = Registry("attack", Attack)
"""Every attack by name; the audit makes all of them."""
