"""What is in a recipe, in numbers, and whether it is balanced as it should be."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.resources import files
from typing import Any

import numpy as np

from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_number
from lemma.dataset.recipe.balance import (
    TEAM_NAMES,
    Balance,
    Evenness,
    balances_of,
    draws_of,
    evenness,
)
from lemma.dataset.recipe.reader import Recipe
from lemma.robots.reach import reach_of
from lemma.tasks.instance import SPLITS
from lemma.tasks.suite import SUITE

_COLUMNS = (
    *("task", "split", "index", "team", "distractors", "instance", "subtasks"),
    *("success", "elapsed_s", "idle_s"),
)


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """What counts of one episode."""

    task: str
    split: str
    team: str
    success: bool
    objects: int
    distractors: int
    primitives: tuple[str, ...]
    """Of every sub-task, in order."""
    durations_s: tuple[float, ...]
    """Of every sub-task, in order [s]."""
    margins_m: tuple[float, ...]
    """How far inside the reach of the robot that acts the gripper closed and opened,
    for every sub-task both [m]; negative where a tool is led outside of it."""
    elapsed_s: float
    idle_s: tuple[float, ...]
    draws: dict[str, str]
    """What was drawn and should be balanced: see
    :mod:`lemma.dataset.recipe.balance`."""


def facts_of(recipe: Recipe) -> list[EpisodeFacts]:
    """Return what counts of every episode of a recipe; states are not read."""
    return [_facts(row) for row in recipe.rows(*_COLUMNS)]


def _facts(row: dict[str, Any]) -> EpisodeFacts:
    instance, subtasks = json.loads(row["instance"]), row["subtasks"]
    return EpisodeFacts(
        task=row["task"],
        split=row["split"],
        team=row["team"],
        success=row["success"],
        objects=len(instance["objects"]),
        distractors=row["distractors"],
        primitives=tuple(subtask["primitive"] for subtask in subtasks),
        durations_s=tuple(subtask["duration_s"] for subtask in subtasks),
        margins_m=_margins(instance, subtasks),
        elapsed_s=row["elapsed_s"],
        idle_s=tuple(row["idle_s"]),
        draws=draws_of(instance),
    )


def _margins(
    instance: dict[str, Any], subtasks: list[dict[str, Any]]
) -> tuple[float, ...]:
    found = []
    for subtask in subtasks:
        number = robot_number(subtask["robot"])
        arm, _, x, y, yaw = instance["robots"][number]
        for pose in (subtask["pick_pose"], subtask["place_pose"]):
            found.append(reach_of(arm).margin(Pose2(x, y, yaw), pose[0], pose[1]))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Spread:
    """Where a number lies."""

    least: float
    mean: float
    most: float

    @classmethod
    def of(cls, numbers: Iterable[float]) -> "Spread":
        """Summarise some numbers, at least one."""
        found = np.fromiter(numbers, np.float64)
        return cls(float(found.min()), float(found.mean()), float(found.max()))


@dataclass(frozen=True, slots=True)
class GroupSummary:
    """What a group of episodes has in common, in numbers."""

    episodes: int
    solved: int
    subtasks: Spread
    objects: Spread
    distractors: Spread
    elapsed_s: Spread
    """Simulated time [s]."""
    idle_share: float
    """Mean part of an episode that a robot waits."""
    margin_m: Spread
    """See :attr:`EpisodeFacts.margins_m` [m]."""
    teams: dict[str, int]


def summarize(facts: Sequence[EpisodeFacts]) -> GroupSummary:
    """Return the numbers of a group of episodes, at least one."""
    teams = Counter(fact.team for fact in facts)
    idle = [idle / fact.elapsed_s for fact in facts for idle in fact.idle_s]
    return GroupSummary(
        episodes=len(facts),
        solved=sum(fact.success for fact in facts),
        subtasks=Spread.of(len(fact.primitives) for fact in facts),
        objects=Spread.of(fact.objects for fact in facts),
        distractors=Spread.of(fact.distractors for fact in facts),
        elapsed_s=Spread.of(fact.elapsed_s for fact in facts),
        idle_share=float(np.mean(idle)),
        margin_m=Spread.of(m for fact in facts for m in fact.margins_m),
        teams={team: teams[team] for team in TEAM_NAMES},
    )


def primitive_durations(facts: Sequence[EpisodeFacts]) -> dict[str, Spread]:
    """Return how long each primitive takes [s], the commonest first."""
    found: dict[str, list[float]] = {}
    for fact in facts:
        for name, duration_s in zip(fact.primitives, fact.durations_s, strict=True):
            found.setdefault(name, []).append(duration_s)
    common = sorted(found, key=lambda name: -len(found[name]))
    return {name: Spread.of(found[name]) for name in common}


@dataclass(frozen=True, slots=True)
class Rejections:
    """What was turned down while frozen lists were made; nothing if there are none."""

    instances: int
    by_sampler: int
    """Tables that violated the task's zones."""
    by_expert: int
    """Sampled instances that the expert did not solve as the task promises."""

    @property
    def sampler_rate(self) -> float:
        """Part of the tables that the sampler turned down."""
        tables = self.instances + self.by_sampler + self.by_expert
        return self.by_sampler / tables

    @property
    def expert_rate(self) -> float:
        """Part of the sampled instances that the expert did not solve."""
        return self.by_expert / (self.instances + self.by_expert)


def rejections(task: str, splits: Iterable[str]) -> Rejections:
    """Return what was turned down while the lists of a task were frozen."""
    source = files("lemma.tasks") / "frozen" / "manifest.json"
    manifest = json.loads(source.read_text(encoding="utf-8"))
    names = [f"{task}-{split}" for split in splits]
    entries = [manifest[name] for name in names if name in manifest]
    return Rejections(
        sum(entry["instances"] for entry in entries),
        sum(entry["rejected_by_sampler"] for entry in entries),
        sum(entry["refused_by_expert"] for entry in entries),
    )


@dataclass(frozen=True, slots=True)
class Statistics:
    """All numbers of a recipe."""

    facts: tuple[EpisodeFacts, ...]
    total: GroupSummary
    tasks: dict[str, GroupSummary]
    splits: dict[str, GroupSummary]
    teams: dict[str, GroupSummary]
    cells: dict[str, GroupSummary]
    """By task, split and team: ``"stack/test/ur5+ur10"``."""
    balances: dict[str, dict[str, Balance]]
    """By what was drawn, and then for all tasks together and by task."""
    evenness: Evenness
    primitives_s: dict[str, Spread]
    """Durations [s]."""
    rejections: dict[str, Rejections]
    """By task that has frozen lists: while those of the splits at hand were made."""

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the single episodes as plain data, ready for JSON."""
        data = {
            field.name: _plain(getattr(self, field.name))
            for field in fields(self)
            if field.name != "facts"
        }
        data["evenness"]["even"] = self.evenness.even
        for task, found in self.rejections.items():
            data["rejections"][task]["sampler_rate"] = found.sampler_rate
            data["rejections"][task]["expert_rate"] = found.expert_rate
        return data


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    return asdict(value)


def statistics_of(recipe: Recipe) -> Statistics:
    """Return all numbers of a recipe, or of a selection of one.

    Args:
        recipe: At least one episode.
    """
    facts = tuple(facts_of(recipe))
    by_task = _grouped(facts, SUITE, lambda fact: fact.task)
    balances = balances_of(
        {task: [fact.draws for fact in group] for task, group in by_task.items()}
    )
    cells = {
        f"{task}/{split}/{team}": summarize(group)
        for task, of_task in by_task.items()
        for split, of_split in _by_split(of_task).items()
        for team, group in _by_team(of_split).items()
    }
    return Statistics(
        facts=facts,
        total=summarize(facts),
        tasks=_summaries(by_task),
        splits=_summaries(_by_split(facts)),
        teams=_summaries(_by_team(facts)),
        cells=cells,
        balances=balances,
        evenness=evenness(balances),
        primitives_s=primitive_durations(facts),
        rejections={
            task: found
            for task, group in by_task.items()
            if (found := rejections(task, _by_split(group))).instances
        },
    )


_Groups = dict[str, list[EpisodeFacts]]


def _by_split(facts: Sequence[EpisodeFacts]) -> _Groups:
    return _grouped(facts, tuple(SPLITS), lambda fact: fact.split)


def _by_team(facts: Sequence[EpisodeFacts]) -> _Groups:
    return _grouped(facts, TEAM_NAMES, lambda fact: fact.team)


def _grouped(
    facts: Sequence[EpisodeFacts],
    names: Sequence[str],
    name: Callable[[EpisodeFacts], str],
) -> _Groups:
    """Return the episodes by name, known ones first; empty groups not."""
    groups: _Groups = {known: [] for known in names}
    for fact in sorted(facts, key=name):
        groups.setdefault(name(fact), []).append(fact)
    return {known: group for known, group in groups.items() if group}


def _summaries(groups: _Groups) -> dict[str, GroupSummary]:
    return {name: summarize(group) for name, group in groups.items()}
