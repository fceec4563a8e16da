"""Relational sentences about the frames of labelled batches."""

import numpy as np

from lemma.core.poses import Pose2
from lemma.policies.batch import Batch
from lemma.scene.spec import RobotPlacement
from lemma.tasks.goal import Goal
from lemma.tasks.language.relational import say_of, things_at
from lemma.tasks.teams.rule import rule_from


def relational_in(batch: Batch, row: int, rng: np.random.Generator) -> str:
    """Draw a relational sentence for the goal of a frame, about the scene in it.

    Args:
        batch: Batch with labels.
        row: Number of the frame.
        rng: Random generator.
    """
    labels = batch.labels
    assert labels is not None
    bases = labels.bases[row].tolist()
    robots = [
        RobotPlacement("ur5", color, Pose2(*base))
        for color, base in zip(labels.robot_colors[row], bases, strict=False)
    ]
    poses = labels.objects[row, :, :2].tolist()
    objects = {
        name: Pose2(*xy)
        for name, xy in zip(batch.entities.names, poses, strict=True)
        # A missing entity has the pose NaN.
        if xy[0] == xy[0]
    }
    rule = labels.rules[row]
    goal = Goal.from_pairs(labels.goals[row], rule_from(rule) if rule else None)
    return say_of(things_at(robots, objects), goal, rng)
