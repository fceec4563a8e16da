"""Record an instance: the expert works, and keyframes are kept."""

import json
from collections.abc import Sequence
from typing import Any

from lemma.dataset.recipe.schema import EpisodeRecord, SubTaskRecord
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, ExpertStep, solve
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases, sub_instruction
from lemma.tasks.subtask import SubTask


def record_episode(instance: Instance) -> EpisodeRecord:
    """Let the expert solve an instance, and return the record.

    Args:
        instance: The problem.

    Returns:
        The record; ``success`` says whether the expert managed.
    """
    episode = Episode(instance)
    keeper = EpisodeRecorder(episode)
    keeper.keep()
    for step in solve(episode, Expert(episode.simulation.scene, instance.goal)):
        keeper.keep(step)
    return EpisodeRecord(**keeper.columns())


class EpisodeRecorder:
    """Keeps the keyframes of an episode, and the sub-tasks between them."""

    def __init__(self, episode: Episode) -> None:
        """Watch an episode.

        Args:
            episode: Just begun.
        """
        self._episode = episode
        self._times: list[float] = []
        self._states: list[bytes] = []
        self._hashes: list[str] = []
        self._rows: list[SubTaskRecord] = []

    def keep(self, step: ExpertStep | None = None) -> None:
        """Keep the present state, and the sub-task that led to it."""
        scene = self._episode.simulation.scene
        self._times.append(self._episode.elapsed_s)
        self._states.append(scene.snapshot().astype("<f8").tobytes())
        self._hashes.append(scene.state_hash())
        if step is not None:
            self._rows.append(_row(self._episode.instance, step))

    def columns(self) -> dict[str, Any]:
        """Return the fields of an :class:`EpisodeRecord`, now that it is over."""
        instance, info = self._episode.instance, self._episode.info()
        return {
            "key": instance.key,
            "task": instance.task,
            "split": instance.split,
            "index": instance.index,
            "team": instance.team,
            "distractors": len(instance.distractors),
            "high_level": instance.instructions["high_level"],
            "human": instance.instructions["human"],
            "unseen": instance.instructions["unseen"],
            "instance": json.dumps(
                instance.to_dict(), sort_keys=True, separators=(",", ":")
            ),
            "instance_sha256": instance.sha256(),
            "subtasks": tuple(self._rows),
            "keyframe_time_s": tuple(self._times),
            "keyframe_state": tuple(self._states),
            "keyframe_sha256": tuple(self._hashes),
            "success": info["is_success"],
            "progress": info["progress"],
            "failure": info["failure"],
            "elapsed_s": info["elapsed_s"],
            "idle_s": tuple(info["idle_s"].values()),
        }


def in_words(instance: Instance, subtask: SubTask) -> str:
    """Return a sub-task as a sentence."""
    if not subtask.robot:
        return sub_instruction("", str(subtask.primitive))
    names: Sequence[str] = robot_phrases(instance.scene.robots)
    robot = names[instance.scene.robot_names.index(subtask.robot)]
    return sub_instruction(robot, str(subtask.primitive), subtask.pick, subtask.place)


def _row(instance: Instance, step: ExpertStep) -> SubTaskRecord:
    subtask, grounded = step.subtask, step.grounded
    return SubTaskRecord(
        robot=subtask.robot,
        primitive=str(subtask.primitive),
        pick=subtask.pick,
        place=subtask.place,
        instruction=in_words(instance, subtask),
        pick_pose=(grounded.pick.x, grounded.pick.y, grounded.pick.yaw),
        place_pose=(grounded.place.x, grounded.place.y, grounded.place.yaw),
        outcome=str(step.result.outcome),
        start_s=step.start_s,
        duration_s=step.result.duration_s,
    )
