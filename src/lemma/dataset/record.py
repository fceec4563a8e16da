"""From an instance to a record: the expert works, the keyframes are kept."""

import json

from lemma.dataset.schema import EpisodeRecord, SubTaskRecord
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, Step, solve
from lemma.tasks.instance import Instance
from lemma.tasks.language import robot_phrases, sub_instruction


def record_episode(instance: Instance) -> EpisodeRecord:
    """Let the expert solve an instance and return what happened.

    Args:
        instance: The problem.

    Returns:
        The record; ``success`` says whether the expert managed.
    """
    episode = Episode(instance)
    scene = episode.simulation.scene
    times, states, hashes = [], [], []

    def keep() -> None:
        times.append(episode.elapsed_s)
        states.append(scene.snapshot().astype("<f8").tobytes())
        hashes.append(scene.state_hash())

    keep()
    rows = []
    for step in solve(episode, Expert(scene, instance.goal)):
        rows.append(_row(instance, step))
        keep()
    info = episode.info()
    return EpisodeRecord(
        key=instance.key,
        task=instance.task,
        split=instance.split,
        index=instance.index,
        team=instance.team,
        distractors=len(instance.distractors),
        high_level=instance.instructions["high_level"],
        human=instance.instructions["human"],
        unseen=instance.instructions["unseen"],
        instance=json.dumps(instance.to_dict(), sort_keys=True, separators=(",", ":")),
        instance_sha256=instance.sha256(),
        subtasks=tuple(rows),
        keyframe_time_s=tuple(times),
        keyframe_state=tuple(states),
        keyframe_sha256=tuple(hashes),
        success=info["is_success"],
        progress=info["progress"],
        failure=info["failure"],
        elapsed_s=info["elapsed_s"],
        idle_s=tuple(info["idle_s"].values()),
    )


def _row(instance: Instance, step: Step) -> SubTaskRecord:
    subtask, grounded = step.subtask, step.grounded
    names = robot_phrases(tuple(robot.colour for robot in instance.scene.robots))
    robot = names[instance.scene.robot_names.index(subtask.robot)]
    return SubTaskRecord(
        robot=subtask.robot,
        primitive=str(subtask.primitive),
        pick=subtask.pick,
        place=subtask.place,
        instruction=sub_instruction(
            robot, str(subtask.primitive), subtask.pick, subtask.place
        ),
        pick_pose=(grounded.pick.x, grounded.pick.y, grounded.pick.yaw),
        place_pose=(grounded.place.x, grounded.place.y, grounded.place.yaw),
        outcome=str(step.result.outcome),
        start_s=step.start_s,
        duration_s=step.result.duration_s,
    )
