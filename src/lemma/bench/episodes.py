"""The figures of `lemma bench` about whole episodes: the expert's, and a policy's."""

import statistics
import time
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from lemma.bench.speed import Figures
from lemma.core.workers.pool import ProcessPool, run_in_order
from lemma.core.workers.resources import peak_memory_mb
from lemma.evaluation.run.rollout import Player, Rollout
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, TASKS, load_instance
from lemma.viz.recording import record


class Trial(NamedTuple):
    """One instance that the expert worked on."""

    task: str
    fresh: bool
    """Whether it was sampled for this, or comes from a frozen list."""
    success: bool
    simulated_s: float
    rejected: int
    """Tables that the sampler refused before it."""


def run_trials(tasks: Iterable[str], episodes: int, workers: int) -> Iterator[Trial]:
    """Let the expert work on frozen and on fresh instances, in several processes.

    Args:
        tasks: Names of the tasks.
        episodes: Instances per task and kind.
        workers: Processes.

    Yields:
        The trials, in a fixed order.
    """
    jobs = [
        (task, fresh, index)
        for task in tasks
        for fresh in (False, True)
        for index in range(episodes)
    ]
    yield from run_in_order(ProcessPool(workers), _run_trial, jobs)


def _run_trial(task: str, fresh: bool, index: int) -> Trial:
    """Let the expert work on an instance: a new one, or one of the frozen list."""
    rejected = 0
    if fresh:
        drawn = sample(TASKS[task], FREE_SPLIT, index)
        instance, rejected = drawn.instance, drawn.rejected
    else:
        instance = load_instance(task, "test", index)
    done = record(instance)
    return Trial(task, fresh, done.success, done.elapsed_s, rejected)


def expert_figures(trials: Iterable[Trial]) -> dict[str, Figures]:
    """Return the figures of every task that occurs in the trials."""
    by_task: dict[str, tuple[list[Trial], list[Trial]]] = {}
    for trial in trials:
        by_task.setdefault(trial.task, ([], []))[trial.fresh].append(trial)
    figures: dict[str, Figures] = {}
    for task, (frozen, fresh) in by_task.items():
        refused = sum(trial.rejected for trial in fresh)
        figures[task] = {
            "episodes": len(frozen),
            "success_rate": statistics.fmean(trial.success for trial in frozen),
            # Before any filter that keeps only instances that the expert solves.
            "raw_success_rate": statistics.fmean(trial.success for trial in fresh),
            "mean_sim_s": statistics.fmean(trial.simulated_s for trial in frozen),
            "max_sim_s": max(trial.simulated_s for trial in frozen),
            "rejection_rate": refused / (refused + len(fresh)),
        }
    return figures


def measure_policy(name: str, instances: list[Instance]) -> Figures:
    """Let a policy play, one episode at a time, and time what it does.

    Args:
        name: Name of the policy, as ``--policy`` takes it.
        instances: Episodes to play; the first also warms up.

    Raises:
        LemmaError: There is no such policy.
    """
    player = Player.load(PolicySpec(name))
    _play(player, instances[0])
    looks, decisions, successes = [], [], 0
    for instance in instances:
        play, times = _play(player, instance)
        looks += [look for look, _ in times]
        decisions += [decide for _, decide in times]
        successes += play.success
    decisions.sort()
    return {
        "decisions": len(decisions),
        "look_ms": 1000.0 * statistics.median(looks) if player.rig else 0.0,
        "decision_ms": 1000.0 * statistics.median(decisions),
        "slowest_ms": 1000.0 * decisions[int(0.95 * (len(decisions) - 1))],
        "success_rate": successes / len(instances),
        "peak_mb": next(ProcessPool(1).run(_peak_mb, [(name, instances[-1])])),
    }


def _play(
    player: Player, instance: Instance
) -> tuple[Rollout, list[tuple[float, float]]]:
    """Play an episode; return it, and seconds to look and to decide of every step."""
    play, times = Rollout(instance), []
    while not play.episode.is_over:
        start = time.perf_counter()
        given = play.given(player.rig, player.policy)
        seen = time.perf_counter()
        (decision,) = player.policy.act([given])
        times.append((seen - start, time.perf_counter() - seen))
        play.take(given, decision)
    return play, times


def _peak_mb(policy: str, instance: Instance) -> float:
    _play(Player.load(PolicySpec(policy)), instance)
    return peak_memory_mb()
