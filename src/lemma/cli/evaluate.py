"""`lemma evaluate`: evaluation of a policy on a frozen split."""

from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from lemma.cli.options import (
    ALL,
    Arguments,
    File,
    Flag,
    JsonFlag,
    Listed,
    Number,
    SuiteName,
    Word,
    arguments,
    complain,
    output,
    print_json,
    task_names,
    words,
)
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import InvalidConfigError
from lemma.policies.interfaces import TIMEOUT_S
from lemma.policies.planners.chat import ChatOptions

if TYPE_CHECKING:
    from lemma.evaluation.analysis.rates import Cell
    from lemma.evaluation.analysis.result import Result
    from lemma.evaluation.records import Row
    from lemma.evaluation.run.config import EvaluationConfig

_COMPLAINTS = 5
_AT_INTERRUPT = (
    "{done} of {total} episodes are saved in episodes.jsonl. The same command "
    "continues from there. It repeats unfinished groups of ten episodes, because the "
    "last bits of a network's output depend on the batch."
)


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """Options of the evaluation."""

    instructions: Listed = "high-level"
    """Kinds of instructions: high-level, human, unseen, blind, relational; or all,
    which means every kind of the protocol that the tasks have, so not relational."""
    pairs: Flag = False
    """Play pairs of one table and one sentence, of which one team can do it and another
    one cannot: the right answer is then to refuse. --episodes counts two for each."""
    tasks: Listed = ALL
    """Names of tasks, separated by commas."""
    suite: SuiteName = "lemma"
    """Suite whose tasks are played unless --tasks names some."""
    split: Word = None
    """Frozen list of instances, test by default; or free, which samples instances and
    needs --episodes. For your own tasks the default is free."""
    episodes: Number = None
    """Number of episodes of every task, from the first; all by default."""
    level: Literal["auto", "plan", "skill", "control"] = "auto"
    """Kind of action. plan: sub-tasks without poses, executed with the expert's; skill:
    sub-tasks with poses; control: motor commands; auto: chosen by the policy's name."""
    acting: Literal["auto", "turns", "together"] = "auto"
    """How robots act. turns: one at a time; together: the policy gives orders to all
    free robots, so several act at once; auto: together in the suite teams, otherwise
    turns."""
    adapter: Literal["auto", "greedy", "turns"] = "auto"
    """How a sequential policy acts with --acting together. greedy: it gives orders as
    long as its next sub-task is for a free robot; turns: one sub-task at a time."""
    policy_args: Arguments = ""
    """Arguments of your own class, or the environment of a model server; values are
    numbers, true, false or text."""
    planning: Literal["single-step", "multi-step"] = "single-step"
    """single-step: observe before every sub-task; multi-step: plan all sub-tasks from
    the first observation."""
    gta: Flag = False
    """Ground-truth allocation: the correct robot replaces the planner's choice."""
    timeout_s: Annotated[float, tyro.conf.arg(name="timeout", metavar="SECONDS")] = (
        TIMEOUT_S
    )
    """Time limit for a decision of your own class or server [s]. 0: no limit; a class
    then runs in this process."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device of models of this package, with float32 on both."""
    language: Literal["full", "none", "shuffled", "swapped"] = "full"
    """Language controls. none: no sentence; shuffled: the sentence of the next
    instance; swapped: a sentence with swapped colors, so another goal."""
    instance: File = None
    """JSON file with your own instance; only this one is played."""
    perturb_start: Flag = False
    """Move objects at the start by up to 3 cm and 15 degrees."""
    disturb: Literal["no", "durations", "slow", "stops"] = "no"
    """Disturbance of robots. durations: each sub-task takes 1 to 1.86 times as long;
    slow: one robot has half the speed; stops: one robot stops for 20 s."""
    protocol: Literal["both", "strict"] = "both"
    """Verdicts. strict: the first infeasible sub-task ends an episode. both: the
    episode then continues, for the lenient verdict; one run gives both verdicts."""


@dataclass(frozen=True)
class LanguageModelOptions(ChatOptions):
    """Options of a language model, with --policy llm:MODEL."""

    cassette: File = None
    """File of recorded requests and answers; recorded requests are not sent."""


_EVERYTHING = EvaluateOptions()
NO_MODEL = LanguageModelOptions()
"""Options without a language model."""


def evaluate(
    policy: Annotated[str, tyro.conf.arg(metavar="POLICY")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    ask: Annotated[EvaluateOptions, tyro.conf.arg(name="")] = _EVERYTHING,
    working: WorkerOptions = DEFAULT,
    as_json: JsonFlag = False,
    model: Annotated[
        LanguageModelOptions, tyro.conf.arg(name=""), tyro.conf.FlagCreatePairsOff
    ] = NO_MODEL,
) -> int:
    """Play the episodes of a frozen split with a policy, and count its successes.

    Finished episodes are saved, so the same command continues an interrupted run.

    Args:
        policy: oracle; a model; PLANNER+GROUNDER; package.module:Class; a policy of
            LeRobot, lerobot:CHECKPOINT, or lerobot-privileged:CHECKPOINT if it observes
            the true state; the address of a server, http://HOST:PORT or
            vla-eval://HOST:PORT; or only a planner, llm:MODEL, greedy-reach,
            random-valid or noisy-oracle:0.1, with the expert's poses.
        out: Folder of the result: one line per episode in episodes.jsonl, counts and
            causes of failure in summary.json.
        ask: Options of the evaluation.
        working: Options of the workers.
        as_json: Print one JSON object instead of a table.
        model: Options of a language model.
    """
    # Import late, so that help is fast.
    from lemma.evaluation.analysis.result import summarise
    from lemma.evaluation.protocol.rules import NAME, deviations
    from lemma.evaluation.records import SUMMARY, read_about
    from lemma.evaluation.report.pair_table import pair_table
    from lemma.evaluation.report.tables import rates
    from lemma.evaluation.report.team_table import team_tables
    from lemma.evaluation.run.evaluate import evaluate as run

    config = _config(policy, out, ask, model)
    for deviation in deviations():
        complain(
            f"This deviates from protocol {NAME}, as the result states: {deviation}."
        )
    with progress_bar("evaluate", config.total, _AT_INTERRUPT) as advance:
        rows = run(config, working.make_engine(), advance)
    result = summarise(rows, read_about(out), config.command())
    result.write(out / SUMMARY)
    complain_of(rows)
    teams = result.teams
    if as_json:
        more: dict[str, Any] = {"teams": teams, "pairs": result.pairs}
        listed = {k: [asdict(one) for one in v] for k, v in more.items() if v}
        print_json(_rates(result.cells, config.kinds) | listed)
    elif result.pairs:
        output().print(pair_table((p.kind, p) for p in result.pairs).terminal())
    else:
        output().print(rates(result.cells).terminal())
        for table in team_tables(teams).values():
            output().print("", table.terminal(), sep="\n")
        for line in effort_lines(result):
            output().print(line)
    return 0


def _config(
    policy: str, out: Path, ask: EvaluateOptions, model: ChatOptions
) -> "EvaluationConfig":
    """Return the configuration for the options."""
    from lemma.evaluation.evaluation import named_at, usual_split
    from lemma.evaluation.run.config import EvaluationConfig, acting_by_default
    from lemma.policies.spec import PolicySpec
    from lemma.tasks.instance import OWN_SPLIT, Instance
    from lemma.tasks.language.blind import kinds_of
    from lemma.tasks.teams.pairs import PAIR_TASK, PAIRS

    own = Instance.load(ask.instance) if ask.instance else None
    tasks = task_names(ask.tasks, ask.suite)
    if ask.pairs:
        if ask.instance or ask.split or ask.tasks != ALL:
            raise InvalidConfigError(
                "Pairs have tables of their own. Use --pairs without --tasks, --split "
                "and --instance."
            )
        tasks, split = (PAIR_TASK,), PAIRS
    elif own is not None and ask.tasks == ALL:
        tasks, split = (own.task,), OWN_SPLIT
    else:
        split = usual_split(tasks)
    split = ask.split or split
    asks_model = model != NO_MODEL or policy.startswith("llm:")
    chat = model if asks_model else None
    spec = PolicySpec(
        policy if ask.level == "control" else named_at(policy, ask.level),
        *(ask.planning, ask.gta, ask.timeout_s, chat),
        level="control" if ask.level == "control" else "",
        arguments=arguments(ask.policy_args),
        device=ask.device,
    )
    acting = acting_by_default(tasks, controls=spec.controls)
    spec = replace(
        spec,
        acting=acting if ask.acting == "auto" else ask.acting,
        adapter="" if ask.adapter == "auto" else ask.adapter,
    )
    return EvaluationConfig(
        out=out,
        policy=spec,
        tasks=tasks,
        split=split,
        kinds=words(ask.instructions.replace("-", "_"), every=kinds_of(tasks, split)),
        episodes=ask.episodes,
        language=ask.language,
        perturb_start=ask.perturb_start,
        disturb="" if ask.disturb == "no" else ask.disturb,
        verdicts=ask.protocol,
        instance=own,
    )


def effort_lines(result: "Result") -> list[str]:
    """Return a language model's numbers of calls, tokens and errors, as text."""
    planning = result.planning
    if not planning:
        return []
    invalid: Counter[str] = Counter()
    for each in planning:
        invalid.update(each.invalid)
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(invalid.items()))
    able = sum(each.able for each in result.coordination)
    doable = sum(each.doable for each in result.coordination)
    return [
        f"{sum(each.decisions for each in planning)} decisions, "
        f"{sum(each.calls for each in planning)} calls, "
        f"{sum(each.prompt_tokens for each in planning):,} tokens of prompts, "
        f"{sum(each.completion_tokens for each in planning):,} of answers",
        f"{invalid.total()} invalid answers{f' ({kinds})' if kinds else ''}, "
        f"{sum(each.replans for each in planning)} replans, {able} of {doable} "
        "sub-tasks for a robot that can do them",
    ]


def complain_of(rows: "list[Row]") -> None:
    """Report the episodes that failed because of an error of the policy."""
    faulty = [row for row in rows if row.get("policy_error")]
    if not faulty:
        return
    for row in faulty[:_COMPLAINTS]:
        error = row["policy_error"]
        complain(
            f"{row['task']} {row['index']}: {error['kind']}: {error['explanation']}"
        )
    complain(
        f"{len(faulty)} of {len(rows)} episodes failed because of an error of the "
        "policy (policy_error in episodes.jsonl)."
    )


def _rates(
    cells: "tuple[Cell, ...]", kinds: tuple[str, ...]
) -> dict[str, dict[str, dict[str, Any]]]:
    """Return success rates by kind of instruction and task, ready for JSON."""
    from lemma.evaluation.analysis.rates import leniently, rates_by

    strict = rates_by(cells, "kind", "task")
    lenient = rates_by(leniently(cells), "kind", "task")
    found: dict[str, dict[str, dict[str, Any]]] = {kind: {} for kind in kinds}
    for (kind, task), rate in strict.items():
        later = lenient.get((kind, task))
        found[kind][task] = asdict(rate) | {
            "success_rate": rate.success_rate,
            "lenient_success_rate": later.success_rate if later else None,
        }
    return found
