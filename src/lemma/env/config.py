"""What an environment is made of, besides its task: the options of ``make``."""

from dataclasses import dataclass, fields
from typing import Any, Self

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.env.simulation import HORIZON_S, TICK_S
from lemma.robots.ur.build import ARMS
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.tasks.language.template import KINDS
from lemma.tasks.suite import FREE_SPLIT, check_split, default_split, task_named


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
    split: str = ""
    """Where instances come from: ``"train"``, ``"val"``, ``"test"``, or ``"free"`` for
    instances sampled on demand. By default ``"train"``, and ``"free"`` for a task that
    has no frozen lists."""
    index: int | None = None
    """Number of the instance in its split; drawn anew by each reset if None."""
    robots: tuple[str, ...] | None = None
    """Arm types of the team, such as ``("ur5", "ur10")``; any team of the task if None.
    Frozen instances have them in either order; free ones from left to right, of any
    registered arms."""
    instruction: str = "high_level"
    """Which of the three instructions is given: ``"high_level"``, ``"human"`` or
    ``"unseen"``."""
    horizon_s: float = HORIZON_S
    """T_max: simulated time after which the episode is truncated [s]."""

    def __post_init__(self) -> None:
        """Check what does not depend on the level."""
        task_named(self.task)
        object.__setattr__(self, "split", self.split or default_split(self.task))
        check_split(self.task, self.split)
        if self.instruction not in KINDS:
            raise UnknownNameError("kind of instruction", self.instruction, KINDS)
        if self.robots is not None:
            object.__setattr__(self, "robots", self._checked_team(self.robots))
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

    @property
    def team_size(self) -> int:
        """Robots of an instance."""
        return len(self.robots or task_named(self.task).teams[0])

    def _checked_team(self, robots: object) -> tuple[str, ...]:
        if not isinstance(robots, list | tuple) or not robots:
            raise InvalidConfigError(
                f"robots={robots!r:.60} is no team. It is a tuple with the arm type of "
                "each robot, such as ('ur5', 'ur10'), or None for any."
            )
        for arm in robots:
            ARMS[arm]
        teams = task_named(self.task).teams
        listed = self.split == FREE_SPLIT or sorted(robots) in map(sorted, teams)
        if not listed:
            raise InvalidConfigError(
                f"No frozen instance has the team {tuple(robots)!r}. Valid: "
                f"{', '.join(map(repr, teams))}, or None for any; and any registered "
                f"arms with split={FREE_SPLIT!r}."
            )
        return tuple(robots)

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
