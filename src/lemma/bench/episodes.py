"""Measurements of `lemma bench` over episodes of the expert and of a policy."""

import statistics
import time
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from lemma.bench.speed import Figures, median_times_s
from lemma.core.seeding import ordered_sum
from lemma.core.workers.pool import ProcessPool, run_in_order
from lemma.core.workers.resources import peak_memory_mb
from lemma.env.episode import Episode
from lemma.evaluation.run.rollout import Player, Rollout
from lemma.evaluation.run.watches import ClearanceWatch
from lemma.expert.expert import solve
from lemma.expert.together import solve_together
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, TASKS, load_instance
from lemma.viz.recording import record


class Trial(NamedTuple):
    """One episode of the expert."""

    task: str
    fresh: bool
    """Whether the instance is newly sampled, or from a frozen list."""
    success: bool
    simulated_s: float
    rejected: int
    """Number of candidates that the sampler rejected before it."""


def run_trials(tasks: Iterable[str], episodes: int, workers: int) -> Iterator[Trial]:
    """Run the expert on frozen and on fresh instances, in several processes.

    Args:
        tasks: Names of the tasks.
        episodes: Number of instances per task and kind.
        workers: Number of processes.

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
    """Run the expert on a fresh instance, or on one of the frozen list."""
    rejected = 0
    if fresh:
        drawn = sample(TASKS[task], FREE_SPLIT, index)
        instance, rejected = drawn.instance, drawn.rejected
    else:
        instance = load_instance(task, "test", index)
    done = record(instance)
    return Trial(task, fresh, done.success, done.elapsed_s, rejected)


def expert_figures(trials: Iterable[Trial]) -> dict[str, Figures]:
    """Return the figures of each task in the trials."""
    by_task: dict[str, tuple[list[Trial], list[Trial]]] = {}
    for trial in trials:
        by_task.setdefault(trial.task, ([], []))[trial.fresh].append(trial)
    figures: dict[str, Figures] = {}
    for task, (frozen, fresh) in by_task.items():
        refused = sum(trial.rejected for trial in fresh)
        figures[task] = {
            "episodes": len(frozen),
            "success_rate": statistics.fmean(trial.success for trial in frozen),
            # Without the filter that keeps only instances that the expert solves.
            "raw_success_rate": statistics.fmean(trial.success for trial in fresh),
            "mean_sim_s": statistics.fmean(trial.simulated_s for trial in frozen),
            "max_sim_s": max(trial.simulated_s for trial in frozen),
            "rejection_rate": refused / (refused + len(fresh)),
        }
    return figures


def measure_policy(name: str, instances: list[Instance]) -> Figures:
    """Measure the times and the memory of a policy, one episode at a time.

    Args:
        name: Name of the policy, as for ``--policy``.
        instances: Episodes to play; the first one is played once more, as a warm-up.

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
    """Play an episode; return it, and the times to observe and to decide [s]."""
    play, times = Rollout(instance), []
    while not play.episode.is_over:
        start = time.perf_counter()
        policy_input = play.policy_input(player.rig, player.policy)
        seen = time.perf_counter()
        (decision,) = player.policy.act([policy_input])
        times.append((seen - start, time.perf_counter() - seen))
        play.take(policy_input, decision)
    return play, times


def _peak_mb(policy: str, instance: Instance) -> float:
    _play(Player.load(PolicySpec(policy)), instance)
    return peak_memory_mb()


PARALLEL_TASKS = ("pass2", "stack2")
"""Tasks whose plans have independent sub-tasks."""


def measure_together(instances: Iterable[Instance], turns: int = 3) -> Figures:
    """Measure makespans, waiting and speed of robots that act together.

    Args:
        instances: Instances of one task.
        turns: Number of timings of the loop, on the first instance.

    Returns:
        Success rates, and means over the instances that were solved in turns and
        together; ``lemma bench`` describes them. Where robots cannot act in turns,
        there is nothing to compare with.
    """
    instances = list(instances)
    solved, both, waited, retreats, deadlocks, least_m = 0, [], [], 0, 0, np.inf
    for instance in instances:
        alone, episode = Episode(instance), Episode(instance)
        watch = ClearanceWatch(episode.simulation)
        in_turns = instance.goal.in_turns
        for _ in solve(alone) if in_turns else ():
            pass
        for _ in solve_together(episode):
            pass
        times = episode.simulation.reservations.times
        solved += episode.is_success
        retreats, deadlocks = retreats + times.retreats, deadlocks + times.deadlocks
        least_m = min(least_m, watch.least_m)
        if episode.is_success and (alone.is_success or not in_turns):
            both.append((alone.elapsed_s if in_turns else 0.0, episode.elapsed_s))
            waited.append(ordered_sum(times.waited_s.values()))
    count = max(1, len(both))
    before, after = (ordered_sum(times) for times in zip(*both, strict=True))
    _, loop_s, bare_s = median_times_s(instances[0], turns, solve_together)
    turns_s = {
        "sequential_s": before / count,
        "makespan_ratio": after / (before or 1.0),
    }
    return {
        "success_rate": solved / len(instances),
        **(turns_s if before > 0.0 else {}),
        "makespan_s": after / count,
        "waited_s": ordered_sum(waited) / count,
        "retreats": float(retreats),
        "deadlocks": float(deadlocks),
        "clearance_mm": 1e3 * least_m,
        "loop_ratio": bare_s / loop_s,
    }
