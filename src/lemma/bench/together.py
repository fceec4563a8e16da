"""The expert with all robots at work at the same time, beside one after the other."""

from collections.abc import Iterable

import numpy as np

from lemma.bench.speed import Figures, record_loop, time_loop
from lemma.core.seeding import ordered_sum
from lemma.env.episode import Episode
from lemma.evaluation.run.watches import ClearanceWatch
from lemma.expert.expert import Expert, solve
from lemma.expert.together import solve_together
from lemma.tasks.instance import Instance

PARALLEL_TASKS = ("pass2", "stack2")
"""Tasks whose plans have sub-tasks that do not depend on each other."""


def measure_together(instances: Iterable[Instance], turns: int = 3) -> Figures:
    """Measure makespans, waiting and speed of teams at work at the same time.

    Args:
        instances: Problems of one task.
        turns: How often the loop is timed, on the first instance.

    Returns:
        Shares of successes, and means over the instances that both ways solved; see
        ``lemma bench`` for the meanings.
    """
    instances = list(instances)
    solved, both, waited, retreats, deadlocks, least_m = 0, [], [], 0, 0, np.inf
    for instance in instances:
        alone, episode = Episode(instance), Episode(instance)
        watch = ClearanceWatch(episode.simulation)
        for _ in solve(alone, Expert(alone.simulation.scene, instance.goal)):
            pass
        for _ in solve_together(episode):
            pass
        times = episode.simulation.reservations.times
        solved += episode.is_success
        retreats, deadlocks = retreats + times.retreats, deadlocks + times.deadlocks
        least_m = min(least_m, watch.least_m)
        if alone.is_success and episode.is_success:
            both.append((alone.elapsed_s, episode.elapsed_s))
            waited.append(ordered_sum(times.waited_s.values()))
    count = max(1, len(both))
    before, after = (ordered_sum(times) for times in zip(*both, strict=True))
    recorded = record_loop(instances[0], solve_together)
    runs = [time_loop(instances[0], recorded, solve_together) for _ in range(turns)]
    loop_s, bare_s = np.median(np.array(runs), axis=0).sum(axis=0).tolist()
    return {
        "success_rate": solved / len(instances),
        "sequential_s": before / count,
        "makespan_s": after / count,
        "makespan_ratio": after / before,
        "waited_s": ordered_sum(waited) / count,
        "retreats": float(retreats),
        "deadlocks": float(deadlocks),
        "clearance_mm": 1e3 * least_m,
        "loop_ratio": bare_s / loop_s,
    }
