"""Teleoperated episodes: sub-tasks of a policy, motor commands by hand, and their file.

A recipe cannot store motor commands. The file of a teleoperated episode contains the
instance and all steps, and :func:`perform` plays it again, bit for bit. Readers of
instances can read it as well. :func:`read_record` returns it as a record, which can be
rendered like those of a recipe.
"""

import json
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TypedDict

import msgspec
import numpy as np

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.poses import FloatArray, Pose, Pose2
from lemma.dataset.playback import MotorCommands, Watcher, carry_out, unwatched
from lemma.dataset.recipe.record import EpisodeRecorder, in_names, pose_row
from lemma.dataset.recipe.schema import EpisodeRecord, SubTaskRecord
from lemma.env.episode import STILL_S, Episode
from lemma.env.simulation import HORIZON_S, Simulation
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.build import TICK_S
from lemma.scene.objects.bodies import resting_quaternion
from lemma.scene.objects.entity import entity_named
from lemma.scene.overlaps import check_place
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

KEY = "done"
"""Key of the steps in the file, next to the fields of the instance."""
LED = "Led by hand"
"""Description of motor commands by hand."""
LONGEST_S = HORIZON_S + STILL_S + TICK_S
"""Largest simulated duration of an episode, with the rest at its end and a tick [s]."""
_EARLY_S = 0.5 * TICK_S
_Pose = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Executed:
    """A sub-task that a policy executed, as stored in the file."""

    start_s: float
    """Simulated time at which it began [s]."""
    robot: str
    primitive: Primitive
    pick: str
    place: str
    pick_pose: _Pose
    """Gripper at the grasp, in the world's frame: x, y [m], yaw [rad]."""
    place_pose: _Pose
    """Gripper at the end of the motion, in the world's frame: x, y [m], yaw [rad]."""
    until_s: float | None
    """Simulated time at which a takeover interrupted it [s]; None if it was
    finished."""

    @classmethod
    def begin(
        cls, start_s: float, subtask: SubTask, grounded: GroundedSubTask
    ) -> "Executed":
        """Return a sub-task that begins at a simulated time [s]."""
        poses = pose_row(grounded.pick), pose_row(grounded.place)
        names = subtask.robot, subtask.primitive, subtask.pick, subtask.place
        return cls(start_s, *names, *poses, until_s=None)

    @property
    def subtask(self) -> SubTask:
        """The sub-task with names."""
        return SubTask(self.robot, self.primitive, self.pick, self.place)

    @property
    def grounded(self) -> GroundedSubTask:
        """The sub-task with poses, for execution."""
        poses = Pose2(*self.pick_pose), Pose2(*self.place_pose)
        return GroundedSubTask(self.robot, self.primitive, *poses)


@dataclass(frozen=True, slots=True)
class Commanded(MotorCommands):
    """Motor commands that a visitor gave by hand."""

    start_s: float
    """Simulated time of the first command [s]."""


@dataclass(frozen=True, slots=True)
class Nudged:
    """A motion of an object by a visitor."""

    time_s: float
    """Simulated time [s]."""
    name: str
    pose: _Pose
    """New pose in the world's frame: x, y [m], yaw [rad]."""


class _Commanded(TypedDict):
    start_s: float
    control: str
    control_hz: float
    rows: list[list[list[float]]]


class _Data(TypedDict):
    instruction: str
    executed: list[Executed]
    commanded: list[_Commanded]
    nudged: list[Nudged]
    end_s: float
    end_sha256: str


@dataclass(frozen=True)
class Teleoperation:
    """An episode of a policy and of a visitor who took over."""

    instance: Instance
    instruction: str
    """The visitor's sentence."""
    parts: tuple[Executed | Commanded, ...]
    """Steps of the robots, in order."""
    nudged: tuple[Nudged, ...]
    """Motions of objects by the visitor, in order."""
    end_s: float
    """Simulated time of its end [s]."""
    end_sha256: str
    """Digest of the joint positions at its end, see :func:`joints_sha256`."""

    def to_json(self) -> str:
        """Return the content of a file, which is also valid as an instance's file."""
        commanded: list[_Commanded] = [
            {
                "start_s": part.start_s,
                "control": part.control,
                "control_hz": part.control_hz,
                "rows": [np.asarray(row, float).tolist() for row in part.rows],
            }
            for part in self.parts
            if isinstance(part, Commanded)
        ]
        recording: _Data = {
            "instruction": self.instruction,
            "executed": [part for part in self.parts if isinstance(part, Executed)],
            "commanded": commanded,
            "nudged": [*self.nudged],
            "end_s": self.end_s,
            "end_sha256": self.end_sha256,
        }
        data = {**self.instance.to_dict(), KEY: msgspec.to_builtins(recording)}
        return json.dumps(data) + "\n"

    @classmethod
    def load(cls, path: Path) -> "Teleoperation":
        """Read a file.

        Raises:
            InvalidConfigError: The file cannot be read, or has no valid steps.
            UnknownNameError: Its instance has an unknown name.
        """
        instance = Instance.load(path)
        data = json.loads(path.read_bytes()).get(KEY)
        try:
            found = msgspec.convert(data, _Data)
        except (msgspec.ValidationError, RecursionError) as error:
            raise InvalidConfigError(
                f"{path} has an instance, but no valid steps by hand: {error}. lemma "
                "play saves such files."
            ) from None
        parts: list[Executed | Commanded] = [*found["executed"]]
        for part in found["commanded"]:
            rows = [np.asarray(row, float) for row in part["rows"] if row]
            if not rows or any(row.shape != rows[0].shape for row in rows):
                raise InvalidConfigError(f"{path}: motor commands differ in shape.")
            parts.append(
                Commanded(part["control"], part["control_hz"], rows, part["start_s"])
            )
        if not parts:
            raise InvalidConfigError(f"{path}: there are no steps.")
        if not 0.0 < found["end_s"] <= LONGEST_S:
            raise InvalidConfigError(
                f"{path} ends at {found['end_s']:g} s, but episodes end within "
                f"{LONGEST_S:g} s."
            )
        return cls(
            instance,
            found["instruction"],
            tuple(sorted(parts, key=lambda part: part.start_s)),
            tuple(found["nudged"]),
            found["end_s"],
            found["end_sha256"],
        )


def is_teleoperated(path: Path) -> bool:
    """Return whether a file claims to be a teleoperated episode."""
    try:
        data = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(data, dict) and KEY in data


def joints_sha256(qpos: FloatArray) -> str:
    """Return the SHA-256 of joint positions, (nq,), as little-endian float64."""
    return sha256(np.asarray(qpos, "<f8").tobytes()).hexdigest()


class _ReachedError(Exception):
    """The simulation has reached the time at which a step was interrupted."""


class _Clock:
    """Moves objects and ends steps at the recorded times, between ticks."""

    def __init__(self, simulation: Simulation, done: Teleoperation) -> None:
        self._simulation = simulation
        self._nudged = list(done.nudged)
        self._end_s = done.end_s
        self.until_s: float | None = None
        simulation.observers.append(self._look)

    def stop(self) -> None:
        """Stop observing the simulation."""
        self._simulation.observers.remove(self._look)

    @property
    def at_end(self) -> bool:
        """Whether the simulation has reached the end of the recording."""
        return self._simulation.time_s >= self._end_s - _EARLY_S

    def _look(self) -> None:
        now_s = self._simulation.time_s + _EARLY_S
        while self._nudged and self._nudged[0].time_s <= now_s:
            nudged = self._nudged.pop(0)
            nudge(self._simulation, nudged.name, Pose2(*nudged.pose))
        if self.at_end or (self.until_s is not None and self.until_s <= now_s):
            raise _ReachedError


def perform(
    done: Teleoperation,
    episode: Episode,
    before: Watcher = unwatched,
) -> None:
    """Play a teleoperated episode again, up to the end of the recording.

    Args:
        done: The recording.
        episode: Episode of its instance, in its initial state; afterwards it need not
            be over.
        before: Called before each part.

    Raises:
        LemmaError: A step cannot be executed, since the file was changed.
    """
    simulation = episode.simulation
    clock = _Clock(simulation, done)
    try:
        for number, part in enumerate(done.parts):
            try:
                while simulation.time_s < part.start_s - _EARLY_S:
                    simulation.tick()
                before(number)
                if isinstance(part, Executed):
                    clock.until_s = part.until_s
                    carry_out(episode, part.grounded)
                else:
                    carry_out(episode, part)
            except _ReachedError:
                if clock.at_end:
                    break
            finally:
                clock.until_s = None
        with suppress(_ReachedError):
            while not clock.at_end:
                simulation.tick()
    finally:
        clock.stop()
    before(len(done.parts))


def is_same(done: Teleoperation, episode: Episode) -> bool:
    """Return whether the final state of an episode is the recorded one, bit for bit."""
    return joints_sha256(episode.simulation.scene.data.qpos) == done.end_sha256


def nudge(simulation: Simulation, name: str, pose: Pose2) -> None:
    """Move an object on the table, at rest, between two steps of physics.

    Args:
        simulation: The simulation, between two ticks.
        name: Name of the object.
        pose: New pose in the world's frame.

    Raises:
        InvalidConfigError: The object or the pose is not possible; nothing has moved.
    """
    scene = simulation.scene
    _check_free(simulation, name)
    before, kind = scene.snapshot(), entity_named(name).kind
    position, turned = (*pose.xy, kind.origin_m), resting_quaternion(pose.yaw)
    scene.set_pose(name, Pose(position, turned))
    try:
        check_place(scene, name)
    except InvalidConfigError:
        scene.restore(before)
        raise


def _check_free(simulation: Simulation, name: str) -> None:
    scene, phrase = simulation.scene, entity_named(name).phrase
    if name not in scene.movable_names:
        raise InvalidConfigError(
            f"The {phrase} is fixed. Move it before or after an episode."
        )
    if name in simulation.held().values():
        raise InvalidConfigError(f"The {phrase} is in a gripper. Wait for its release.")
    above = SymbolicState.observe(scene).on_top_of(name)
    if above is not None:
        raise InvalidConfigError(
            f"The {entity_named(above).phrase} lies on the {phrase}. Move that first."
        )


@dataclass(frozen=True, slots=True)
class TeleoperatedRecord(EpisodeRecord):
    """An episode with motor commands besides sub-tasks; see ``done``."""

    done: Teleoperation = field(repr=False)
    """All steps."""


def files_in(place: Path) -> list[Path]:
    """Return the files of teleoperated episodes: a single file, or those of a folder.

    Args:
        place: A file, or a folder; other files in the folder are ignored.
    """
    found = [place] if place.is_file() else sorted(place.glob("*.json"))
    return [path for path in found if is_teleoperated(path)]


def read_record(path: Path) -> TeleoperatedRecord:
    """Read a file, and play it again to get its states.

    Raises:
        DatasetError: The replay leads to another state here.
        LemmaError: The file cannot be read, or a step cannot be executed.
    """
    done = Teleoperation.load(path)
    episode = Episode(done.instance)
    keeper, times = EpisodeRecorder(episode), []

    def keep(number: int) -> None:
        keeper.keep()
        times.append(episode.simulation.time_s)

    perform(done, episode, keep)
    if not is_same(done, episode):
        raise DatasetError(
            f"{path}: its steps lead to another state here. Read it with the versions, "
            "and on the kind of machine, that it was written with."
        )
    ends = (*times[1:-1], done.end_s)
    rows = (
        _row(done.instance, part, end_s - part.start_s)
        for part, end_s in zip(done.parts, ends, strict=True)
    )
    columns = keeper.columns() | {
        "key": f"{done.instance.key}/{path.stem}",
        "high_level": done.instruction,
        "subtasks": tuple(rows),
        "keyframe_time_s": tuple(times),
    }
    return TeleoperatedRecord(**columns, done=done)


def _row(
    instance: Instance, part: Executed | Commanded, duration_s: float
) -> SubTaskRecord:
    if isinstance(part, Commanded):
        nobody = ("", "", "", "", f"{LED}.", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        return SubTaskRecord(*nobody, "by_hand", part.start_s, duration_s)
    return SubTaskRecord(
        **in_names(instance, part.subtask),
        pick_pose=part.pick_pose,
        place_pose=part.place_pose,
        outcome="" if part.until_s is None else "taken_over",
        start_s=part.start_s,
        duration_s=duration_s,
    )
