"""Images and labels before every key pose of an episode.

The expert's key poses are executed again, by the executor that policies use, so that
training and evaluation have the same states. Only the instances of a recipe are read.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from lemma.core.seeding import stream
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.capture import (
    KeyframeForm,
    entities_of,
    entity_poses,
    episode_columns,
    rig_of,
    stored_map,
)
from lemma.dataset.rendered.keyframes import (
    KEY_POSES,
    Header,
    Row,
)
from lemma.env.config import EnvConfig
from lemma.env.control.key_poses import (
    CONTROL,
    CONTROL_HZ,
    FULL_M,
    KeyPose,
    Kind,
    Progress,
    go_on,
    set_out,
)
from lemma.env.control_env import ControlEnv
from lemma.env.observation import object_poses
from lemma.expert.key_poses import next_key_poses
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import STOP, SubTask
from lemma.tasks.suite import FREE_SPLIT

_MOST_KEY_POSES = 40


@dataclass(frozen=True, slots=True)
class KeyPoseForm(KeyframeForm):
    """Maps before every key pose, for policies that predict the next key pose."""

    missed: float = 0.0
    """Share of placements that are missed by some centimetres, which adds frames of
    recovery."""

    def header(self, versions: dict[str, str]) -> Header:
        """Return the header of all files, with settings and versions."""
        settings = {**versions, KEY_POSES: "1", "missed": f"{self.missed:g}"}
        # Not super(): slots create another class.
        return KeyframeForm.header(self, settings)

    def _counted(
        self, records: Sequence[EpisodeRecord]
    ) -> tuple[tuple[int, ...], Iterable[Row]]:
        """Play all episodes first: failed ones have no rows."""
        played = [list(self.rows(record)) for record in records]
        return tuple(map(len, played)), chain.from_iterable(played)

    def rows(self, record: EpisodeRecord) -> Iterator[Row]:
        """Yield a row for each key pose of an episode; none if it fails.

        Args:
            record: The episode.
        """
        instance = Instance.from_dict(record.instance_data())
        constant = episode_columns(record, instance)
        found = list(self._played(instance))
        count = len(found)
        for number, row in enumerate(found):
            yield {**constant, **row, "keyframe": number, "keyframes": count}

    def _played(self, instance: Instance) -> list[Row]:
        env = ControlEnv(
            EnvConfig(
                task=instance.task,
                split=FREE_SPLIT,
                control=CONTROL,
                control_hz=CONTROL_HZ,
                clip_actions=True,
            )
        )
        env.set_table(options={"instance": instance})
        episode = env.episode
        arms = list(episode.simulation.arms.values())
        bases = [arm.robot.world_from_base for arm in arms]
        scene = episode.simulation.scene
        rng = stream("key poses", instance.key)
        hands = [arm.tcp_pose() for arm in arms]
        openings = np.array([scene.opening_m(arm.robot) for arm in arms])
        progress = Progress.begin(hands, openings)
        rows: list[Row] = []
        subtask: SubTask = STOP
        ahead: tuple[KeyPose, ...] = ()
        while len(rows) < _MOST_KEY_POSES:
            if not (ahead and scene.opening_m(arms[ahead[0].robot].robot) > FULL_M):
                subtask, ahead = next_key_poses(episode)
            key, ahead = ahead[0], ahead[1:]
            if key.kind is Kind.STOP:
                return []
            rows.append(self._row(env, subtask, key))
            done = self._missed(key, rng)
            hand = arms[key.robot].tcp_pose()
            progress = set_out(progress, done, hand)
            while True:
                hands = [arm.tcp_pose() for arm in arms]
                progress, chunk = go_on(progress, bases, hands)
                if chunk is None:
                    break
                for action in chunk:
                    _, terminated, truncated = env.advance(action)
                    if terminated or truncated:
                        return rows if episode.is_success else []
        return []

    def _missed(self, key: KeyPose, rng: np.random.Generator) -> KeyPose:
        """Return a key pose, moved at random with probability :attr:`missed`."""
        if key.kind is not Kind.PUT or rng.random() >= self.missed:
            return key
        away, way = rng.uniform(0.02, 0.10), rng.uniform(-math.pi, math.pi)
        x, y = key.x + away * math.cos(way), key.y + away * math.sin(way)
        return replace(key, x=x, y=y)

    def _row(self, env: ControlEnv, subtask: SubTask, key: KeyPose) -> Row:
        scene = env.episode.simulation.scene
        entities = entities_of(env.episode.instance.task)
        return {
            "time_s": env.episode.elapsed_s,
            **subtask.to_dict(),
            "sub_instruction": "",
            "pick_pose": (math.nan,) * 3,
            "place_pose": (math.nan,) * 3,
            "outcome": "",
            "kind": str(key.kind),
            "key_pose": key.stand,
            "objects": entity_poses(object_poses(scene), entities),
            **stored_map(rig_of(self.width, self.height).look(scene)),
        }
