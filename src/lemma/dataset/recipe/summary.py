"""Statistics of recipes and of perturbed executions; states are not read."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lemma.core.files import parse_json
from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_number
from lemma.dataset.recipe.files import Recipe
from lemma.expert.disturbances import KINDS, NONE
from lemma.robots.reach import reach_of
from lemma.tasks.instance import SPLITS
from lemma.tasks.suite import SUITE

ALL = "all"
_COLUMNS = (
    *("key", "task", "split", "team", "distractors", "instance", "subtasks"),
    *("success", "elapsed_s", "idle_s"),
)


@dataclass(frozen=True, slots=True)
class Spread:
    """Range and mean of a number."""

    least: float
    mean: float
    most: float

    @classmethod
    def of(cls, numbers: Sequence[float]) -> "Spread":
        """Summarize one or more numbers."""
        found = np.array(numbers, np.float64)
        return cls(float(found.min()), float(found.mean()), float(found.max()))


@dataclass(frozen=True, slots=True)
class GroupSummary:
    """Statistics of a group of episodes."""

    episodes: int
    solved: int
    subtasks: Spread
    objects: Spread
    distractors: Spread
    elapsed_s: Spread
    """Simulated time [s]."""
    idle_share: float
    """Mean share of an episode in which a robot waits."""
    margin_m: Spread
    """Distance of the gripper's pick and place poses inside its robot's reach [m];
    negative where a robot leads a tool outside of it."""
    teams: dict[str, int]
    """Number of episodes by team."""


@dataclass(frozen=True, slots=True)
class RecipeSummary:
    """Statistics of a recipe, with groups by task, split and team."""

    total: GroupSummary
    tasks: dict[str, GroupSummary]
    splits: dict[str, GroupSummary]
    teams: dict[str, GroupSummary]
    primitives_s: dict[str, Spread]
    """Simulated duration of each primitive [s], the most frequent first."""


def summarize(recipe: Recipe) -> RecipeSummary:
    """Return the statistics of a recipe, or of a selection of one.

    Args:
        recipe: One or more episodes.

    Raises:
        DatasetError: A file is damaged.
    """
    rows = [_counted(row) for row in recipe.rows(*_COLUMNS)]
    durations: dict[str, list[float]] = {}
    for row in rows:
        for step in row["subtasks"]:
            durations.setdefault(step["primitive"], []).append(step["duration_s"])
    common = sorted(durations, key=lambda name: -len(durations[name]))
    return RecipeSummary(
        total=_group(rows),
        tasks=_groups(rows, "task", SUITE),
        splits=_groups(rows, "split", tuple(SPLITS)),
        teams=_groups(rows, "team", ()),
        primitives_s={name: Spread.of(durations[name]) for name in common},
    )


def _counted(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row with numbers of its instance added."""
    instance = parse_json(row["instance"], Path(f"the instance of {row['key']}"))
    margins = []
    for step in row["subtasks"]:
        arm, _, x, y, yaw = instance["robots"][robot_number(step["robot"])]
        for pose in (step["pick_pose"], step["place_pose"]):
            margins.append(reach_of(arm).margin(Pose2(x, y, yaw), pose[0], pose[1]))
    return {**row, "objects": len(instance["objects"]), "margins": margins}


def _groups(
    rows: Sequence[dict[str, Any]], column: str, known: Sequence[str]
) -> dict[str, GroupSummary]:
    """Return the statistics of every existing group, known names first."""
    names = sorted({row[column] for row in rows})
    names.sort(key=lambda name: known.index(name) if name in known else len(known))
    return {name: _group([r for r in rows if r[column] == name]) for name in names}


def _group(rows: Sequence[dict[str, Any]]) -> GroupSummary:
    idle = [idle_s / row["elapsed_s"] for row in rows for idle_s in row["idle_s"]]
    return GroupSummary(
        episodes=len(rows),
        solved=sum(row["success"] for row in rows),
        subtasks=Spread.of([len(row["subtasks"]) for row in rows]),
        objects=Spread.of([row["objects"] for row in rows]),
        distractors=Spread.of([row["distractors"] for row in rows]),
        elapsed_s=Spread.of([row["elapsed_s"] for row in rows]),
        idle_share=float(np.mean(idle)),
        margin_m=Spread.of([margin for row in rows for margin in row["margins"]]),
        teams=dict(sorted(Counter(row["team"] for row in rows).items())),
    )


@dataclass(frozen=True, slots=True)
class RecoveryFigures:
    """Statistics of perturbed executions."""

    episodes: int
    solved: int
    """Number of episodes that reached the goal nevertheless."""
    subtasks: int
    """Number of executed sub-tasks."""
    mistakes: dict[str, int]
    """Number of perturbed sub-tasks, by kind of perturbation."""
    keyframes: int
    """Number of keyframes with a label."""
    after: int
    """Number of keyframes with a label that follow a perturbed sub-task."""
    unlabelled: int
    """Number of keyframes without a label: no plan, a failure of the expert, or no time
    left."""


def recovery_figures(recipe: Recipe) -> RecoveryFigures:
    """Return the statistics of a recipe of perturbed executions, or of a selection.

    Args:
        recipe: The episodes; their states are not read.
    """
    rows = list(recipe.rows("success", "expert", "perturbation"))
    kinds = Counter(kind for row in rows for kind in row["perturbation"])
    labelled = after = 0
    for row in rows:
        known = [*row["expert"], None].index(None)
        mistakes = (i for i, kind in enumerate(row["perturbation"]) if kind != NONE)
        labelled += known
        after += max(0, known - 1 - next(mistakes, known))
    return RecoveryFigures(
        episodes=len(rows),
        solved=sum(row["success"] for row in rows),
        subtasks=kinds.total(),
        mistakes={kind: kinds[kind] for kind in KINDS},
        keyframes=labelled,
        after=after,
        unlabelled=sum(len(row["expert"]) for row in rows) - labelled,
    )
