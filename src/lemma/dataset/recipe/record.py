"""Recording of the expert's episodes with keyframes.

Robots act in turns, unless the goal cannot be reached so. Then sub-tasks are recorded
in the order in which they begin, each with a keyframe of that moment.

For recovery states the execution is perturbed. The record then has the executed
sub-tasks, which replays use and policies get as their past, and the expert's decisions,
which are the labels.
"""

import json
from typing import Any, NamedTuple

from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.dataset.recipe.schema import (
    PERTURB_KEYS,
    EpisodeRecord,
    ExpertRecord,
    PerturbedRecord,
    SubTaskRecord,
    perturbed_as,
)
from lemma.env.episode import Episode
from lemma.expert.disturbances import NONE, Mistake, Perturbation, Perturber
from lemma.expert.expert import Expert, ExpertStep, solve
from lemma.expert.together import solve_together
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases, sub_instruction
from lemma.tasks.subtask import GroundedSubTask, SubTask

_MAX_STEPS = 30
"""Largest number of sub-tasks of a perturbed episode, as without perturbation."""


def record_episode(instance: Instance) -> EpisodeRecord:
    """Let the expert solve an instance, and return the record.

    Args:
        instance: The problem.

    Returns:
        The record; ``success`` tells whether the expert solved it.
    """
    episode = Episode(instance)
    keeper = EpisodeRecorder(episode)
    if not instance.goal.in_turns:
        return _record_together(episode, keeper)
    keeper.keep()
    for step in solve(episode):
        keeper.keep(step)
    return EpisodeRecord(**keeper.columns())


def _record_together(episode: Episode, keeper: "EpisodeRecorder") -> EpisodeRecord:
    """Let the expert solve an episode with all robots at once."""
    begun: list[tuple[str, float]] = []
    ended: dict[tuple[str, float], ExpertStep] = {}

    def note(subtask: SubTask) -> None:
        begun.append((subtask.robot, episode.elapsed_s))
        keeper.frames.append(keeper.frame())

    last = keeper.frame()
    for step in solve_together(episode, watcher=note):
        ended[step.subtask.robot, step.start_s] = step
        last = keeper.frame()
    keeper.frames.append(last)
    keeper.steps += [ended[each] for each in begun]
    return EpisodeRecord(**keeper.columns())


class Keyframe(NamedTuple):
    """A state of an episode."""

    time_s: float
    state: bytes
    sha256: str


class EpisodeRecorder:
    """Records the keyframes of an episode and the sub-tasks between them."""

    def __init__(self, episode: Episode) -> None:
        """Begin to record.

        Args:
            episode: The episode, in its initial state.
        """
        self._episode = episode
        self.frames: list[Keyframe] = []
        """One before each sub-task, and one at the end."""
        self.steps: list[ExpertStep] = []
        """The sub-tasks, in the order in which they began."""

    def frame(self) -> Keyframe:
        """Return the present state."""
        scene = self._episode.simulation.scene
        state = scene.snapshot().astype("<f8").tobytes()
        return Keyframe(self._episode.elapsed_s, state, scene.state_hash())

    def keep(self, step: ExpertStep | None = None) -> None:
        """Record the present state, and the sub-task that led to it."""
        self.frames.append(self.frame())
        self.steps += [] if step is None else [step]

    def columns(self) -> dict[str, Any]:
        """Return the fields of an :class:`EpisodeRecord`, after the episode's end."""
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
            "subtasks": tuple(_row(instance, step) for step in self.steps),
            "keyframe_time_s": tuple(frame.time_s for frame in self.frames),
            "keyframe_state": tuple(frame.state for frame in self.frames),
            "keyframe_sha256": tuple(frame.sha256 for frame in self.frames),
            "success": info["is_success"],
            "progress": info["goal_progress"],
            "failure": info["failure"],
            "elapsed_s": info["elapsed_s"],
            "idle_s": tuple(info["idle_s"].values()),
        }


def _row(instance: Instance, step: ExpertStep) -> SubTaskRecord:
    return SubTaskRecord(
        **in_names(instance, step.subtask),
        pick_pose=pose_row(step.grounded.pick),
        place_pose=pose_row(step.grounded.place),
        outcome=str(step.result.outcome),
        start_s=step.start_s,
        duration_s=step.result.duration_s,
    )


def in_names(instance: Instance, subtask: SubTask) -> dict[str, str]:
    """Return the columns of a sub-task without poses: names and sub-instruction."""
    robot = ""
    if subtask.robot:
        number = instance.scene.robot_names.index(subtask.robot)
        robot = robot_phrases(instance.scene.robots)[number]
    names = subtask.to_dict()
    words = sub_instruction(robot, names["primitive"], subtask.pick, subtask.place)
    return {**names, "instruction": words}


def pose_row(pose: Pose2) -> tuple[float, float, float]:
    """Return a pose as a column: x, y [m], yaw [rad]."""
    return (pose.x, pose.y, pose.yaw)


def record_perturbed(instance: Instance, perturbation: Perturbation) -> PerturbedRecord:
    """Let the expert solve an instance while some of its sub-tasks are perturbed.

    At each keyframe an expert without memory decides. The episode ends when it decides
    ``stop``, has no plan or fails without a perturbation, and when the time is up.

    Args:
        instance: The problem.
        perturbation: Probability and seed.

    Returns:
        The record; ``success`` tells whether the expert solved it nevertheless.
    """
    episode = Episode(instance)
    scene = episode.simulation.scene
    saboteur, keeper = Perturber(instance.scene), EpisodeRecorder(episode)
    expert: list[ExpertRecord | None] = []
    kinds: list[str] = []
    keeper.keep()
    for number in range(_MAX_STEPS):
        subtask, grounded = Expert(scene, instance.goal).act()
        if grounded is None:
            solved = episode.goal_progress == 1.0
            expert.append(_known(instance, subtask, None) if solved else None)
            break
        expert.append(_known(instance, subtask, grounded))
        rng = stream("perturb", instance.key, perturbation.seed, number)
        done = Mistake(NONE, subtask, grounded)
        if rng.random() < perturbation.probability:
            now = SymbolicState.observe(scene)
            done = saboteur.spoil(subtask, grounded, now, rng)
        start = episode.elapsed_s
        result = episode.execute(done.grounded)
        keeper.keep(ExpertStep(done.subtask, done.grounded, result, start))
        kinds.append(done.kind)
        if episode.is_over:
            break
        if done.kind == NONE and not result.ok:
            # The expert failed, so its decision is no label.
            expert[-1] = None
            break
    expert += [None] * (len(kinds) + 1 - len(expert))
    episode.stop()
    columns = keeper.columns()
    columns["key"] += f"/perturbed-{perturbation.seed}"
    return PerturbedRecord(**columns, expert=tuple(expert), perturbation=tuple(kinds))


def _known(
    instance: Instance, subtask: SubTask, grounded: GroundedSubTask | None
) -> ExpertRecord:
    return ExpertRecord(
        **in_names(instance, subtask),
        pick_pose=pose_row(grounded.pick) if grounded else None,
        place_pose=pose_row(grounded.place) if grounded else None,
    )


def described(perturbation: Perturbation | None) -> dict[str, str]:
    """Return the entries of a record for a perturbation; none without one."""
    if perturbation is None:
        return {}
    values = (f"{perturbation.probability:g}", str(perturbation.seed))
    return dict(zip(PERTURB_KEYS, values, strict=True))


def perturbation_of(about: dict[str, str]) -> Perturbation | None:
    """Return the perturbation in a record; None without one."""
    if not perturbed_as(about):
        return None
    probability, seed = (about[name] for name in PERTURB_KEYS)
    return Perturbation(float(probability), int(seed))
