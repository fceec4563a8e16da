"""Arms, goals and leaves for the tests of RMPflow: no simulator needed."""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from lemma.core.poses import FloatArray
from lemma.motion.rmpflow.collision import collision_memory
from lemma.motion.rmpflow.leaves import Leaves
from lemma.motion.rmpflow.policy import accelerate as policy_accelerate
from lemma.motion.rmpflow.policy import integrate
from lemma.motion.rmpflow.workspace import ArmModel, ArmTarget, Workspace
from lemma.robots.collision_model import envelope_of, segment_distance
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.reach import gripper_ik
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.kinematics import frames, top_down

ARM_NAMES = ("ur5", "ur10")
ZEROS = (0.0, 0.0, 0.0)
ELBOW_UP = (0.0, -1.4, 1.8, -1.97, -1.57, 0.0)
NO_OBSTACLES: FloatArray = np.zeros((0, 8))
SUBSTEP_S = 0.0025


def arm_model(name: str) -> ArmModel:
    """Return the arm at the origin, as an ``ArmMotion`` makes it."""
    arm, envelope = ARMS[name], envelope_of(name)
    limits = np.array(arm.joint_range)
    return ArmModel(
        dh=arm.dh,
        world_from_base=np.eye(4),
        tcp_offset_m=TCP_OFFSET_M,
        lower=-limits,
        upper=limits,
        velocity_limits=np.array(arm.velocity_limits),
        sphere_links=envelope.sphere_links,
        spheres=envelope.spheres,
        sphere_meets_table=envelope.sphere_meets_table,
    )


def posture_goal(posture: FloatArray, weight: float = 1.0) -> ArmTarget:
    """Return a goal of the posture alone."""
    return ArmTarget(np.zeros(3), np.eye(3), posture, 0.0, weight)


def pose_goal(pose: FloatArray, posture: FloatArray) -> ArmTarget:
    """Return a goal of the tool centre point, with a posture to prefer."""
    return ArmTarget(
        np.ascontiguousarray(pose[:3, 3]),
        np.ascontiguousarray(pose[:3, :3]),
        posture,
        1.0,
        1.0,
    )


def state_at(
    q: Sequence[float] | FloatArray, qd: FloatArray | None = None
) -> FloatArray:
    """Return joint angles and velocities, (2, 6)."""
    return np.array([q, np.zeros(6) if qd is None else qd], dtype=float)


def only(*names: str) -> Leaves:
    """Return leaves of which all but the named ones weigh nothing."""
    weights = {
        "target": {"near_metric": 0.0, "far_metric": 0.0},
        "axis": {"metric": 0.0},
        "posture": {"metric": 0.0, "inertia": 0.0},
        "joint_limit": {"metric": 0.0},
        "velocity_cap": {"metric": 0.0},
        "collision": {"metric": 0.0},
        "damping": {"metric": 0.0, "inertia": 0.0},
    }
    everything = Leaves(max_acceleration=1e9)
    return everything._replace(
        **{
            name: getattr(everything, name)._replace(**without)
            for name, without in weights.items()
            if name not in names
        }
    )


def move(
    model: ArmModel,
    state: FloatArray,
    goal: ArmTarget,
    seconds: float,
    *,
    obstacles: FloatArray = NO_OBSTACLES,
    parameters: Leaves | None = None,
) -> FloatArray:
    """Advance ``state`` and return it as it was after every substep, (n, 2, 6)."""
    root = Workspace()
    root.load(model, goal, parameters or Leaves())
    history = []
    for _ in range(round(seconds / SUBSTEP_S)):
        integrate(root.record, root.spheres, state, obstacles, SUBSTEP_S, 1)
        history.append(state.copy())
    return np.array(history)


def links(model: ArmModel, q: FloatArray) -> FloatArray:
    """Return world from link frames, (7, 4, 4)."""
    out = np.empty((7, 4, 4))
    frames(model.dh, model.world_from_base, np.ascontiguousarray(q), out)
    return out


def tcp(model: ArmModel, q: FloatArray) -> FloatArray:
    """Return world from gripper at the tool centre point, (4, 4)."""
    pose: FloatArray = links(model, q)[6]
    pose[:3, 3] += TCP_OFFSET_M * pose[:3, 2]
    return pose


def errors(pose: FloatArray, goal: FloatArray) -> tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses."""
    cosine = 0.5 * (float((pose[:3, :3] * goal[:3, :3]).sum()) - 1.0)
    distance = float(np.linalg.norm(pose[:3, 3] - goal[:3, 3]))
    return distance, math.acos(min(1.0, max(-1.0, cosine)))


def nearest_posture(name: str, pose: FloatArray, q: FloatArray) -> FloatArray:
    """Return the joint angles nearest to ``q`` that reach a pose of the gripper."""
    solutions = gripper_ik(name, np.eye(4), pose)
    solutions += math.tau * np.round((q - solutions) / math.tau)
    nearest: FloatArray = solutions[np.abs(solutions - q).max(axis=1).argmin()]
    return nearest


def ready(name: str, radius: float, bearing: float, height: float) -> FloatArray:
    """Return joint angles with the elbow up and the gripper pointing down."""
    x, y = radius * math.cos(bearing), radius * math.sin(bearing)
    for q in gripper_ik(name, np.eye(4), top_down(x, y, height, bearing)):
        shoulder, elbow, wrist = links(arm_model(name), q)[1:4, 2, 3]
        if elbow > 0.5 * (shoulder + wrist) and q[4] < 0:
            found: FloatArray = q
            return found
    raise AssertionError(f"{name} cannot be at {radius}, {bearing}, {height}")


def sphere_gaps(name: str, q: FloatArray, obstacles: FloatArray) -> FloatArray:
    """Return the distance of every collision sphere to the nearest obstacle [m]."""
    envelope = envelope_of(name)
    placed, gaps = links(arm_model(name), q), []
    for link, sphere in zip(envelope.sphere_links, envelope.spheres, strict=True):
        centre = (placed[int(link)] @ [*sphere[:3], 1.0])[:3]
        point = np.array([*centre, *centre])
        distances = [segment_distance(point, row) - row[6] for row in obstacles]
        gaps.append(min(distances) - sphere[3])
    return np.array(gaps)


def acceleration(
    goal: ArmTarget,
    parameters: Leaves,
    state: FloatArray,
    model: ArmModel | None = None,
    obstacles: FloatArray = NO_OBSTACLES,
    root: Workspace | None = None,
) -> FloatArray:
    """Return the joint accelerations that all leaves agree on, (6,)."""
    root, out = root or Workspace(), np.empty(6)
    root.load(model or arm_model("ur5"), goal, parameters)
    _accelerate_array(root.record, root.spheres, state, obstacles, out)
    return out


@njit(error_model="numpy")
def _accelerate_array(
    record: np.ndarray,
    spheres: FloatArray,
    state: FloatArray,
    obstacles: FloatArray,
    out: FloatArray,
) -> None:
    memory = collision_memory(spheres, obstacles)
    policy_accelerate(record[0], spheres, state, obstacles, memory, out)
