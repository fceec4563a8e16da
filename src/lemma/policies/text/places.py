"""Relational sentences about the frames of labelled batches."""

import math
from collections.abc import Sequence

import numpy as np

from lemma.core.poses import Pose2
from lemma.policies.batch import Batch
from lemma.scene.spec import RobotPlacement
from lemma.tasks.goal import Goal
from lemma.tasks.language.relational import say_of, things_at
from lemma.tasks.teams.rule import rule_from


def relational_in(
    batch: Batch, rows: Sequence[int], rng: np.random.Generator
) -> list[str]:
    """Draw relational sentences for the goals of frames, about the scenes in them.

    Args:
        batch: Batch with labels.
        rows: Numbers of the frames.
        rng: Random generator.
    """
    labels = batch.labels
    assert labels is not None
    names, texts = batch.entities.names, []
    # In one transfer each, because frames may be on a GPU.
    objects, bases = labels.objects[..., :2].tolist(), labels.bases.tolist()
    for row in rows:
        team = zip(labels.robot_colors[row], bases[row], strict=False)
        robots = [RobotPlacement("ur5", color, Pose2(*base)) for color, base in team]
        there = {
            name: Pose2(*xy)
            for name, xy in zip(names, objects[row], strict=True)
            if not math.isnan(xy[0])
        }
        rule = labels.rules[row]
        goal = Goal.from_pairs(labels.goals[row], rule_from(rule) if rule else None)
        texts.append(say_of(things_at(robots, there), goal, rng))
    return texts
