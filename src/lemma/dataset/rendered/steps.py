"""An episode step by step, at any rate: the recipe's sub-tasks are executed again.

A recipe holds keyframes only. The motion between them is computed: the same sub-tasks
from the same start give the same motion to the bit, and the hashes of the keyframes
prove it for every episode.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.dataset.playback import play_steps
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.teleoperation import TeleoperatedRecord, perform
from lemma.env.episode import Episode
from lemma.env.observation import object_poses
from lemma.env.simulation import TICK_S
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance

NO_SUBTASK = -1
"""Index of the sub-task where none is executed: at the end."""

_TICKS_PER_S = round(1.0 / TICK_S)


@dataclass(frozen=True, slots=True)
class DenseStep:
    """One moment of an episode, and the command that follows."""

    index: int
    """Number of the step, from 0."""
    time_s: float
    """Simulated time: ``index / hz`` [s]."""
    scene: Scene
    """The world as it is at this step, ready to render; until the next step."""
    joints: FloatArray
    """Measured joint angles [rad], shape (robots, 6)."""
    joint_velocities: FloatArray
    """Measured joint velocities [rad/s], shape (robots, 6)."""
    opening_m: FloatArray
    """Measured openings of the grippers [m], shape (robots,)."""
    objects: dict[str, FloatArray]
    """Position [m] and quaternion wxyz of every object by name, shape (7,)."""
    tcp_poses: FloatArray
    """World from gripper at each tool centre point, shape (robots, 4, 4) [m]."""
    action: FloatArray
    """Command that leads to the next step, shape (robots, 7): targets of the joints
    [rad] and opening of the gripper [m]. At the last step, the command in force."""
    waypoints: FloatArray
    """Targets of the tool centre points at the next step, shape (robots, 4, 4): the end
    of a motion, or a point on a straight line [m]."""
    subtask: int
    """Which of the record's sub-tasks is executed next; -1 at the end."""
    progress: float
    """Fraction of the goal that holds."""
    reward: float
    """1 at the end of an episode that succeeded, else 0."""
    is_done: bool
    """Whether this is the last step."""


@dataclass(frozen=True, slots=True)
class _Sample:
    """The simulation at a step."""

    state: FloatArray
    command: FloatArray
    waypoints: FloatArray


def ticks_per_step(hz: int) -> int:
    """Return how many servo ticks lie between two steps.

    Args:
        hz: Steps per simulated second.

    Raises:
        InvalidConfigError: Servo ticks cannot be divided evenly.
    """
    if hz < 1 or _TICKS_PER_S % hz:
        valid = [n for n in range(1, _TICKS_PER_S + 1) if _TICKS_PER_S % n == 0]
        raise InvalidConfigError(
            f"Steps at {hz} Hz do not fall on the {_TICKS_PER_S} servo ticks of a "
            f"second. Choose one of {', '.join(map(str, valid))}; 10 is common."
        )
    return _TICKS_PER_S // hz


def iterate_steps(record: EpisodeRecord, hz: int = 10) -> Iterator[DenseStep]:
    """Yield an episode step by step, from its first state to its end.

    The whole episode is executed first. Then the scene is set to one step after the
    other, so that changing it does not disturb the motion. Steps are evenly spaced. The
    last one is the first at which the episode is over, up to one step later than the
    last keyframe, with the robots at rest.

    Args:
        record: The episode.
        hz: Steps per simulated second: a divisor of 100.

    Raises:
        InvalidConfigError: Servo ticks cannot be divided evenly.
        DatasetError: The motion is not the recorded one.
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
        play_steps(episode, [row.grounded for row in record.subtasks], begin)
    current = NO_SUBTASK
    while len(owners) % stride:
        simulation.tick()
    return samples, owners


def _check(scene: Scene, record: EpisodeRecord, keyframe: int) -> None:
    if scene.state_hash() != record.keyframe_sha256[keyframe]:
        raise DatasetError(
            f"{record.key} drifts at keyframe {keyframe}: here the recorded sub-tasks "
            "lead to another state. See 'lemma replay --validate'; the recipe must be "
            "read with the versions that it was written with."
        )
