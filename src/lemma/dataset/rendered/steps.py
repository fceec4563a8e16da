"""Steps of an episode at any rate, from a repeated execution of its sub-tasks.

A recipe contains only keyframes. The motion between them is simulated again: the same
sub-tasks from the same initial state give the same motion, bit for bit. The hashes of
the keyframes are compared for every episode.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.dataset.recipe.replay import play_record
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.teleoperation import TeleoperatedRecord, perform
from lemma.env.episode import Episode
from lemma.env.observation import object_poses
from lemma.scene.build import TICK_S
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance

NO_SUBTASK = -1
"""Index of the sub-task at the end, where none is executed."""

_TICKS_PER_S = round(1.0 / TICK_S)


@dataclass(frozen=True, slots=True)
class DenseStep:
    """The state at one step of an episode, and the next command."""

    index: int
    """Number of the step, from 0."""
    time_s: float
    """Simulated time: ``index / hz`` [s]."""
    scene: Scene
    """The scene at this step, ready to render; valid until the next step."""
    joints: FloatArray
    """Measured joint angles [rad], shape (robots, 6)."""
    joint_velocities: FloatArray
    """Measured joint velocities [rad/s], shape (robots, 6)."""
    opening_m: FloatArray
    """Measured openings of the grippers [m], shape (robots,)."""
    objects: dict[str, FloatArray]
    """Position [m] and quaternion wxyz in the world's frame of every object by name,
    shape (7,)."""
    tcp_poses: FloatArray
    """Tool centre points in the world's frame, shape (robots, 4, 4) [m]."""
    action: FloatArray
    """Command that leads to the next step, shape (robots, 7): targets of the joints
    [rad] and opening of the gripper [m]. At the last step, the present command."""
    waypoints: FloatArray
    """Targets of the tool centre points at the next step in the world's frame, shape
    (robots, 4, 4): the end of a motion, or a point on a straight line [m]."""
    subtask: int
    """Index of the record's sub-task that is executed next; -1 at the end."""
    progress: float
    """Fraction of the goal that holds."""
    reward: float
    """1 at the end of a successful episode, otherwise 0."""
    is_done: bool
    """Whether this is the last step."""


@dataclass(frozen=True, slots=True)
class _Sample:
    """The state of the simulation at a step."""

    state: FloatArray
    command: FloatArray
    waypoints: FloatArray


def ticks_per_step(hz: int) -> int:
    """Return the number of servo ticks per step.

    Args:
        hz: Steps per simulated second.

    Raises:
        InvalidConfigError: The number is not an integer.
    """
    if hz < 1 or _TICKS_PER_S % hz:
        valid = [n for n in range(1, _TICKS_PER_S + 1) if _TICKS_PER_S % n == 0]
        raise InvalidConfigError(
            f"{hz} Hz does not divide the {_TICKS_PER_S} servo ticks of a second. "
            f"Choose one of {', '.join(map(str, valid))}; 10 is common."
        )
    return _TICKS_PER_S // hz


def iterate_steps(record: EpisodeRecord, hz: int = 10) -> Iterator[DenseStep]:
    """Yield an episode step by step, from its first state to its end.

    The whole episode is executed first. Then the scene is set to each step, so changes
    of the scene do not affect the motion. Steps are evenly spaced. The last step is the
    first one at which the episode is over, at most one step later than the last
    keyframe, with the robots at rest.

    Args:
        record: The episode.
        hz: Steps per simulated second: a divisor of 100.

    Raises:
        InvalidConfigError: ``hz`` does not divide 100.
        DatasetError: The replayed motion differs from the recorded one.
    """
    stride = ticks_per_step(hz)
    episode = Episode(Instance.from_dict(record.instance_data()))
    samples, owners = _execute(episode, record, stride)
    scene = episode.simulation.scene
    arms = tuple(episode.simulation.arms.values())
    last = len(samples) - 1
    for index, sample in enumerate(samples):
        scene.restore(sample.state)
        is_done = index == last
        yield DenseStep(
            index=index,
            time_s=index / hz,
            scene=scene,
            joints=np.array([scene.data.qpos[r.qpos] for r in scene.robots]),
            joint_velocities=np.array([scene.data.qvel[r.dof] for r in scene.robots]),
            opening_m=np.array([scene.opening_m(robot) for robot in scene.robots]),
            objects=object_poses(scene),
            tcp_poses=np.array([arm.tcp_pose() for arm in arms]),
            action=samples[min(index + 1, last)].command,
            waypoints=samples[min(index + 1, last)].waypoints,
            subtask=NO_SUBTASK if is_done else owners[index * stride],
            progress=episode.instance.goal.progress(scene),
            reward=1.0 if is_done and record.success else 0.0,
            is_done=is_done,
        )


def _execute(
    episode: Episode, record: EpisodeRecord, stride: int
) -> tuple[list[_Sample], list[int]]:
    """Return samples at every ``stride`` ticks, and the sub-task of every tick."""
    simulation = episode.simulation
    scene = simulation.scene
    samples: list[_Sample] = []
    owners: list[int] = []
    current = 0

    def keep() -> None:
        arms = simulation.arms.values()
        commands = [
            [*arm.state[0].tolist(), float(scene.data.ctrl[arm.robot.gripper_ctrl])]
            for arm in arms
        ]
        waypoints = [arm.aim_pose() for arm in arms]
        samples.append(
            _Sample(scene.snapshot(), np.array(commands), np.array(waypoints))
        )

    def observe() -> None:
        owners.append(current)
        if len(owners) % stride == 0:
            keep()

    keep()
    simulation.observers.append(observe)

    def begin(number: int) -> None:
        nonlocal current
        current = number
        _check(scene, record, number)

    if isinstance(record, TeleoperatedRecord):
        perform(record.done, episode, begin)
    else:
        play_record(episode, record, begin)
    current = NO_SUBTASK
    while len(owners) % stride:
        simulation.tick()
    return samples, owners


def _check(scene: Scene, record: EpisodeRecord, keyframe: int) -> None:
    if scene.state_hash() != record.keyframe_sha256[keyframe]:
        raise DatasetError(
            f"{record.key} drifts at keyframe {keyframe}: here the recorded sub-tasks "
            "lead to another state. See 'lemma replay --validate'; read the recipe "
            "with the versions that wrote it."
        )
