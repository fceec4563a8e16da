"""Pictures and labels at the keyframes of an episode: the form ``keyframes``.

Nothing is simulated: the recipe holds the state of every keyframe.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.dataset.recipe.schema import EpisodeRecord, PerturbedRecord
from lemma.dataset.rendered.keyframes.files import KeyframeFile, write_keyframes
from lemma.dataset.rendered.keyframes.schema import (
    EXECUTED,
    FORM,
    KEYFRAMES_VERSION,
    PARTS,
    SUFFIX,
    Header,
    Row,
    describe,
)
from lemma.dataset.rendered.labels import entity_poses, expert_label, label
from lemma.dataset.rendered.render import Found
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

_STOPPED = str(Outcome.STOPPED)
_DECISION = ("robot", "primitive", "pick", "place")
_PER_FILE = ("part", "robots", "digests", "keyframes")


@dataclass(frozen=True, slots=True)
class KeyframeForm:
    """Images of every keyframe, for policies that plan from one to the next."""

    width: int = CAMERA_WIDTH_PX
    """Width of camera images [px]."""
    height: int = CAMERA_HEIGHT_PX
    """Height of camera images [px]."""

    def __post_init__(self) -> None:
        """Check the size."""
        CameraRig(self.width, self.height)

    @property
    def name(self) -> str:
        """Name of the form."""
        return FORM

    def paths(self, split: str, name: str) -> tuple[str, ...]:
        """Return the files of a row group of the recipe, in the order of ``PARTS``."""
        return tuple(f"{part}/{split}/{name}{SUFFIX}" for part in PARTS)

    def about(self, versions: dict[str, str]) -> dict[str, Any]:
        """Return the settings and versions that decide the bytes."""
        header = asdict(self._header(versions, choose_backend().renderer))
        return {name: header[name] for name in header if name not in _PER_FILE}

    def _header(self, versions: dict[str, str], renderer: str) -> Header:
        return Header(
            form=FORM,
            part=PARTS[0],
            version=KEYFRAMES_VERSION,
            versions=versions,
            renderer=renderer,
            robots=2,
            width=self.width,
            height=self.height,
            raster=RASTER,
            entities=known_entities(),
        )

    def look(self, path: Path) -> Found:
        """Return the record that a file holds.

        Raises:
            DatasetError: It is damaged, or of another form or version.
        """
        file = KeyframeFile(path)
        header = asdict(file.header)
        return Found(
            {name: header[name] for name in header if name not in _PER_FILE},
            file.header.digests,
            len(file),
        )

    def write(
        self,
        paths: Sequence[Path],
        records: Sequence[EpisodeRecord],
        digests: tuple[str, ...],
        about: dict[str, Any],
    ) -> None:
        """Render the keyframes of some episodes.

        Args:
            paths: Files, in the order of :meth:`paths`.
            records: The episodes.
            digests: Their digests in the recipe.
            about: The description that :meth:`about` returned.

        Raises:
            DatasetError: A state is not the one that was recorded.
            RenderingError: OpenGL does not work here.
        """
        base = self._header(about["versions"], about["renderer"])
        robots = {len(record.instance_data()["robots"]) for record in records}
        if len(robots) != 1:
            raise InvalidConfigError(
                f"Teams of {sorted(robots)} robots do not fit into one file. Put them "
                "into different tasks."
            )
        counts = tuple(_count(record) for record in records)
        headers = [
            replace(
                base,
                part=part,
                robots=max(robots),
                digests=digests,
                keyframes=counts,
            )
            for part in PARTS
        ]
        rows = (row for record in records for row in self.rows(record))
        write_keyframes(list(zip(paths, headers, strict=True)), rows)

    def rows(self, record: EpisodeRecord) -> Iterator[Row]:
        """Yield the keyframes of an episode, with all columns.

        Args:
            record: The episode.

        Raises:
            DatasetError: A state is not the one that was recorded.
            RenderingError: OpenGL does not work here.
        """
        instance = Instance.from_dict(record.instance_data())
        scene = Scene(instance.scene)
        constant = _episode_columns(record, instance)
        for keyframe in range(_count(record)):
            _check_state(record, keyframe)
            scene.restore(record.state(keyframe))
            yield {
                **constant,
                "keyframe": keyframe,
                "time_s": record.keyframe_time_s[keyframe],
                **_labels(record, keyframe),
                "objects": entity_poses(object_poses(scene)),
                **stored(_rig(self.width, self.height).look(scene)),
            }

    def card(self) -> str:
        """Return what the folder's README says."""
        return _CARD.format(columns=describe(), width=self.width, height=self.height)


def stored(view: View) -> Row:
    """Return what is seen as it is stored.

    Depths and heights are seen in the steps in which they are stored, so that what is
    read is what was seen, and maps can be fused again, with another raster for example.
    """
    images = view.cameras.values()
    return {
        "joints": view.joints,
        "opening_m": view.opening_m,
        "intrinsics": np.array([i.camera.intrinsics.matrix() for i in images]),
        "world_from_camera": np.array(
            [image.camera.world_from_camera.matrix() for image in images]
        ),
        "rgb": np.array([image.rgb for image in images]),
        "depth": np.array([encode_depth(image.depth_m) for image in images]),
        "map_rgb": view.rgb,
        "map_height": RASTER.encode_height(view.height_m, view.coverage),
    }


@lru_cache(maxsize=1)
def _rig(width: int, height: int) -> CameraRig:
    """Return the cameras of this process: starting them takes longer than a picture."""
    return CameraRig(width, height)


def _episode_columns(record: EpisodeRecord, instance: Instance) -> Row:
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
    """Return how many keyframes there are to see: those that have a label."""
    if isinstance(record, PerturbedRecord):
        return record.labelled
    return record.keyframes


def _labels(record: EpisodeRecord, keyframe: int) -> Row:
    """Return what comes next; in perturbed executions what should, and what came."""
    done = {**label(record, keyframe), **_poses(record, keyframe)}
    if not isinstance(record, PerturbedRecord):
        return done
    last = keyframe == len(record.subtasks)
    return {
        **{f"{EXECUTED}{name}": done[name] for name in _DECISION},
        "perturbation": NONE if last else record.perturbation[keyframe],
        "outcome": done["outcome"],
        **expert_label(record, keyframe),
    }


def _poses(record: EpisodeRecord, keyframe: int) -> Row:
    """Return the poses of the next sub-task; NaN at the end."""
    if keyframe == len(record.subtasks):
        nowhere = (math.nan,) * 3
        return {"pick_pose": nowhere, "place_pose": nowhere, "outcome": _STOPPED}
    row = record.subtasks[keyframe]
    return {
        "pick_pose": row.pick_pose,
        "place_pose": row.place_pose,
        "outcome": row.outcome,
    }


def _check_state(record: EpisodeRecord, keyframe: int) -> None:
    state = record.keyframe_state[keyframe]
    if hashlib.sha256(state).hexdigest() != record.keyframe_sha256[keyframe]:
        raise DatasetError(
            f"The state of keyframe {keyframe} of {record.key} is damaged. Delete its "
            "file of the recipe and run 'lemma generate' again."
        )


_CARD = """# Rendered keyframes of LEMMA Bench

The scene before each sub-task and at the end of every episode of a recipe, as the
robots' cameras ({width} x {height} px) see it, and from above. `lemma render --form
keyframes` made this from the recipe; `manifest.json` holds the checksum of every file.

Files are Arrow IPC, one record batch per keyframe; `maps/` and `cameras/` hold the same
keyframes in the same order. Train on the sentences `high_level` and `human`, never on
`unseen`.

{columns}
"""
