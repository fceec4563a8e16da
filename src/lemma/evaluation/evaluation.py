"""`lemma.evaluate`: a policy that is an object, or a name, on a frozen split."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.core.workers.pool import Engine, ProcessPool
from lemma.core.workers.serial import Serial
from lemma.evaluation.analysis.result import Result, summarise
from lemma.evaluation.records import SUMMARY, Row, read_about
from lemma.evaluation.report.success_tables import rates
from lemma.evaluation.report.tables import markdown
from lemma.evaluation.run.evaluate import VERDICTS, EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate as play
from lemma.policies.spec import LEVELS, ORACLE, PLANNINGS, GivenPolicy, PolicySpec
from lemma.tasks.suite import FREE_SPLIT, SUITE, has_frozen_lists


@dataclass(frozen=True)
class Evaluation:
    """What a policy made of some episodes; printed, it is a table."""

    result: Result
    """Counts, causes of failure, and what decided them."""
    rows: tuple[Row, ...]
    """One line for each episode, as in ``episodes.jsonl``; docs/evaluation.md says what
    is in it."""

    @property
    def success_rate(self) -> float:
        """Strict successes, of all episodes, in [0, 1]."""
        return sum(bool(row["success"]) for row in self.rows) / len(self.rows)

    @property
    def errors(self) -> tuple[str, ...]:
        """What the policy did wrong: it raised, hung, or answered no decision."""
        return tuple(
            f"{row['task']} {row['index']}: {row['policy_error']['explanation']}"
            for row in self.rows
            if row["policy_error"]
        )

    def __str__(self) -> str:
        """Return success rates [%] by task and kind of instruction, in Markdown."""
        told = markdown(rates(self.result.cells))
        if self.errors:
            told += (
                f"\n{len(self.errors)} of {len(self.rows)} episodes failed because the "
                f"policy did. The first: {self.errors[0]}\n"
            )
        return told


def evaluate(  # noqa: PLR0913 - by name, most have a default
    policy: Any,
    *,
    level: str = "",
    tasks: Sequence[str] = SUITE,
    split: str = "",
    kinds: Sequence[str] = ("high_level",),
    episodes: int | None = None,
    planning: str = PLANNINGS[0],
    gta: bool = False,
    protocol: str = VERDICTS[0],
    out: str | Path | None = None,
    workers: int = 1,
) -> Evaluation:
    """Let a policy play the episodes of a frozen split, and count its successes.

    Args:
        policy: An object with ``act(inputs)``, or a planner with ``plan(inputs)``; see
            :mod:`lemma.policies.interfaces`. Or a name, as ``lemma evaluate --policy``
            takes it.
        level: ``"skill"``: it decides with poses; ``"plan"``: in symbols, and the
            expert adds the poses. By default what the object can do; a name is of a
            policy at skill level.
        tasks: Names of tasks.
        split: Frozen list of instances, ``"test"``; or ``"free"``, which samples them:
            the default with tasks of your own.
        kinds: Of instructions: ``"high_level"``, ``"human"``, ``"unseen"``,
            ``"blind"``.
        episodes: Only the first so many of every task; split ``"free"`` needs it.
        planning: ``"single-step"``, or ``"multi-step"``: from the first image alone.
        gta: Ground-truth allocation: the right robot replaces the planner's choice.
        protocol: ``"both"`` verdicts, or ``"strict"`` alone.
        out: Folder that keeps lines and summary, as ``lemma evaluate --out`` does; what
            is there already is not played again. None: nothing is kept.
        workers: Processes that play; more than one only with a name.

    Returns:
        The lines of all episodes, and what they count.

    Raises:
        LemmaError: There is no such policy, task, split or kind, or it is none.
    """
    spec, engine = _policy(policy, level, planning, gta=gta, workers=workers)
    frozen = all(map(has_frozen_lists, tasks))
    with TemporaryDirectory() as nowhere:
        config = EvaluationConfig(
            out=Path(out or nowhere),
            policy=spec,
            tasks=tuple(tasks),
            split=split or ("test" if frozen else FREE_SPLIT),
            kinds=tuple(kinds),
            episodes=episodes,
            verdicts=protocol,
        )
        rows = play(config, engine)
        result = summarise(rows, read_about(config.out), config.command())
        if out is not None:
            result.write(config.out / SUMMARY)
    return Evaluation(result, tuple(rows))


def _policy(
    policy: Any, level: str, planning: str, *, gta: bool, workers: int
) -> tuple[PolicySpec, Engine]:
    """Return what to play, and where."""
    if level:
        known("level", level, LEVELS)
    if isinstance(policy, str):
        name = f"{policy}+{ORACLE}" if level == LEVELS[0] else policy
        engine: Engine = ProcessPool(workers) if workers > 1 else Serial()
        return PolicySpec(name, planning, gta), engine
    if workers > 1:
        raise InvalidConfigError(
            f"An object plays in this process, not in {workers} others. Leave out "
            "workers, or give the policy as a name, such as package.module:Class."
        )
    return GivenPolicy.of(policy, level, planning, gta=gta), Serial()
