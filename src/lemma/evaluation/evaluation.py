"""`lemma.evaluate`: evaluate a policy, as an object or by name, on a frozen split."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lemma.core.arguments import known, whole
from lemma.core.errors import InvalidConfigError
from lemma.core.files import temporary_folder
from lemma.core.workers.pool import Engine, ProcessPool, Serial
from lemma.evaluation.analysis.result import Result, summarise
from lemma.evaluation.records import ABOUT, SUMMARY, Row, read_about
from lemma.evaluation.report.tables import rates
from lemma.evaluation.report.team_table import team_tables
from lemma.evaluation.run.config import (
    VERDICTS,
    EvaluationConfig,
    acting_by_default,
)
from lemma.evaluation.run.evaluate import evaluate as play
from lemma.policies.control.interfaces import has_options
from lemma.policies.planners.registry import is_planner
from lemma.policies.policy_object import PolicyObjectSpec
from lemma.policies.spec import (
    CONTROL,
    LEVELS,
    ORACLE,
    PLANNINGS,
    PolicySpec,
    parts_of,
)
from lemma.tasks.suite import FREE_SPLIT, SUITE, has_frozen_lists


@dataclass(frozen=True)
class Evaluation:
    """Result of a policy on some episodes; prints as a table."""

    result: Result
    """Counts, causes of failure, and settings."""
    rows: tuple[Row, ...]
    """One line for each episode, as in ``episodes.jsonl``; see docs/evaluation.md."""

    @property
    def success_rate(self) -> float:
        """Strict success rate over all episodes, in [0, 1]."""
        return sum(bool(row["success"]) for row in self.rows) / len(self.rows)

    @property
    def errors(self) -> tuple[str, ...]:
        """Faults of the policy: exceptions, timeouts and invalid decisions."""
        return tuple(
            f"{row['task']} {row['index']}: {row['policy_error']['explanation']}"
            for row in self.rows
            if row["policy_error"]
        )

    def __str__(self) -> str:
        """Return success rates [%] by task and kind of instruction, in Markdown.

        If robots act together, also return their use of time.
        """
        text = rates(self.result.cells).markdown()
        for table in team_tables(self.result.teams).values():
            text += f"\n{table.markdown()}"
        if self.errors:
            text += (
                f"\n{len(self.errors)} of {len(self.rows)} episodes failed because the "
                f"policy did. The first: {self.errors[0]}\n"
            )
        return text


def evaluate(  # noqa: PLR0913 - by name, most have a default
    policy: Any,
    *,
    level: str = "",
    tasks: str | Sequence[str] = SUITE,
    split: str = "",
    kinds: str | Sequence[str] = "high_level",
    episodes: int | None = None,
    planning: str = PLANNINGS[0],
    gta: bool = False,
    protocol: str = VERDICTS[0],
    acting: str = "",
    adapter: str = "",
    out: str | Path | None = None,
    workers: int = 1,
) -> Evaluation:
    """Evaluate a policy on a split, and count its successes.

    Args:
        policy: An object with ``act(inputs)``, or a planner with ``plan(inputs)``; see
            :mod:`lemma.policies.interfaces`. Or a name, as for ``lemma evaluate
            --policy``.
        level: ``"skill"``: decisions have poses; ``"plan"``: decisions are symbolic,
            and the expert adds the poses; ``"control"``: motor commands, see
            :mod:`lemma.policies.control.interfaces`. By default the level that the
            policy supports; an object with ``control_options`` acts at control level.
        tasks: Name of a task, or names.
        split: Frozen list of instances, ``"test"``; or ``"free"``, which samples them:
            the default with tasks of your own.
        kinds: Instructions: ``"high_level"``, ``"human"``, ``"unseen"``, ``"blind"``,
            ``"relational"``.
        episodes: Only the first so many of every task; split ``"free"`` needs it.
        planning: ``"single-step"``: look before every sub-task; or ``"multi-step"``:
        plan once, from the first image.
        gta: Ground-truth allocation: the right robot replaces the planner's choice.
        protocol: ``"both"`` verdicts, or ``"strict"`` alone.
        acting: ``"turns"``, or ``"together"``: several robots at the same time, which
            is the default in tasks of the suite ``teams``; see
            :mod:`lemma.policies.together.interfaces`.
        adapter: How a sequential policy acts together: ``"greedy"`` or ``"turns"``.
        out: Folder for lines and summary, as in ``lemma evaluate --out``; or None. A
            policy with a name resumes there; an object needs a new folder.
        workers: Number of processes; more than one only for a policy with a name.

    Returns:
        The lines of all episodes, and their counts.

    Raises:
        LemmaError: There is no such policy, task, split or kind, or the object is no
        policy.
    """
    tasks, kinds = _names(tasks), _names(kinds)
    ways = {"acting": acting, "adapter": adapter}
    spec, engine = _policy(policy, level, planning, gta, workers, tasks, ways)
    _check_folder(out, spec)
    asked = {"policy": spec, "tasks": tasks, "split": split or usual_split(tasks)}
    asked |= {"kinds": kinds, "episodes": episodes, "verdicts": protocol}
    return _evaluated(asked, engine, out)


def _evaluated(
    asked: dict[str, Any], engine: Engine, out: str | Path | None
) -> Evaluation:
    """Run the evaluation, in a temporary folder if none is given."""
    with temporary_folder() as nowhere:
        config = EvaluationConfig(out=Path(out or nowhere), **asked)
        rows = play(config, engine)
        result = summarise(rows, read_about(config.out), config.command())
        if out is not None:
            result.write(config.out / SUMMARY)
    return Evaluation(result, tuple(rows))


def _names(names: str | Sequence[str]) -> tuple[str, ...]:
    """Return one or several names as a tuple."""
    return (names,) if isinstance(names, str) else tuple(names)


def _check_folder(out: str | Path | None, spec: PolicySpec) -> None:
    """Refuse to resume the result of an unknown object.

    Raises:
        InvalidConfigError: An object plays into a folder that holds a result.
    """
    if out is None or not isinstance(spec, PolicyObjectSpec):
        return
    if (Path(out) / ABOUT).exists():
        raise InvalidConfigError(
            f"{out} already has a result, which may be of another object. Choose a new "
            "folder; only a policy with a name can resume."
        )


def usual_split(tasks: Sequence[str]) -> str:
    """Return the default split of tasks."""
    return "test" if all(map(has_frozen_lists, tasks)) else FREE_SPLIT


def _policy(
    policy: Any,
    level: str,
    planning: str,
    gta: bool,
    workers: int,
    tasks: Sequence[str],
    ways: dict[str, str],
) -> tuple[PolicySpec, Engine]:
    """Return the policy's spec, and the engine that runs it."""
    workers = whole("workers", workers, 1)
    if level:
        known("level", level, LEVELS)
    if isinstance(policy, str):
        name = policy if level == CONTROL else named_at(policy, level)
        engine: Engine = ProcessPool(workers) if workers > 1 else Serial()
        own = level if level == CONTROL else ""
        spec = PolicySpec(name, planning, gta, level=own)
        acting = ways["acting"] or acting_by_default(tasks, controls=spec.controls)
        return replace(spec, acting=acting, adapter=ways["adapter"]), engine
    if workers > 1:
        raise InvalidConfigError(
            f"A policy object runs in this process, not in {workers} workers. Leave "
            "out workers, or pass the policy's name, such as package.module:Class."
        )
    controls = level == CONTROL or (not level and has_options(policy))
    acting = ways["acting"] or acting_by_default(tasks, controls=controls)
    ways = {**ways, "acting": acting}
    return PolicyObjectSpec.of(policy, level, planning, gta=gta, **ways), Serial()


def named_at(policy: str, level: str) -> str:
    """Return the name of a policy at a level.

    Args:
        policy: Its name.
        level: ``"plan"`` or ``"skill"``; anything else for the level that it supports.

    Raises:
        InvalidConfigError: The policy decides at the other level.
    """
    if level == LEVELS[0]:
        if len(parts_of(policy)) > 1:
            raise InvalidConfigError(
                f"{policy} has a grounder, so its decisions have poses. Name the "
                'planner alone, or use level="skill".'
            )
        return f"{policy}+{ORACLE}"
    if level == LEVELS[1] and is_planner(policy):
        raise InvalidConfigError(
            f"{policy} is a planner, and its decisions have no poses. Add a grounder, "
            f'as in {policy}+cliport, or use level="plan".'
        )
    return policy
