"""Labels of rendered data: the next sub-task, and poses of objects."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lemma.core.poses import FloatArray
from lemma.dataset.recipe.schema import EpisodeRecord, PerturbedRecord
from lemma.scene.objects.entity import known_entities
from lemma.tasks.language.bank import sub_instruction
from lemma.tasks.subtask import STOP


def expert_label(record: PerturbedRecord, keyframe: int) -> dict[str, Any]:
    """Return the expert's sub-task at a keyframe that has a label, with poses.

    Args:
        record: The episode, perturbed.
        keyframe: One of the first ``record.labelled``.
    """
    row = record.expert[keyframe]
    assert row is not None
    nowhere = (math.nan,) * 3
    return {
        "robot": row.robot,
        "primitive": row.primitive,
        "pick": row.pick,
        "place": row.place,
        "sub_instruction": row.instruction,
        "pick_pose": row.pick_pose or nowhere,
        "place_pose": row.place_pose or nowhere,
    }


def label(record: EpisodeRecord, subtask: int) -> dict[str, str]:
    """Return a sub-task of an episode in symbols and in words.

    Args:
        record: The episode.
        subtask: Its number; behind the last comes ``stop``, with no names.
    """
    if subtask == len(record.subtasks):
        words = sub_instruction("", str(STOP.primitive))
        return {**STOP.to_dict(), "sub_instruction": words}
    row = record.subtasks[subtask]
    return {
        "robot": row.robot,
        "primitive": row.primitive,
        "pick": row.pick,
        "place": row.place,
        "sub_instruction": row.instruction,
    }


def entity_poses(poses: Mapping[str, FloatArray]) -> FloatArray:
    """Return the poses of all entities, (entities, 7); NaN where one is missing.

    Args:
        poses: Position [m] and quaternion wxyz by name, (7,) each.
    """
    entities = known_entities()
    found = np.full((len(entities), 7), np.nan)
    for name, pose in poses.items():
        found[entities.index(name)] = pose
    return found
