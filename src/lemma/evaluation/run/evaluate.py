"""Evaluation of a policy on a split: one JSON line per episode, resumable.

Episodes are played in groups of fixed composition, because a network's last bits depend
on the other samples of its batch. A killed run has written complete groups; an
interrupted run also keeps finished episodes of incomplete groups. A resumed run plays
incomplete groups again, so its result equals that of an uninterrupted run.
"""

import sys
from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache
from math import inf
from multiprocessing import parent_process
from pathlib import Path
from shutil import rmtree
from time import perf_counter
from typing import Any

from lemma.core.files import only_writer, read_json
from lemma.core.workers.pool import Engine, report
from lemma.core.workers.resumable import PARTS, Part, begin, do_missing, has_parts
from lemma.evaluation.lines import read_lines, read_rows, write_rows
from lemma.evaluation.protocol.disturbances import disturb
from lemma.evaluation.protocol.expert_times import expert_s, perturbed_start
from lemma.evaluation.protocol.language_controls import control_of
from lemma.evaluation.protocol.rules import check_protocol
from lemma.evaluation.records import (
    ABOUT,
    EPISODES,
    PROTOCOL_VERSION,
    STATE,
    EpisodeKey,
    Row,
    key_of,
    place_of,
)
from lemma.evaluation.run.config import VERDICTS, EvaluationConfig
from lemma.evaluation.run.control import load_player
from lemma.evaluation.run.expert_feedback import count_steps
from lemma.evaluation.run.loading import hang_up
from lemma.evaluation.run.pairs import pair_fields
from lemma.evaluation.run.rollout import Player, Rollout, Verdict, roll_out, subtasks_of
from lemma.policies.interfaces import keeps_state
from lemma.policies.policy_object import PolicyObjectSpec
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.suite import load_instance


def evaluate(
    config: EvaluationConfig,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> list[Row]:
    """Play missing episodes, and write the result.

    Args:
        config: Options of the evaluation.
        engine: Workers that run the jobs.
        advance: Called with the number of existing episodes at the beginning, and then
            with 1 for each finished episode.

    Returns:
        The lines of all episodes, in the order of kinds, tasks and indices.

    Raises:
        DatasetError: A file cannot be written, or the folder has a result of another
            policy or version.
    """
    about = config.about()
    with only_writer(config.out):
        note = config.out / ABOUT
        if note.exists() and has_parts(config.out, ABOUT):
            found = read_json(note)
            check_protocol(about, found, "This command", config.out)
        begin(config.out, ABOUT, about)
        parts = (config.out / PARTS).absolute()
        done = {key_of(row): row for row in read_rows(config.out)}
        groups = []
        wanted: set[EpisodeKey] = set()
        for kind, task, indices in config.groups():
            path = parts / f"{kind}-{task}-{indices.start}-{indices.stop}.jsonl"
            keys = {(kind, task, index) for index in indices}
            there = keys <= done.keys()
            wanted |= keys
            job = (config, kind, task, indices, path)
            groups.append(Part(job, len(indices), there or path.exists()))
        ended: dict[EpisodeKey, Row] = {}

        def take(row: Row) -> None:
            # After the death of a worker its episodes are reported twice.
            if key_of(row) not in ended:
                advance(1)
            ended[key_of(row)] = row

        try:
            for _ in do_missing(groups, play_group, engine, advance, take):
                pass
        finally:
            done = ended | done
            for path in sorted(parts.glob("*.jsonl")):
                done.update((key_of(row), row) for row in read_lines(path))
            rows = sorted(done.values(), key=place_of)
            write_rows(config.out / EPISODES, rows)
            rmtree(parts, ignore_errors=True)
    return [row for row in rows if key_of(row) in wanted]


def start_of(row: Row, about: Mapping[str, Any] | None = None) -> Instance:
    """Return the instance of a line's episode, with its perturbed start if any.

    Args:
        row: A line of ``episodes.jsonl``.
        about: Settings, as in ``about.json``, which have a user's own instance.
    """
    own = (about or {}).get("instance")
    if own is not None:
        return Instance.from_dict(own)
    instance = load_instance(row["task"], row["split"], row["index"])
    return perturbed_start(instance) if row.get("perturb_start") else instance


def play_group(
    config: EvaluationConfig, kind: str, task: str, indices: range, path: Path
) -> None:
    """Play a group of episodes, report each at its end, and write all lines.

    Args:
        config: Options of the evaluation.
        kind: Kind of instruction.
        task: Name of the task.
        indices: Indices of the episodes.
        path: File of the lines.
    """
    player = _player(config, kind)
    kept = {"keeps_state": True} if keeps_state(player.policy) else {}
    rollouts = []
    for index in indices:
        instance = config.instance or load_instance(task, config.split, index)
        if config.perturb_start:
            instance = perturbed_start(instance)
        control = control_of(config.language, instance, kind)
        rollouts.append(player.begin(instance, kind, control))
        if config.disturb:
            disturb(rollouts[-1].episode, config.disturb)
    rows: list[Row] = []
    start = perf_counter()
    lenient = config.verdicts == VERDICTS[0]
    for rollout in roll_out(rollouts, player, len(rollouts), lenient=lenient):
        wall_s = (perf_counter() - start) / (len(rows) + 1)
        line = line_of(rollout, moved=config.perturb_start, lenient=lenient)
        rows.append({**line, **kept, "wall_s": round(wall_s, 3)})
        report(rows[-1])
    # The episodes share the wall time of the group.
    even = [{**row, "wall_s": rows[-1]["wall_s"]} for row in rows]
    write_rows(path, sorted(even, key=place_of))


@cache
def _playing() -> list[tuple[PolicySpec, str, Player]]:
    """Return the list with the policy of this process and its kind of instruction.

    It is a function, because a policy could reach a variable of the module, and from
    there the cameras and the true state.
    """
    return []


def _player(config: EvaluationConfig, kind: str) -> Player:
    """Return the policy of this process, a new one for each kind of instruction.

    All kinds are played in the same scenes, so memory of one kind would help with the
    next. A policy with ``keeps_state = True`` is kept.

    Args:
        config: Options of the evaluation. Loading takes long, so one policy plays all
            episodes of a kind.
        kind: Kind of instruction.
    """
    spec, playing = config.policy, _playing()
    if playing:
        last, its_kind, player = playing[0]
        if last == spec and (kind == its_kind or keeps_state(player.policy)):
            return player
        playing.clear()
        if not isinstance(last, PolicyObjectSpec):
            hang_up(player.policy)
    if isinstance(spec, PolicyObjectSpec) and len(config.kinds) > 1:
        spec.renew()
    player = load_player(spec)
    if parent_process() is not None and "torch" in sys.modules:
        # One thread, because there is a process per core.
        sys.modules["torch"].set_num_threads(1)
    playing.append((spec, kind, player))
    return player


def line_of(rollout: Rollout, *, moved: bool, lenient: bool) -> Row:
    """Return the line of a finished episode.

    Args:
        rollout: The episode.
        moved: Whether it began at the perturbed start of its instance.
        lenient: Whether the line has a lenient verdict.
    """
    instance = rollout.instance
    end = rollout.verdict()
    strict = rollout.protective_stop or end
    subtasks = subtasks_of(rollout.steps)
    strict_subtasks, further = subtasks[: strict.steps], subtasks[strict.steps :]
    asks = rollout.control.asks
    least_m = strict.clearance_m
    place = instance.task, instance.split, instance.index
    planning = planning_of(rollout, range(strict.asked))
    later = planning_of(rollout, range(strict.asked, end.asked))
    return {
        "protocol": PROTOCOL_VERSION,
        "benchmark": BENCHMARK_VERSION,
        "task": instance.task,
        "split": instance.split,
        "index": instance.index,
        "team": instance.team,
        "distractors": len(instance.distractors),
        "perturb_start": moved,
        "instruction_kind": rollout.kind,
        "instruction": rollout.instruction,
        "asked": None if asks is None else [list(pair) for pair in asks],
        **_judged(strict),
        "idle_s": {name: round(idle, 3) for name, idle in strict.idle_s.items()},
        "coordination": {
            "expert_s": expert_s(*place, perturbed_start=moved),
            **count_steps(strict_subtasks, strict.left),
            "clearance_mm": round(1000.0 * least_m, 1) if least_m < inf else None,
        },
        "subtasks": strict_subtasks,
        "left": strict.left,
        **rollout.fields(strict),
        **pair_fields(rollout),
        **planning,
        "lenient": {**_judged(end), "subtasks": further, **later} if lenient else None,
    }


def planning_of(rollout: Rollout, decisions: range) -> dict[str, Any]:
    """Return the effort of some decisions; empty if the policy does not count it.

    A decision after a sub-task that was not carried out is a replan.

    Args:
        rollout: The episode.
        decisions: Numbers of the decisions, from 0.
    """
    efforts = [rollout.efforts[number] for number in decisions]
    if not efforts:
        return {}
    invalid = Counter(kind for effort in efforts for kind in effort.invalid)
    return {
        "planning": {
            "decisions": len(efforts),
            "calls": sum(effort.calls for effort in efforts),
            "prompt_tokens": sum(effort.prompt_tokens for effort in efforts),
            "completion_tokens": sum(effort.completion_tokens for effort in efforts),
            "invalid": dict(sorted(invalid.items())),
            "replans": rollout.replans(decisions),
        }
    }


def _judged(verdict: Verdict) -> dict[str, Any]:
    return {
        "success": verdict.success,
        "progress": verdict.progress,
        "goal_progress": verdict.goal_progress,
        "stages": verdict.stages,
        "failure": verdict.failure,
        "policy_error": verdict.fault.to_dict() if verdict.fault else None,
        "asked_holds": verdict.asked_holds,
        "elapsed_s": round(verdict.elapsed_s, 3),
        STATE: verdict.state_sha256,
    }
