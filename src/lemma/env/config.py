"""What an environment is made of, besides its task: the options of ``make``."""

from dataclasses import dataclass, fields
from typing import Any, Self

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.env.simulation import HORIZON_S, TICK_S
from lemma.robots.ur.build import ARMS
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.tasks.instance import SPLITS
from lemma.tasks.language.template import KINDS
from lemma.tasks.sampling import TEAMS
from lemma.tasks.suite import FREE_SPLIT, task_named

TEAM_SIZE = len(TEAMS[0])
"""Robots in every sampled instance."""


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The options of an environment, with their defaults."""

    task: str
    """Name of the task: ``"poke_stack"``."""
    control: str = "ee_pose"
    """Control level only: what an action commands; a name in
    :data:`lemma.env.control.modes.CONTROLS`."""
    control_hz: float = 20.0
    """Control level only: actions per second; 100 divided by a whole number."""
    observation: str = "state"
    """What is observed; a name in :data:`lemma.env.observation.OBSERVATIONS`."""
    width: int = CAMERA_WIDTH_PX
    """Width of camera images [px]."""
    height: int = CAMERA_HEIGHT_PX
    """Height of camera images [px]."""
    split: str = "train"
    """Where instances come from: ``"train"``, ``"val"``, ``"test"``, or ``"free"`` for
    instances sampled on demand."""
    index: int | None = None
    """Number of the instance in its split; drawn anew by each reset if None."""
    robots: tuple[str, ...] | None = None
    """Arm types of the team, such as ``("ur5", "ur10")``; any team if None. Frozen
    instances have them in either order, free ones from left to right."""
    instruction: str = "high_level"
    """Which of the three instructions is given: ``"high_level"``, ``"human"`` or
    ``"unseen"``."""
    horizon_s: float = HORIZON_S
    """T_max: simulated time after which the episode is truncated [s]."""

    def __post_init__(self) -> None:
        """Check what does not depend on the level."""
        task_named(self.task)
        if self.split not in (*SPLITS, FREE_SPLIT):
            raise UnknownNameError("split", self.split, (*SPLITS, FREE_SPLIT))
        if self.instruction not in KINDS:
            raise UnknownNameError("kind of instruction", self.instruction, KINDS)
        if self.robots is not None:
            self._check_team(tuple(self.robots))
            object.__setattr__(self, "robots", tuple(self.robots))
        ticks = 1.0 / (self.control_hz * TICK_S) if self.control_hz > 0.0 else 0.0
        if not 0.5 < ticks < 1e6 or abs(ticks - round(ticks)) > 1e-9:
            raise InvalidConfigError(
                f"control_hz={self.control_hz} is impossible: a control step must be a "
                f"whole number of servo ticks of {TICK_S:g} s. Try 10, 20, 25 or 50."
            )
        if not self.horizon_s > 0.0:
            raise InvalidConfigError(
                f"horizon_s={self.horizon_s} leaves no time. It must be positive; the "
                f"benchmark uses {HORIZON_S:g}."
            )

    def _check_team(self, robots: tuple[str, ...]) -> None:
        for arm in robots:
            ARMS[arm]
        if sorted(robots) not in [sorted(team) for team in TEAMS]:
            teams = ", ".join(repr(team) for team in TEAMS)
            raise InvalidConfigError(
                f"No instance has the team {robots!r}. Valid: {teams}, or None for any."
            )

    @classmethod
    def from_options(cls, options: dict[str, Any]) -> Self:
        """Make a configuration from keyword arguments.

        Raises:
            UnknownNameError: There is no such option.
        """
        valid = [field.name for field in fields(cls)]
        for name in options:
            if name not in valid:
                raise UnknownNameError(
                    "option", name, [*valid[1:], "level", "render_mode"]
                )
        return cls(**options)

    @property
    def ticks_per_step(self) -> int:
        """Servo ticks in a control step."""
        return round(1.0 / (self.control_hz * TICK_S))
