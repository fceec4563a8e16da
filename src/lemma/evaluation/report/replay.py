"""An episode done again from its line: nobody decides, what was done is repeated."""

from collections.abc import Callable, Mapping
from typing import Any

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.evaluation.records import POLICY_ERROR, PROTECTIVE_STOP, Row
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive


def retrace(
    row: Row,
    instance: Instance,
    horizon_s: float,
    before: Callable[[Episode, int], None] = lambda episode, number: None,
) -> str:
    """Execute what a line says was executed until its strict end, and compare.

    Physics repeats to the bit, so the episode is the same on the same kind of machine
    with the same versions.

    Args:
        row: A line of ``episodes.jsonl``.
        instance: What it was played on.
        horizon_s: Simulated time after which the episode ends [s].
        before: Told of the episode before each sub-task, from 0, and once more at the
            end.

    Returns:
        Where it first differs from the line, in a sentence; ``""`` if nowhere.
    """
    episode = Episode(instance, horizon_s=horizon_s)
    differs = ""
    for number, step in enumerate(row["subtasks"]):
        if episode.is_over:
            break
        before(episode, number)
        start = episode.elapsed_s
        found: dict[str, object] = {"start_s": round(start, 3)}
        if step["grounded"] is not None:
            result = episode.execute(grounded_of(step["grounded"]))
            found["outcome"] = str(result.outcome)
            found["duration_s"] = round(result.duration_s, 3)
        if not (row["failure"] == PROTECTIVE_STOP and step is row["subtasks"][-1]):
            episode.linger(start)
        differs = differs or _difference(f"sub-task {number + 1}", found, step)
    if not episode.is_over and row["failure"] != PROTECTIVE_STOP:
        episode.stop()
    before(episode, len(row["subtasks"]))
    info = episode.info()
    found = {"progress": info["progress"], "elapsed_s": round(info["elapsed_s"], 3)}
    if row["failure"] not in (POLICY_ERROR, PROTECTIVE_STOP):
        found |= {"success": info["success"], "failure": info["failure"]}
    return differs or _difference("the end", found, row)


def grounded_of(data: Mapping[str, Any]) -> GroundedSubTask:
    """Return a grounded sub-task from what its ``to_dict`` returned."""
    return GroundedSubTask(
        data["robot"],
        Primitive(data["primitive"]),
        Pose2(*data["pick"]),
        Pose2(*data["place"]),
    )


def _difference(
    where: str, found: Mapping[str, object], line: Mapping[str, Any]
) -> str:
    for name, value in found.items():
        if line[name] != value:
            words = name.replace("_", " ")
            return f"At {where}, {words} was {line[name]}, and is {value} here."
    return ""
