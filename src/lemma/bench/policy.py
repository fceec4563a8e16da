"""The figures of `lemma bench --policy`: how long it thinks, and how much it needs."""

import statistics
import time
from dataclasses import asdict, dataclass

from lemma.core.workers.pool import ProcessPool
from lemma.core.workers.resources import peak_memory_mb
from lemma.evaluation.run.rollout import Player, Rollout
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import Instance


@dataclass(frozen=True, slots=True)
class PolicyFigures:
    """How a policy runs on this machine, one episode at a time."""

    decisions: int
    """How many were timed."""
    look_ms: float
    """Median of rendering both cameras and fusing the map; 0 if it needs no images."""
    decision_ms: float
    """Median of one decision: from images and a sentence to poses."""
    slowest_ms: float
    """95th percentile: 19 of 20 decisions are faster."""
    success_rate: float
    """In these few episodes, strictly."""
    peak_mb: float
    """Largest memory of a process that plays one episode."""

    def to_dict(self) -> dict[str, float]:
        """Return plain data, ready for JSON."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


def measure_policy(name: str, instances: list[Instance]) -> PolicyFigures:
    """Let a policy play, and time what it does.

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
    return PolicyFigures(
        decisions=len(decisions),
        look_ms=1000.0 * statistics.median(looks) if player.rig else 0.0,
        decision_ms=1000.0 * statistics.median(decisions),
        slowest_ms=1000.0 * decisions[int(0.95 * (len(decisions) - 1))],
        success_rate=successes / len(instances),
        peak_mb=next(ProcessPool(1).run(_peak_mb, [(name, instances[-1])])),
    )


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
