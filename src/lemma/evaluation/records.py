"""Schemas of the files of a result: lines of episodes and settings.

``episodes.jsonl`` has one line per episode, ``about.json`` the settings, and
``summary.json`` the counts; :mod:`lemma.evaluation.lines` reads and writes the lines.
Files are not trusted, so their content is checked.
"""

import math
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from lemma.core.errors import DatasetError
from lemma.core.files import read_json
from lemma.evaluation.line_parts import (
    Names,
    PairRecord,
    Poses,
    Strict,
    Symbols,
    Together,
)
from lemma.tasks.instance import OWN_SPLIT, SPLITS
from lemma.tasks.language.template import ALL_KINDS
from lemma.tasks.names import task_rank
from lemma.tasks.suite import FREE_SPLIT
from lemma.tasks.teams.pairs import PAIRS

EPISODES = "episodes.jsonl"
ABOUT = "about.json"
SUMMARY = "summary.json"
PACKED = ".jsonl.xz"
"""Suffix of files of packed lines, which are small enough to be committed."""
PROTOCOL_VERSION = 3
"""Version of the rules of episodes. Version 2 introduced strict and lenient verdicts;
version 3 forbids throwing, and counts progress in stages."""
RESULT_VERSION = "3"
"""Version of the summaries."""
WALL_CLOCK = ("wall_s",)
"""Fields of an episode's line that depend on the machine."""
STATE = "state_sha256"
"""Field of both verdicts of a line: SHA-256 of the simulator's final state. Lines of
earlier releases have none, so digests of results leave it out."""
POLICY_ERROR = "policy_error"
"""Reason of a failure by a fault of the policy."""
PROTECTIVE_STOP = "protective_stop"
"""Reason of a strict failure by a sub-task that its robot cannot do."""
POSE_TOLERANCE_MM = 20.0
"""A pose with a larger error is a miss: a cube that is held or placed this far off its
center may fall."""

Row = Mapping[str, Any]
"""Line of one episode in ``episodes.jsonl``; :class:`_Line` has its fields."""

EpisodeKey = tuple[str, str, int]
"""Kind of instruction, task and index, which identify an episode of a result."""


class Deviation(StrEnum):
    """Difference of a sub-task from the expert's decision in the same state."""

    NONE = ""
    """The symbolic sub-tasks are equal."""
    ROBOT = "robot"
    """The expert's plan has the sub-task with another robot, now or later."""
    ORDER = "order"
    """The expert's plan has the sub-task later."""
    PRIMITIVE = "primitive"
    """The expert's primitive differs; also for a sub-task after the goal holds."""
    OBJECT = "object"
    """The primitive is equal, but the picked object or the place differs."""


class Feedback(Strict):
    """The expert's judgement of a decision, before its execution."""

    expected: Symbols
    """The expert's own decision; ``stop`` if the goal holds, or no plan is left."""
    left: int | None
    """Number of sub-tasks of the expert's plan; None without a plan."""
    departure: Deviation
    able: bool | None
    """Whether the robot can do it now; None if no robot can."""
    pick_error_mm: float | None
    """Distance of the pick from the center of its cube; None for the stick, which has
    grasps along its handle, and for what has two handles."""
    place_error_mm: float | None
    """Distance of a ``move``'s place from the center of its pad or cube; None for the
    shared region and for tools, without a single right place."""


class _Step(Symbols, kw_only=True):
    grounded: Poses | None
    outcome: str
    explanation: str
    start_s: float
    duration_s: float
    fell: Names
    expert: Feedback
    waited_s: float | None = None
    """Time of waiting for a sector [s]; only for robots that act together."""
    effect_s: float | None = None
    """Time at which its effect was first observed [s], if it was checked."""
    partner: str | None = None
    """The second robot of a joint sub-task; None for other sub-tasks."""


Steps = Annotated[list[_Step], Meta(max_length=200)]
"""Sub-tasks; the bound is more than an episode has time for."""


class _Coordination(Strict):
    expert_s: float | None
    doable: int
    able: int
    planned: int
    as_expert: int
    order_violations: int
    clearance_mm: float | None


class _Fault(Strict):
    kind: str
    explanation: str


class _Planning(Strict):
    decisions: int
    calls: int
    prompt_tokens: int
    completion_tokens: int
    invalid: Annotated[dict[str, int], Meta(max_length=100)]
    replans: int


class _Event(Strict):
    time_s: float
    robot: str
    event: Literal["grasped", "released"]
    object: str


class _Control(Strict):
    """The record of an episode at control level."""

    mode: str
    hz: float
    actions: int
    """Number of control steps."""
    asked: int
    """Number of the policy's decisions."""
    events: list[_Event]
    touched: Names
    """Cubes of the goal that a hand or the stick touched."""
    fallen: Names


class _Stages(Strict):
    """The furthest stage, and the verdicts on the first move."""

    progress: Annotated[float, Meta(ge=0.0, le=1.0)]
    subtask: int | None
    stage: str
    time_s: float
    moved: str
    by: str
    understood: bool | None
    allocated: bool | None
    executed: bool | None


class _Verdict(Strict, kw_only=True):
    """The strict or the lenient verdict of an episode."""

    success: bool
    progress: Annotated[float, Meta(ge=0.0, le=1.0)]
    goal_progress: Annotated[float, Meta(ge=0.0, le=1.0)]
    stages: _Stages
    failure: str | None
    policy_error: _Fault | None
    asked_holds: bool | None
    elapsed_s: float
    subtasks: Steps
    planning: _Planning | None = None
    """Effort of the decisions; only for policies that count it."""
    state_sha256: str | None = None
    """Digest of the final state, which depends on all earlier ones; None in lines of
    earlier releases."""


class _Line(_Verdict, kw_only=True):
    """The fields of an episode's line: the strict verdict and the lenient one."""

    protocol: int
    benchmark: str
    task: str
    split: str
    index: int
    team: str
    distractors: int
    perturb_start: bool
    instruction_kind: str
    instruction: str
    asked: Annotated[list[tuple[str, str]], Meta(max_length=100)] | None
    idle_s: Annotated[dict[str, float], Meta(max_length=1000)]
    coordination: _Coordination
    left: int | None
    lenient: _Verdict | None
    """None if only the strict episode was played."""
    control: _Control | None = None
    """Only for policies at control level."""
    together: Together | None = None
    """Only for robots that act together."""
    pair: PairRecord | None = None
    """Only in the split of pairs of which one cannot be done."""
    wall_s: float = 0.0
    keeps_state: bool = False
    """Whether the policy keeps state from one episode to the next."""


class _Policy(msgspec.Struct):
    name: str
    planning: str
    gta: bool
    level: str = ""


class _Weights(msgspec.Struct):
    sha256: str
    seed: int = 0
    data: dict[str, Any] = {}


class _About(msgspec.Struct):
    policy: _Policy
    weights: dict[str, _Weights]
    language: str
    split: str
    protocol: str
    protocol_version: int
    verdicts: str
    horizon_s: float
    benchmark: str
    mujoco: str
    perturb_start: bool = False


def key_of(row: Row) -> EpisodeKey:
    """Return kind of instruction, task and index of a line's episode."""
    return row["instruction_kind"], row["task"], row["index"]


def enough(left: int | None) -> float:
    """Return the number of remaining sub-tasks; infinity without a plan."""
    return math.inf if left is None else left


def place_of(row: Row) -> tuple[Any, ...]:
    """Return the sort key of a line: kind, task, index."""
    kind, task, index = key_of(row)
    return ALL_KINDS.index(kind), task_rank(task), index


def older_versions(
    weights: Mapping[str, Mapping[str, Any]], benchmark: str
) -> tuple[str, ...]:
    """Return the other versions of the benchmark that weights were trained on.

    Args:
        weights: By name of the model, as in ``about.json``.
        benchmark: The version of the evaluation.
    """
    known = {
        one.get("data", {}).get("benchmark", benchmark) for one in weights.values()
    }
    return tuple(sorted(known - {benchmark}))


def training_seed(weights: Mapping[str, Mapping[str, Any]]) -> int:
    """Return the seed that a policy was trained with; 0 if none is known.

    Args:
        weights: By name of the model, as in ``about.json``.

    Raises:
        DatasetError: The policy's parts were trained with different seeds.
    """
    known = {name: entry["seed"] for name, entry in weights.items() if "seed" in entry}
    seeds = set(known.values())
    if len(seeds) > 1:
        listing = ", ".join(f"{name}: {seed}" for name, seed in known.items())
        raise DatasetError(
            f"The parts of the policy were trained with different seeds ({listing}), "
            "so its result belongs to none of them. Take parts of the same seed."
        )
    return int(seeds.pop()) if seeds else 0


def read_about(path: Path) -> dict[str, Any]:
    """Return the settings of a result.

    Args:
        path: Folder of the result; or its lines, packed or not.

    Raises:
        DatasetError: The file of settings is missing or damaged.
    """
    if path.name == EPISODES:
        path = path.parent
    if not path.name.endswith(PACKED):
        return read_json(path / ABOUT)
    note = path.with_name(path.name.removesuffix(PACKED) + ".json")
    about = read_json(note).get("about")
    if not isinstance(about, dict):
        raise DatasetError(f"{note} is no result: it has no 'about'.")
    return about


def check_about(about: object, path: Path) -> None:
    """Check the fields of settings that reports read.

    Args:
        about: Content of the file.
        path: The file.

    Raises:
        DatasetError: A field is missing or invalid, or the split is unknown.
    """
    try:
        found = msgspec.convert(about, _About)
    except msgspec.ValidationError as error:
        raise DatasetError(
            f"{path} is damaged: {error} of 'about'. Delete it and evaluate again."
        ) from error
    splits = (*SPLITS, FREE_SPLIT, PAIRS, OWN_SPLIT)
    if found.split not in splits:
        raise DatasetError(
            f"{path} has an unknown split: {found.split!r}. Known: {', '.join(splits)}."
        )


def check_line(row: object) -> None:
    """Check the fields of a line.

    Raises:
        ValueError: A field is missing or invalid, or fields contradict each other.
    """
    line = msgspec.convert(row, _Line)
    if line.instruction_kind not in ALL_KINDS:
        raise ValueError(f"no kind of instruction: {line.instruction_kind!r}")
    if line.protocol != PROTOCOL_VERSION:
        raise ValueError(
            f"it follows protocol {line.protocol}, and this is {PROTOCOL_VERSION}"
        )
    if line.success and line.lenient is not None and not line.lenient.success:
        raise ValueError("it succeeded strictly, but not leniently")
