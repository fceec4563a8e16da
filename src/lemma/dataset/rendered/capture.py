"""Images and labels at the keyframes of an episode.

The recipe contains the state of every keyframe, so nothing is simulated.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.dataset.recipe.schema import EpisodeRecord, ExpertRecord, PerturbedRecord
from lemma.dataset.rendered.keyframes import (
    EXECUTED,
    FORM,
    KEYFRAMES_VERSION,
    PARTS,
    Header,
    Row,
    write_keyframes,
)
from lemma.env.camera_rig import CameraRig
from lemma.env.observation import object_poses
from lemma.env.view import View
from lemma.expert.disturbances import NONE
from lemma.motion.outcome import Outcome
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.scene.objects.entity import known_entities
from lemma.scene.raster import RASTER, encode_depth
from lemma.scene.rendering.gl_backend import choose_backend
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import sub_instruction
from lemma.tasks.subtask import STOP
from lemma.tasks.task import TASKS

_DECISION = ("robot", "primitive", "pick", "place")
_NOWHERE = (math.nan,) * 3


@dataclass(frozen=True, slots=True)
class KeyframeForm:
    """Images of every keyframe, for policies that decide at each keyframe."""

    width: int = CAMERA_WIDTH_PX
    """Width of camera images [px]."""
    height: int = CAMERA_HEIGHT_PX
    """Height of camera images [px]."""

    def __post_init__(self) -> None:
        """Check the size.

        Raises:
            InvalidConfigError: The size is not valid.
        """
        CameraRig(self.width, self.height)

    def header(self, versions: dict[str, str]) -> Header:
        """Return the header of all files, with settings and versions."""
        return Header(
            form=FORM,
            part=PARTS[0],
            version=KEYFRAMES_VERSION,
            versions=versions,
            renderer=choose_backend().renderer,
            robots=2,
            width=self.width,
            height=self.height,
            raster=RASTER,
            entities=known_entities(),
        )

    def write(
        self,
        paths: Sequence[Path],
        records: Sequence[EpisodeRecord],
        digests: tuple[str, ...],
        header: Header,
    ) -> None:
        """Render the rows of some episodes.

        Args:
            paths: Files, in the order of ``PARTS``.
            records: The episodes.
            digests: Their digests in the recipe.
            header: The header from :meth:`header`.

        Raises:
            DatasetError: A state does not have its recorded hash.
            InvalidConfigError: The episodes have different numbers of robots.
            RenderingError: OpenGL does not work here.
        """
        robots = {len(record.instance_data()["robots"]) for record in records}
        if len(robots) != 1:
            raise InvalidConfigError(
                f"Teams of {sorted(robots)} robots do not fit into one file. Use "
                "different tasks for them."
            )
        counts, rows = self._counted(records)
        mine = replace(
            header,
            robots=max(robots),
            entities=entities_of(records[0].task),
            digests=digests,
            keyframes=counts,
        )
        headers = [replace(mine, part=part) for part in PARTS]
        write_keyframes(list(zip(paths, headers, strict=True)), rows)

    def _counted(
        self, records: Sequence[EpisodeRecord]
    ) -> tuple[tuple[int, ...], Iterable[Row]]:
        """Return the number of rows of each episode, and all rows."""
        rows = (row for record in records for row in self.rows(record))
        return tuple(map(_count, records)), rows

    def rows(self, record: EpisodeRecord) -> Iterator[Row]:
        """Yield the keyframes of an episode, with all columns.

        Args:
            record: The episode.

        Raises:
            DatasetError: A state does not have its recorded hash.
            RenderingError: OpenGL does not work here.
        """
        instance = Instance.from_dict(record.instance_data())
        scene = Scene(instance.scene)
        constant, entities = episode_columns(record, instance), entities_of(record.task)
        for keyframe in range(_count(record)):
            _check_state(record, keyframe)
            scene.restore(record.state(keyframe))
            yield {
                **constant,
                "keyframe": keyframe,
                "time_s": record.keyframe_time_s[keyframe],
                **_labels(record, keyframe),
                "objects": entity_poses(object_poses(scene), entities),
                **stored(rig_of(self.width, self.height).look(scene)),
            }


def stored(view: View) -> Row:
    """Return a view as columns of the files of maps and of cameras.

    Depths and heights of a view are already multiples of the stored unit, so storage
    loses nothing, and maps can be fused again, for example with another raster.
    """
    images = view.cameras.values()
    return {
        **stored_map(view),
        "intrinsics": np.array([i.camera.intrinsics.matrix() for i in images]),
        "world_from_camera": np.array(
            [image.camera.world_from_camera.matrix() for image in images]
        ),
        "rgb": np.array([image.rgb for image in images]),
        "depth": np.array([encode_depth(image.depth_m) for image in images]),
    }


def stored_map(view: View) -> Row:
    """Return a view as columns of the files of maps."""
    return {
        "joints": view.joints,
        "opening_m": view.opening_m,
        "map_rgb": view.rgb,
        "map_height": RASTER.encode_height(view.height_m, view.coverage),
    }


@lru_cache(maxsize=1)
def rig_of(width: int, height: int) -> CameraRig:
    """Return cached cameras, since their creation takes longer than an image."""
    return CameraRig(width, height)


def episode_columns(record: EpisodeRecord, instance: Instance) -> Row:
    """Return the columns with the same values in all keyframes of an episode."""
    robots = instance.scene.robots
    return {
        "key": record.key,
        "task": record.task,
        "split": record.split,
        "index": record.index,
        "keyframes": _count(record),
        "team": record.team,
        "arms": "+".join(robot.arm for robot in robots),
        "bases": np.array([[r.base.x, r.base.y, r.base.yaw] for r in robots]),
        "high_level": record.high_level,
        "human": record.human,
        "unseen": record.unseen,
        "goal": json.dumps(instance.goal.pairs, separators=(",", ":")),
        "instance": record.instance,
    }


def _count(record: EpisodeRecord) -> int:
    """Return the number of keyframes to render: those with a label."""
    if isinstance(record, PerturbedRecord):
        return record.labelled
    return record.keyframes


def label(record: EpisodeRecord, subtask: int) -> dict[str, str]:
    """Return the names and the sub-instruction of a sub-task.

    Args:
        record: The episode.
        subtask: Index of the sub-task; ``stop`` follows the last, with empty names.
    """
    if subtask == len(record.subtasks):
        words = sub_instruction("", str(STOP.primitive))
        return {**STOP.to_dict(), "sub_instruction": words}
    return _names(record.subtasks[subtask])


def _names(row: ExpertRecord) -> dict[str, str]:
    names = {n: getattr(row, n) for n in _DECISION}
    return {**names, "sub_instruction": row.instruction}


def _labels(record: EpisodeRecord, keyframe: int) -> Row:
    """Return the label of a keyframe.

    In perturbed executions, the label is the expert's decision, and the executed
    sub-task is added.
    """
    is_last = keyframe == len(record.subtasks)
    row = None if is_last else record.subtasks[keyframe]
    done = {
        **label(record, keyframe),
        "pick_pose": row.pick_pose if row else _NOWHERE,
        "place_pose": row.place_pose if row else _NOWHERE,
        "outcome": row.outcome if row else str(Outcome.STOPPED),
    }
    if not isinstance(record, PerturbedRecord):
        return done
    right = record.expert[keyframe]
    assert right is not None
    return {
        **{f"{EXECUTED}{name}": done[name] for name in _DECISION},
        "perturbation": NONE if is_last else record.perturbation[keyframe],
        "outcome": done["outcome"],
        **_names(right),
        "pick_pose": right.pick_pose or _NOWHERE,
        "place_pose": right.place_pose or _NOWHERE,
    }


def entities_of(task: str) -> tuple[str, ...]:
    """Return the entities that tables of a task may have."""
    return known_entities(TASKS[task].kinds if task in TASKS else ())


def entity_poses(
    poses: Mapping[str, FloatArray], entities: tuple[str, ...]
) -> FloatArray:
    """Return the poses of entities, (entities, 7); NaN for missing ones.

    Args:
        poses: Position [m] and quaternion wxyz by name, (7,) each.
        entities: Names, in the order of the rows.
    """
    found = np.full((len(entities), 7), np.nan)
    for name, pose in poses.items():
        found[entities.index(name)] = pose
    return found


def _check_state(record: EpisodeRecord, keyframe: int) -> None:
    state = record.keyframe_state[keyframe]
    if hashlib.sha256(state).hexdigest() != record.keyframe_sha256[keyframe]:
        raise DatasetError(
            f"The state of keyframe {keyframe} of {record.key} is damaged. Delete its "
            "file in the recipe and run 'lemma generate' again."
        )
