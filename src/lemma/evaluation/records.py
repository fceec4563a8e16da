"""Records that all the rest reads and writes: what is in a line, and in a note.

``episodes.jsonl`` holds one line per episode, ``about.json`` what decides them, and
``summary.json`` what was counted of them; :mod:`lemma.evaluation.lines` reads and
writes the lines. Files may come from anywhere, so their content is checked.
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
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.names import task_rank
from lemma.tasks.suite import FREE_SPLIT
from lemma.tasks.teams.pairs import PAIRS

EPISODES = "episodes.jsonl"
ABOUT = "about.json"
SUMMARY = "summary.json"
PACKED = ".jsonl.xz"
"""End of the name of packed lines, which are small enough to be committed."""
PROTOCOL_VERSION = 3
"""Version of the rules by which episodes are played and judged: since 2 there are a
strict and a lenient verdict, since 3 nothing may be thrown, and progress is counted in
stages."""
RESULT_VERSION = "3"
"""Version of the summaries."""
WALL_CLOCK = ("wall_s",)
"""Fields of an episode's line that depend on the machine."""
STATE = "state_sha256"
"""Field of both verdicts of a line: SHA-256 of the simulator's whole state at that end.
Lines of earlier releases have none, so digests of results leave it out."""
POLICY_ERROR = "policy_error"
"""Why an episode failed whose policy did."""
PROTECTIVE_STOP = "protective_stop"
"""Why an episode failed strictly whose policy sent a robot to what it cannot do."""
POSE_TOLERANCE_MM = 20.0
"""A pose further off than this is missed: a cube that is held, or laid on another, so
far off its middle may fall."""

Row = Mapping[str, Any]
"""One episode, as it stands in ``episodes.jsonl``; :class:`_Line` names its fields."""

EpisodeKey = tuple[str, str, int]
"""Kind of instruction, task and number: which episode of a result it is."""


class Deviation(StrEnum):
    """Difference of a sub-task from the expert's decision in the same state."""

    NONE = ""
    """In nothing: it is the same in symbols."""
    ROBOT = "robot"
    """Another robot should do this; now or later in the expert's plan."""
    ORDER = "order"
    """It is in the expert's plan, but further on."""
    PRIMITIVE = "primitive"
    """Another primitive is due; acting where all is done counts here."""
    OBJECT = "object"
    """The primitive is right, what is picked or where it goes is not."""


class Feedback(Strict):
    """Judgement of the expert on a decision, before it is carried out."""

    expected: Symbols
    """The expert's own decision; ``stop`` if the goal holds, or no plan is left."""
    left: int | None
    """Sub-tasks of the expert's plan; None where there is no plan."""
    departure: Deviation
    able: bool | None
    """Whether the robot could do it now; None where none of the robots could."""
    pick_error_mm: float | None
    """Distance of the pick from the middle of the cube that is meant; None for the
    stick, which can be grasped along its handle."""
    place_error_mm: float | None
    """Distance of a ``move``'s place from the middle of the pad or cube that is meant;
    None for the shared region and for tools, which leave a choice."""


class _Step(Symbols, kw_only=True):
    grounded: Poses | None
    outcome: str
    explanation: str
    start_s: float
    duration_s: float
    fell: Names
    expert: Feedback
    waited_s: float | None = None
    """Time in which it waited for a sector [s]; only where robots act together."""
    effect_s: float | None = None
    """When its effect was first seen [s], if somebody looked for it."""


Steps = Annotated[list[_Step], Meta(max_length=200)]
"""More than an episode has time for."""


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
    """Control steps."""
    asked: int
    """How often the policy was."""
    events: list[_Event]
    touched: Names
    """Cubes that the goal moves and that a hand or the stick has touched."""
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
    """The strict verdict of an episode, or that after it went on."""

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
    """Digest of the last state, which depends on all earlier ones; None in lines of
    earlier releases."""


class _Line(_Verdict, kw_only=True):
    """The fields of an episode's line: the strict verdict, with the lenient in it."""

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
    """None if it was played strictly alone."""
    control: _Control | None = None
    """Only for policies at control level."""
    together: Together | None = None
    """Only where robots act at the same time."""
    pair: PairRecord | None = None
    """Only in the split of pairs of which one cannot be done."""
    wall_s: float = 0.0
    keeps_state: bool = False
    """Whether the policy says that it remembers other episodes."""


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
    """Return which episode a line is of: kind of instruction, task and number."""
    return row["instruction_kind"], row["task"], row["index"]


def enough(left: int | None) -> float:
    """Return how many sub-tasks are left; no number is enough where no plan exists."""
    return math.inf if left is None else left


def place_of(row: Row) -> tuple[Any, ...]:
    """Return what lines are ordered by: kind, task, number."""
    kind, task, index = key_of(row)
    return EVALUATION_KINDS.index(kind), task_rank(task), index


def older_versions(
    weights: Mapping[str, Mapping[str, Any]], benchmark: str
) -> tuple[str, ...]:
    """Return the other versions of the benchmark that weights were trained on.

    Args:
        weights: By name of the model, as in ``about.json``.
        benchmark: The version that is played.
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
        DatasetError: Its parts were trained with different seeds.
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
    """Return what decides the episodes of a result.

    Args:
        path: Folder of the result; or its lines, packed or not.

    Raises:
        DatasetError: The note is missing or damaged.
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
    """Check that a note holds what reports read of it.

    Args:
        about: Content of the file.
        path: The file.

    Raises:
        DatasetError: It does not.
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
            f"{path} is of a split that is unknown here: {found.split!r}. Known: "
            f"{', '.join(splits)}."
        )


def check_line(row: object) -> None:
    """Check that a line holds what is read of it.

    Raises:
        ValueError: It does not.
    """
    line = msgspec.convert(row, _Line)
    if line.instruction_kind not in EVALUATION_KINDS:
        raise ValueError(f"no kind of instruction: {line.instruction_kind!r}")
    if line.protocol != PROTOCOL_VERSION:
        raise ValueError(
            f"it follows protocol {line.protocol}, and this is {PROTOCOL_VERSION}"
        )
    if line.success and line.lenient is not None and not line.lenient.success:
        raise ValueError("it succeeded strictly, but not leniently")
