"""Instances: sampled problems as frozen data."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import msgspec

from lemma.core.arguments import whole
from lemma.core.errors import InvalidConfigError, shown
from lemma.core.poses import Pose2
from lemma.robots.hand import STANDARD
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.names import FAMILIES
from lemma.tasks.teams.rule import rule_from

BENCHMARK_VERSION = "v3"
"""Part of every instance's key. It changes with the sampler."""

OWN_SPLIT = "own"
"""Split of instances that users changed; they are in no frozen list."""

SPLITS = {"train": 700, "val": 40, "test": 60}
"""Frozen instances per task and split (paper, section V)."""
_TEAM_SPLITS = {**SPLITS, "train": 200}
"""Frozen instances per task and split of the suite ``teams``."""


LARGEST_INDEX = 2**63 - 1
"""Largest index of an instance, or seed of a sampled one: tables and files store it as
a 64-bit integer."""

_PARTS = {
    "task": str,
    "split": str,
    "scene": SceneSpec,
    "goal": Goal,
    "instructions": dict,
    "distractors": tuple,
}
_Placed = tuple[str, str, int | float, int | float, int | float]


class _Data(TypedDict):
    """The form of an instance as plain data."""

    task: str
    split: str
    index: int
    robots: Annotated[list[_Placed], msgspec.Meta(min_length=1)]
    objects: list[_Placed]
    gap_m: tuple[float, float] | None
    goal: list[tuple[str, str]]
    instructions: dict[str, str]
    distractors: list[str]
    rule: NotRequired[Annotated[list[str], msgspec.Meta(min_length=1)]]
    hands: NotRequired[list[str]]
    masses_kg: NotRequired[dict[str, int | float]]


def splits_of(task: str) -> dict[str, int]:
    """Return the number of frozen instances by split, for a task of a suite."""
    return _TEAM_SPLITS if task in FAMILIES else SPLITS


@dataclass(frozen=True, slots=True)
class Instance:
    """One problem, a pure function of (benchmark version, task, split, index).

    Raises:
        InvalidConfigError: The parts do not fit together, or one has a wrong type.
    """

    task: str
    split: str
    index: int
    scene: SceneSpec
    goal: Goal
    instructions: dict[str, str]
    """Sentence by kind of instruction (``high_level``, ``human``, ``unseen``)."""
    distractors: tuple[str, ...]
    """Objects that the goal does not need."""

    def __post_init__(self) -> None:
        """Check that the parts fit together."""
        for name, wanted in _PARTS.items():
            if not isinstance(getattr(self, name), wanted):
                raise InvalidConfigError(
                    f"{name}={shown(getattr(self, name))} cannot be part of an "
                    f"instance. Valid: a {wanted.__name__}."
                )
        whole("index", self.index, 0, LARGEST_INDEX)
        words = (*self.instructions, *self.instructions.values())
        if not all(isinstance(word, str) for word in words):
            raise InvalidConfigError(
                f"instructions={shown(self.instructions)} are no sentences by kind."
            )
        names, rule = self.scene.object_names, self.goal.rule
        # Only goals with a rule have this key, so that data of other instances stay
        # unchanged.
        known = (*names, *self.scene.robot_names)
        if rule is not None and not set(rule.names) <= set(known):
            raise InvalidConfigError(
                f"{rule} names an entity that is not on the table. There are "
                f"{', '.join(known)}."
            )
        absent = [n for n in (*self.goal.entities, *self.distractors) if n not in names]
        if absent:
            raise InvalidConfigError(
                f"Goal or distractors name {shown(absent[0])}, which is not on the "
                f"table. There are {', '.join(names) or 'no objects'}."
            )

    @property
    def key(self) -> str:
        """Unique readable name, such as ``"v3/stack/test/3"``."""
        return f"{BENCHMARK_VERSION}/{self.task}/{self.split}/{self.index}"

    @property
    def team(self) -> str:
        """Arm types from small to large, such as ``"ur5+ur10"``."""
        arms = (robot.arm for robot in self.scene.robots)
        return "+".join(sorted(arms, key=_arm_order))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON.

        ``rule`` is present only if the goal has one, ``hands`` only if a robot has
        another hand than the standard one, and ``masses_kg`` has the objects whose mass
        is not that of their kind.
        """
        rule, hands = self.goal.rule, list(self.scene.other_hands)
        masses = {o.name: o.mass_kg for o in self.scene.objects if o.mass_kg}
        return {
            "version": BENCHMARK_VERSION,
            "task": self.task,
            "split": self.split,
            "index": self.index,
            "robots": [
                [r.arm, r.color, r.base.x, r.base.y, r.base.yaw]
                for r in self.scene.robots
            ],
            "objects": [
                [o.kind, o.color, o.pose.x, o.pose.y, o.pose.yaw]
                for o in self.scene.objects
            ],
            "gap_m": list(gap) if (gap := self.scene.gap_m) else None,
            "goal": [list(pair) for pair in self.goal.pairs],
            "instructions": dict(self.instructions),
            "distractors": list(self.distractors),
            **({} if rule is None else {"rule": [rule.kind, *rule.names]}),
            **({"hands": hands} if hands else {}),
            **({"masses_kg": masses} if masses else {}),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "Instance":
        """Create an instance from the result of :meth:`to_dict`.

        Raises:
            InvalidConfigError: The data have another form, or describe no instance.
            UnknownNameError: They name an arm, a kind, a color or an entity that does
                not exist.
        """
        try:
            msgspec.convert(data, _Data)
        except (msgspec.ValidationError, RecursionError) as error:
            raise InvalidConfigError(
                f"{shown(data)} describes no instance: {error}. Valid: what "
                "Instance.to_dict() returned."
            ) from None
        hands = data.get("hands", [STANDARD] * len(data["robots"]))
        if len(hands) != len(data["robots"]):
            raise InvalidConfigError(
                f"There are {len(hands)} hands for {len(data['robots'])} robots."
            )
        robots = tuple(
            RobotPlacement(arm, color, Pose2(x, y, yaw), hand)
            for (arm, color, x, y, yaw), hand in zip(data["robots"], hands, strict=True)
        )
        objects = _with_masses(
            data.get("masses_kg", {}),
            (
                ObjectPlacement(kind, color, Pose2(x, y, yaw))
                for kind, color, x, y, yaw in data["objects"]
            ),
        )
        gap, goal = data["gap_m"], tuple((top, on) for top, on in data["goal"])
        rule = rule_from(data["rule"]) if "rule" in data else None
        return cls(
            task=data["task"],
            split=data["split"],
            index=data["index"],
            scene=SceneSpec(robots, objects, tuple(gap) if gap else None),
            goal=Goal.from_pairs(goal, rule),
            instructions=dict(data["instructions"]),
            distractors=tuple(data["distractors"]),
        )

    @classmethod
    def read(cls, text: str | bytes, source: str = "This text") -> "Instance":
        """Create an instance from the JSON of :meth:`to_dict`.

        Args:
            text: The JSON.
            source: Name of its source, for error messages.

        Returns:
            The instance; its split is always :data:`OWN_SPLIT`.

        Raises:
            InvalidConfigError: The text is no JSON, is of another version of the
                benchmark, or describes no instance.
            UnknownNameError: It names something that does not exist.
        """
        try:
            data = json.loads(text)
        # Deeply nested brackets raise a RecursionError in the parser.
        except (ValueError, RecursionError) as error:
            raise InvalidConfigError(f"{source} is no JSON: {error}.") from None
        if not isinstance(data, dict):
            raise InvalidConfigError(
                f"{source} describes no instance: it is no object."
            )
        version = data.get("version", BENCHMARK_VERSION)
        if version != BENCHMARK_VERSION:
            raise InvalidConfigError(
                f"{source} is of version {shown(version)} of the benchmark, and this "
                f"is {BENCHMARK_VERSION}."
            )
        try:
            return replace(cls.from_dict(data), split=OWN_SPLIT)
        except InvalidConfigError as error:
            raise InvalidConfigError(f"{source}: {error}") from None

    @classmethod
    def load(cls, path: Path) -> "Instance":
        """Read an instance from a file; see :meth:`read`.

        Raises:
            InvalidConfigError: The file cannot be read, or see :meth:`read`.
            UnknownNameError: It names something that does not exist.
        """
        try:
            text = path.read_bytes()
        except OSError as error:
            raise InvalidConfigError(
                f"{path} cannot be read: {error.strerror or error}. Valid: a file that "
                "lemma play saved, or the JSON of Instance.to_dict()."
            ) from None
        return cls.read(text, str(path))

    def to_json(self) -> str:
        """Return the text of a readable JSON file; see :meth:`read`."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False) + "\n"

    def sha256(self) -> str:
        """Return the SHA-256 of the instance's canonical JSON."""
        text = json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def _with_masses(
    masses_kg: Mapping[str, float], objects: Iterable[ObjectPlacement]
) -> tuple[ObjectPlacement, ...]:
    """Return objects with the masses that some of them have.

    Raises:
        InvalidConfigError: One that is named is not there, or cannot have such a mass.
    """
    found = tuple(replace(o, mass_kg=masses_kg.get(o.name)) for o in objects)
    unknown = set(masses_kg) - {placed.name for placed in found}
    if unknown:
        raise InvalidConfigError(
            f"masses_kg names {shown(min(unknown))}, which is not on the table."
        )
    return found


def _arm_order(arm: str) -> tuple[int, str]:
    """Return a sort key for arm types by size, the number in their name."""
    digits = "".join(c for c in arm if c.isdigit())
    return (int(digits or 0), arm)
