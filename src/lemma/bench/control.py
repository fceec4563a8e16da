"""The figures of the control level: steps per second, beside those of bare physics.

A control step is an action for all robots and 50 ms of simulation: ten physics steps,
or ``mj_step`` and nothing else. Both are timed in turns, from the same states, so that
their ratio says the same on a busy machine as on an idle one.
"""

import statistics
import time
from dataclasses import dataclass

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.poses import FloatArray
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.scene.build import TIME_STEP_S
from lemma.tasks.instance import Instance

HZ = 20.0
"""Control steps per simulated second."""
IMAGE_SIZE = (320, 240)
_KEPT_STEPS = 7
"""How long a random action is kept up."""


@dataclass(frozen=True, slots=True)
class ControlFigures:
    """How fast environments at the control level step, with random actions."""

    bare_physics_hz: float
    """Ten ``mj_step`` per control step, and nothing else [control steps/s]."""
    joint_position_hz: float
    """``step`` with joint angles, without images [steps/s]."""
    joint_position_ratio: float
    """The same over bare physics in the same states; the median of all steps."""
    ee_pose_hz: float
    """``step`` with poses of the tool centre points, without images [steps/s]."""
    ee_pose_ratio: float
    """The same over bare physics."""
    rgbd_hz: float
    """``step`` with joint angles and two cameras, RGB and depth [steps/s]."""


def measure_control(instance: Instance, steps: int = 200) -> ControlFigures:
    """Measure the control level.

    Args:
        instance: The scene.
        steps: Control steps of each measurement; a fifth of them with images.
    """
    angles, bare = time_steps(instance, steps, "joint_position")
    poses, bare_poses = time_steps(instance, steps, "ee_pose")
    rgbd, _ = time_steps(instance, max(1, steps // 5), "joint_position", "rgbd")
    return ControlFigures(
        bare_physics_hz=1.0 / float(np.median(bare)),
        joint_position_hz=1.0 / float(np.median(angles)),
        joint_position_ratio=statistics.median(bare / angles),
        ee_pose_hz=1.0 / float(np.median(poses)),
        ee_pose_ratio=statistics.median(bare_poses / poses),
        rgbd_hz=1.0 / float(np.median(rgbd)),
    )


def time_steps(
    instance: Instance, steps: int, control: str, observation: str = "state"
) -> tuple[FloatArray, FloatArray]:
    """Return the time of each step, and of bare physics from the same state [s].

    Args:
        instance: The scene.
        steps: How many.
        control: Control mode.
        observation: Mode of observation.
    """
    width, height = IMAGE_SIZE
    env = ControlEnv(
        EnvConfig(
            task=instance.task,
            control=control,
            control_hz=HZ,
            observation=observation,
            width=width,
            height=height,
        )
    )
    env.reset(options={"instance": instance})
    rng = np.random.default_rng(0)
    layout = env.action_layout
    scene = env.episode.simulation.scene
    spare = mujoco.MjData(scene.model)
    times: list[tuple[float, float]] = []
    action = rng.uniform(layout.low, layout.high, layout.shape)
    # The thread's own time says the same on a busy machine; OpenGL has other threads.
    clock = time.thread_time if observation == "state" else time.perf_counter
    # The first warms up.
    for step in range(steps + 1):
        if step % _KEPT_STEPS == 0:
            action = rng.uniform(layout.low, layout.high, layout.shape)
        mujoco.mj_copyData(spare, scene.model, scene.data)
        start = clock()
        for _ in range(round(1.0 / HZ / TIME_STEP_S)):
            mujoco.mj_step(scene.model, spare)
        middle = clock()
        env.step(action)
        times.append((clock() - middle, middle - start))
    env.close()
    found = np.array(times[1:])
    return found[:, 0], found[:, 1]
