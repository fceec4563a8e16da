"""Options of an environment: the arguments of ``make`` and ``reset``."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import lru_cache
from typing import Any, Self

import numpy as np

from lemma.core.arguments import flag, known, real, whole
from lemma.core.errors import InvalidConfigError, UnknownNameError, shown
from lemma.core.robot_names import robot_names
from lemma.env.camera_rig import camera_names, close_cameras
from lemma.env.observation import MAX_INSTRUCTION_LENGTH, OBSERVATIONS
from lemma.env.simulation import HORIZON_S
from lemma.robots.ur.build import ARMS
from lemma.scene.build import TICK_S
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.scene.cameras import CLOSE_PX
from lemma.scene.objects.entity import known_entities
from lemma.tasks.instance import Instance, splits_of
from lemma.tasks.language.blind import check_kind, instruction
from lemma.tasks.sampling import sample
from lemma.tasks.suite import (
    FREE_SPLIT,
    TASKS,
    check_split,
    default_split,
    load_instance,
)

RESET_OPTIONS = ("split", "index", "instance")
"""Options of ``reset``."""

_MISSPELLED = 0.75
"""Similarity, from 0 to 1, from which on an unknown option counts as a misspelling."""
_SEEDS = 2**31

LEAST_HZ = 0.1
"""Fewest actions per second [Hz]."""


LEAST_STEP = 0.001
"""Smallest step of a target [m, rad]."""


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The options of an environment, with their defaults."""

    task: str
    """Name of the task: ``"poke_stack"``."""
    control: str = "ee_pose"
    """Control level only: control mode, which defines the action; a name in
    :data:`lemma.env.control.modes.CONTROLS`."""
    control_hz: float = 20.0
    """Control level only: actions per second; 100 divided by a whole number, at least
    0.1. Videos are played at the nearest whole number of pictures per second."""
    clip_actions: bool = False
    """Control level only: clip numbers that are out of bounds instead of refusing
    them."""
    delta_position_m: float = 0.05
    """Control modes ``"delta_..."`` only: translation for an action of 1, at most 1 m
    [m]."""
    delta_rotation_rad: float = 0.25
    """Control modes ``"delta_..."`` only: rotation for an action of 1, at most 1 rad
    [rad]."""
    observation: str = "state"
    """Content of observations; a name in :data:`lemma.env.observation.OBSERVATIONS`."""
    width: int | None = None
    """Width of camera images [px]; if None 224 where the control level observes them,
    else 640."""
    height: int | None = None
    """Height of camera images [px]; if None 224 where the control level observes them,
    else 480."""
    cameras: tuple[str, ...] | None = None
    """Which cameras are observed, see :func:`lemma.env.camera_rig.camera_names`. If
    None, each robot's own; but where the control level observes images, those of
    :func:`lemma.env.camera_rig.close_cameras`."""
    render_width: int = 960
    """Width of the pictures of ``render()`` [px]."""
    render_height: int = 540
    """Height of the pictures of ``render()`` [px]."""
    split: str = ""
    """Source of instances: ``"train"``, ``"val"``, ``"test"``, or ``"free"`` for
    instances sampled on demand. By default ``"train"``, and ``"free"`` for a task that
    has no frozen lists."""
    index: int | None = None
    """Index of the instance in its split; chosen at random by each reset if None."""
    robots: tuple[str, ...] | None = None
    """Arm types of the team, such as ``("ur5", "ur10")``; any team of the task if None.
    Frozen instances match in either order; free ones use the given order, from left to
    right, and any registered arms."""
    instruction: str = "high_level"
    """Which instruction is given: ``"high_level"``, ``"human"``, ``"unseen"``,
    ``"relational"`` or, for evaluation and not of split ``"train"``, ``"blind"``."""
    reward: str = "sparse"
    """Reward function; a name in :data:`lemma.env.signals.rewards.REWARDS`."""
    reward_discount: float = 0.99
    """Discount gamma of the learner, used to shape dense rewards."""
    numeric_info: bool = False
    """Whether ``info`` holds only numbers, with the same names and shapes at every
    step, as TorchRL requires; see :func:`lemma.env.base_env.numbers_of`."""
    horizon_s: float = HORIZON_S
    """T_max: simulated time after which the episode is truncated, at least a servo tick
    of 0.01 s [s]."""

    def __post_init__(self) -> None:
        """Check the options that do not depend on the level."""
        TASKS[self.task]
        if isinstance(self.split, str) and not self.split:
            object.__setattr__(self, "split", default_split(self.task))
        check_split(self.task, self.split)
        check_kind(self.instruction, self.task, self.split)
        checked: dict[str, object] = {
            "render_width": whole("render_width", self.render_width, 1, 4096),
            "render_height": whole("render_height", self.render_height, 1, 4096),
            "control_hz": real("control_hz", self.control_hz, LEAST_HZ, 1.0 / TICK_S),
            "horizon_s": real("horizon_s", self.horizon_s, TICK_S),
            "reward_discount": real("reward_discount", self.reward_discount, 0.0, 1.0),
            "clip_actions": flag("clip_actions", self.clip_actions),
            "numeric_info": flag("numeric_info", self.numeric_info),
            **{
                name: real(name, getattr(self, name), LEAST_STEP, 1.0)
                for name in ("delta_position_m", "delta_rotation_rad")
            },
        }
        for name, side in (("width", self.width), ("height", self.height)):
            if side is not None:
                checked[name] = whole(name, side, 1)
        if self.index is not None:
            size = splits_of(self.task).get(self.split)
            last = None if size is None else size - 1
            checked["index"] = whole("index", self.index, 0, last)
        if self.robots is not None:
            checked["robots"] = self._checked_team(self.robots)
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if self.cameras is not None:
            object.__setattr__(self, "cameras", self._checked_cameras(self.cameras))
        ticks = 1.0 / (self.control_hz * TICK_S)
        if abs(ticks - round(ticks)) > 1e-9:
            raise InvalidConfigError(
                f"control_hz={self.control_hz} is impossible: a control step must be a "
                f"whole number of servo ticks of {TICK_S:g} s. Try 10, 20, 25 or 50."
            )

    @property
    def team_size(self) -> int:
        """Robots of an instance."""
        return len(self.robots or TASKS[self.task].teams[0])

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of objects that this task has and others do not."""
        return TASKS[self.task].kinds

    def _checked_team(self, robots: object) -> tuple[str, ...]:
        if not isinstance(robots, list | tuple) or not robots:
            raise InvalidConfigError(
                f"robots={shown(robots)} is no team. It is a tuple with the arm type "
                "of each robot, such as ('ur5', 'ur10'), or None for any."
            )
        for arm in robots:
            ARMS[arm]
        teams = TASKS[self.task].teams
        listed = self.split == FREE_SPLIT or sorted(robots) in map(sorted, teams)
        if not listed:
            raise InvalidConfigError(
                f"No frozen instance has the team {shown(tuple(robots))}. Valid: "
                f"{', '.join(map(repr, teams))}, or None for any; and any registered "
                f"arms with split={FREE_SPLIT!r}."
            )
        return tuple(robots)

    def _checked_cameras(self, cameras: object) -> tuple[str, ...]:
        names = camera_names(robot_names(self.team_size))
        if not isinstance(cameras, list | tuple) or not cameras:
            raise InvalidConfigError(
                f"cameras={shown(cameras)} is no choice of cameras. It is a tuple of "
                f"some of {', '.join(names)}, or None for the usual ones."
            )
        chosen = tuple(known("camera", name, names) for name in cameras)
        if len(set(chosen)) < len(chosen):
            raise InvalidConfigError(
                f"cameras={shown(chosen)} names a camera twice. Name each once."
            )
        return chosen

    def at_control_level(self) -> Self:
        """Return the options with the control level's cameras and size of images.

        Options that were set stay. Without image observations, all stay: the map is
        fused from each robot's own camera at its default size.

        Raises:
            UnknownNameError: No such observation.
        """
        contents = OBSERVATIONS[self.observation]
        if not (contents.rgb or contents.depth):
            return self
        return replace(
            self,
            width=self.width or CLOSE_PX,
            height=self.height or CLOSE_PX,
            cameras=self.cameras or close_cameras(robot_names(self.team_size)),
        )

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of camera images [px]."""
        return self.width or CAMERA_WIDTH_PX, self.height or CAMERA_HEIGHT_PX

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


def own_options(options: object) -> dict[str, Any]:
    """Return the options of ``reset`` that are meant for this package.

    Libraries that wrap an environment pass options of their own through, so unknown
    options are ignored with a warning.

    Args:
        options: The argument ``options`` of ``reset``.

    Raises:
        InvalidConfigError: The argument is no dictionary.
        UnknownNameError: An option looks like a misspelling of a known one.
    """
    if not isinstance(options, Mapping | None):
        raise InvalidConfigError(
            f"options={shown(options)} of reset is no dictionary. Valid: one with any "
            f"of {', '.join(RESET_OPTIONS)}."
        )
    found = {}
    for name, value in (options or {}).items():
        if name in RESET_OPTIONS:
            found[name] = value
        elif get_close_matches(
            str(name).lower(), RESET_OPTIONS, n=1, cutoff=_MISSPELLED
        ):
            raise UnknownNameError("option of reset", name, RESET_OPTIONS)
        else:
            _ignore(str(name)[:100])
    return found


@lru_cache(maxsize=256)
def _ignore(name: str) -> None:
    """Warn that an option is ignored, once per process."""
    warnings.warn(
        f"The option {name!r} of reset is not one of this environment and is ignored. "
        f"Its options are {', '.join(RESET_OPTIONS)}.",
        stacklevel=2,
    )


class InstanceSource:
    """Finds instances for an environment."""

    def __init__(self, config: EnvConfig) -> None:
        """Select the instances of a configuration's task, split and team."""
        self._config = config

    def choose(self, options: Mapping[str, Any], rng: np.random.Generator) -> Instance:
        """Return the instance for the next episode.

        Args:
            options: Options of ``reset``; see :func:`own_options`.
            rng: Chooses at random if no instance is named.

        Raises:
            UnknownNameError: No such split.
            InvalidConfigError: There is no such instance, or it cannot be used.
        """
        instance = options.get("instance")
        if instance is None:
            split = options.get("split", self._config.split)
            check_split(self._config.task, split)
            index = options.get("index", self._config.index)
            drawn = index is None
            instance = self._draw(split, rng) if drawn else self._load(split, index)
        self.check(instance)
        return instance

    def check(self, instance: object) -> None:
        """Check that an environment can be set up for an instance.

        Raises:
            InvalidConfigError: It is no instance, its team differs, or it lacks the
            chosen kind of instruction.
        """
        if not isinstance(instance, Instance):
            raise InvalidConfigError(
                f"{shown(instance)} is no instance. Try lemma.load_instance(task, "
                "split, index), or lemma.Instance.from_dict of what to_dict() gave."
            )
        arms = tuple(robot.arm for robot in instance.scene.robots)
        count = self._config.team_size
        if len(arms) != count or not self._has_team(instance):
            raise InvalidConfigError(
                f"Instance {instance.key} has the team {arms}, but this environment is "
                f"for {self._config.robots or f'{count} robots'}. Choose another "
                "index, or make the environment with robots=None."
            )
        counted = known_entities(self._config.kinds)
        strange = [n for n in instance.scene.object_names if n not in counted]
        if strange:
            raise InvalidConfigError(
                f"Instance {instance.key} has a {strange[0]}, which actions and "
                f"observations of {self._config.task} do not count. Make the "
                f"environment of {instance.task}."
            )
        kind = self._config.instruction
        text = instruction(instance, kind)
        if len(text) > MAX_INSTRUCTION_LENGTH or not text.isascii():
            raise InvalidConfigError(
                f"The instruction {shown(text)} cannot be observed. It must be ASCII "
                f"and at most {MAX_INSTRUCTION_LENGTH} characters long."
            )

    def _draw(self, split: str, rng: np.random.Generator) -> Instance:
        task, robots = self._config.task, self._config.robots
        if split == FREE_SPLIT:
            return self._load(split, rng.integers(_SEEDS))
        for index in rng.permutation(splits_of(task)[split]):
            instance = load_instance(task, split, int(index))
            if self._has_team(instance):
                return instance
        raise InvalidConfigError(
            f"Split {split!r} of {task!r} has no instance with the team {robots!r}. "
            f"Use split {FREE_SPLIT!r}, or another team."
        )

    def _load(self, split: str, index: Any) -> Instance:
        task, robots = self._config.task, self._config.robots
        if split == FREE_SPLIT:
            return _sampled(task, whole("index", index, 0), robots)
        return load_instance(task, split, index)

    def _has_team(self, instance: Instance) -> bool:
        robots = self._config.robots
        arms = [robot.arm for robot in instance.scene.robots]
        return robots is None or sorted(robots) == sorted(arms)


@lru_cache(maxsize=256)
def _sampled(task: str, index: int, team: tuple[str, ...] | None) -> Instance:
    """Sample a free instance; cached, because some take seconds."""
    return sample(TASKS[task], FREE_SPLIT, index, team=team).instance
