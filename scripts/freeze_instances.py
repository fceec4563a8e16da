"""Write the frozen instance lists: sampled, solved by the expert, and attacked.

    python scripts/freeze_instances.py src/lemma/tasks/frozen lemma train,val,test 8

The second argument is a suite or names of tasks, separated by commas; the last one is
the number of processes. The same version writes the same bytes. Lists of other tasks
are not changed. For the suite ``ladder``, only its own tasks are written.

A list has only instances that the expert solves with a plan of the task's length, and
that no cheap attack solves. The printed numbers of rejections measure the sampler and
the expert.
"""

import gzip
import hashlib
import json
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lemma.audit.run import cheap_attacks_succeed
from lemma.core.errors import SamplingError
from lemma.core.workers.pool import ProcessPool, run_in_order
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.expert.together import solve_together
from lemma.tasks.instance import Instance, splits_of
from lemma.tasks.sampling import sample
from lemma.tasks.suite import SUITE, SUITES, TASKS

_ATTEMPTS = 20
MANIFEST = "manifest.json"


@dataclass(frozen=True, slots=True)
class Accepted:
    """One accepted instance with the numbers of rejections before it."""

    instance: Instance
    rejected: int
    """Number of candidates that violated the task's zones."""
    unsolved: int
    """Number of sampled instances that the expert did not solve."""
    broken: tuple[str, ...]
    """Names of attacks that solved sampled instances."""
    elapsed_s: float
    """Simulated time of the expert [s]."""


def accept(task: str, split: str, index: int) -> Accepted:
    """Sample instances until the expert solves one and no cheap attack does.

    Raises:
        SamplingError: Too many instances were rejected.
    """
    record = TASKS[task]
    rejected = 0
    broken: list[str] = []
    for attempt in range(_ATTEMPTS):
        drawn = sample(record, split, index, attempt=attempt)
        rejected += drawn.rejected
        elapsed_s = _solved_s(drawn.instance, record.subtasks)
        if elapsed_s is None:
            continue
        attack = cheap_attacks_succeed(drawn.instance)
        if attack is not None:
            broken.append(attack)
            continue
        unsolved = attempt - len(broken)
        return Accepted(drawn.instance, rejected, unsolved, tuple(broken), elapsed_s)
    raise SamplingError(
        f"Of {_ATTEMPTS} instances of {task}/{split}/{index} the expert solved none "
        f"that withstood {', '.join(broken) or 'the attacks'}. Change the task's "
        "zones, or look at why it fails: lemma bench --expert."
    )


def _solved_s(instance: Instance, promised: int) -> float | None:
    """Return the expert's time [s]; None if its plan fails or is longer than promised.

    For more than two robots, all robots acting together must solve it, too. A goal that
    nobody reaches in turns is solved together alone.
    """
    in_turns = instance.goal.in_turns
    if len(instance.scene.robots) > 2 or not in_turns:
        together = Episode(instance)
        done = list(solve_together(together))
        if not together.is_success or not all(step.result.ok for step in done):
            return None
        if not in_turns:
            return together.elapsed_s if len(done) == promised else None
    episode = Episode(instance)
    steps = list(solve(episode, Expert(episode.simulation.scene, instance.goal)))
    as_promised = len(steps) == promised and all(s.result.ok for s in steps)
    return episode.elapsed_s if as_promised and episode.is_success else None


def accept_all(task: str, split: str, workers: int) -> Iterator[Accepted]:
    """Yield the instances of a list in order, working in several processes."""
    jobs = [(task, split, index) for index in range(splits_of(task)[split])]
    yield from run_in_order(ProcessPool(workers), accept, jobs)


def write_list(instances: list[Instance], path: Path) -> str:
    """Write a list, the same bytes for the same instances; return its SHA-256.

    The hash is that of the uncompressed lines.
    """
    lines = [
        json.dumps(instance.to_dict(), sort_keys=True, separators=(",", ":"))
        for instance in instances
    ]
    text = ("\n".join(lines) + "\n").encode()
    # A header without time stamp and file name, for reproducible bytes.
    path.write_bytes(gzip.compress(text, compresslevel=9, mtime=0))
    return hashlib.sha256(text).hexdigest()


def freeze(
    folder: Path, tasks: tuple[str, ...], splits: tuple[str, ...], workers: int
) -> Iterator[str]:
    """Write the lists of some tasks and splits, and their manifest.

    Args:
        folder: Folder of the lists, ``src/lemma/tasks/frozen``.
        tasks: Names of tasks.
        splits: Names of splits.
        workers: Number of processes.

    Yields:
        One line of figures per list.
    """
    folder.mkdir(parents=True, exist_ok=True)
    manifest_path = folder / MANIFEST
    manifest = json.loads(manifest_path.read_text()) if manifest_path.exists() else {}
    for split in splits:
        for task in tasks:
            found = list(accept_all(task, split, workers))
            name = f"{task}-{split}"
            digest = write_list(
                [a.instance for a in found], folder / f"{name}.jsonl.gz"
            )
            rejected = sum(a.rejected for a in found)
            unsolved = sum(a.unsolved for a in found)
            broken = Counter(attack for a in found for attack in a.broken)
            manifest[name] = {
                "sha256": digest,
                "instances": len(found),
                "rejected_by_sampler": rejected,
                "refused_by_expert": unsolved,
                "refused_by_attack": dict(sorted(broken.items())),
            }
            manifest_path.write_text(json.dumps(manifest, indent=1, sort_keys=True))
            times = [a.elapsed_s for a in found]
            attacked = ", ".join(f"{n} by {a}" for a, n in sorted(broken.items()))
            yield (
                f"{name}: {len(found)} instances, {rejected} tables rejected, "
                f"{unsolved} not solved by the expert, {attacked or 'none'} broken, "
                f"mean {sum(times) / len(times):.1f} s, at most {max(times):.1f} s"
            )


if __name__ == "__main__":
    folder, listed, names, workers = sys.argv[1:]
    tasks = SUITES.get(listed) or tuple(listed.split(","))
    if listed == "ladder":
        tasks = tuple(task for task in tasks if task not in SUITE)
    splits = tuple(name.strip() for name in names.split(","))
    for line in freeze(Path(folder), tasks, splits, int(workers)):
        print(line, flush=True)
