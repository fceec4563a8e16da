"""Teleoperated episodes: sub-tasks of a policy, motor commands by hand, and their file.

Motor commands have no place in a recipe. The file of a teleoperated episode holds the
instance and all steps, and :func:`lemma.dataset.teleoperation.perform.perform` plays it
again, to the bit. Readers of instances read it, too.
"""

import json
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TypedDict

import msgspec
import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray, Pose2
from lemma.dataset.playback import MotorCommands
from lemma.env.episode import STILL_S
from lemma.env.simulation import HORIZON_S, TICK_S
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

KEY = "done"
"""Key of the steps, beside the fields of the instance."""
LED = "Led by hand"
"""Words for motor commands that were given by hand."""
LONGEST_S = HORIZON_S + STILL_S + TICK_S
"""The longest episode, with its verdict and a tick [s]."""
_Pose = tuple[float, float, float]


class _Executed(TypedDict):
    start_s: float
    robot: str
    primitive: Primitive
    pick: str
    place: str
    pick_pose: _Pose
    place_pose: _Pose
    until_s: float | None


class _Commanded(TypedDict):
    start_s: float
    control: str
    control_hz: float
    rows: list[list[list[float]]]


class _Nudged(TypedDict):
    time_s: float
    name: str
    pose: _Pose


class _Data(TypedDict):
    instruction: str
    executed: list[_Executed]
    commanded: list[_Commanded]
    nudged: list[_Nudged]
    end_s: float
    end_sha256: str


@dataclass(frozen=True, slots=True)
class Executed:
    """A sub-task that a policy executed."""

    start_s: float
    """Simulated time at which it began [s]."""
    subtask: SubTask
    grounded: GroundedSubTask
    until_s: float | None = None
    """Simulated time at which it was broken off, because somebody took over [s]; None
    if it came to its end."""


@dataclass(frozen=True, slots=True)
class Commanded(MotorCommands):
    """Motor commands that somebody gave by hand."""

    start_s: float
    """Simulated time of the first one [s]."""


@dataclass(frozen=True, slots=True)
class Nudged:
    """An object that somebody moved by hand."""

    time_s: float
    """Simulated time [s]."""
    name: str
    pose: Pose2


@dataclass(frozen=True)
class Teleoperation:
    """An episode of a policy and of somebody who took over."""

    instance: Instance
    instruction: str
    """The spoken sentence."""
    parts: tuple[Executed | Commanded, ...]
    """Steps of the robots, in order."""
    nudged: tuple[Nudged, ...]
    """Objects that somebody moved meanwhile, in order."""
    end_s: float
    """Simulated time to which it goes [s]."""
    end_sha256: str
    """Digest of the joints' positions then, see :func:`joints_sha256`."""

    def to_json(self) -> str:
        """Return it as a file; what reads an instance reads it too."""
        parts = self.parts
        told = {
            "instruction": self.instruction,
            "executed": [
                {
                    "start_s": part.start_s,
                    **part.subtask.to_dict(),
                    "pick_pose": _numbers(part.grounded.pick),
                    "place_pose": _numbers(part.grounded.place),
                    "until_s": part.until_s,
                }
                for part in parts
                if isinstance(part, Executed)
            ],
            "commanded": [
                {
                    "start_s": part.start_s,
                    "control": part.control,
                    "control_hz": part.control_hz,
                    "rows": [np.asarray(row, float).tolist() for row in part.rows],
                }
                for part in parts
                if isinstance(part, Commanded)
            ],
            "nudged": [
                {
                    "time_s": nudged.time_s,
                    "name": nudged.name,
                    "pose": _numbers(nudged.pose),
                }
                for nudged in self.nudged
            ],
            "end_s": self.end_s,
            "end_sha256": self.end_sha256,
        }
        return json.dumps({**self.instance.to_dict(), KEY: told}) + "\n"

    @classmethod
    def load(cls, path: Path) -> "Teleoperation":
        """Read a file.

        Raises:
            InvalidConfigError: It cannot be read, or does not say what was done.
            UnknownNameError: Its instance names something that does not exist.
        """
        instance = Instance.load(path)
        data = json.loads(path.read_bytes()).get(KEY)
        try:
            found = msgspec.convert(data, _Data)
        except (msgspec.ValidationError, RecursionError) as error:
            raise InvalidConfigError(
                f"{path} holds an instance, but not what was done by hand: {error}. "
                "lemma play saves such files."
            ) from None
        parts: list[Executed | Commanded] = [
            _executed(part) for part in found["executed"]
        ]
        for part in found["commanded"]:
            rows = [np.asarray(row, float) for row in part["rows"] if row]
            if not rows or any(row.shape != rows[0].shape for row in rows):
                raise InvalidConfigError(f"{path}: motor commands have no one shape.")
            parts.append(
                Commanded(part["control"], part["control_hz"], rows, part["start_s"])
            )
        if not parts:
            raise InvalidConfigError(f"{path}: nothing was done.")
        if not 0.0 < found["end_s"] <= LONGEST_S:
            raise InvalidConfigError(
                f"{path} goes to {found['end_s']:g} s. Episodes end within "
                f"{LONGEST_S:g} s."
            )
        nudged = (
            Nudged(each["time_s"], each["name"], Pose2(*each["pose"]))
            for each in found["nudged"]
        )
        return cls(
            instance,
            found["instruction"],
            tuple(sorted(parts, key=lambda part: part.start_s)),
            tuple(nudged),
            found["end_s"],
            found["end_sha256"],
        )


def _numbers(pose: Pose2) -> list[float]:
    return [pose.x, pose.y, pose.yaw]


def _executed(part: _Executed) -> Executed:
    who = part["robot"], part["primitive"]
    poses = Pose2(*part["pick_pose"]), Pose2(*part["place_pose"])
    return Executed(
        part["start_s"],
        SubTask(*who, part["pick"], part["place"]),
        GroundedSubTask(*who, *poses),
        part["until_s"],
    )


def is_teleoperated(path: Path) -> bool:
    """Return whether a file claims to be a teleoperated episode."""
    try:
        data = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(data, dict) and KEY in data


def joints_sha256(qpos: FloatArray) -> str:
    """Return the SHA-256 of joints' positions, (nq,), as little-endian float64."""
    return sha256(np.asarray(qpos, "<f8").tobytes()).hexdigest()
