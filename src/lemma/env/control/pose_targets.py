"""Postures for arms that are commanded by poses, in one call for all arms."""

import math

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.env.control.guarded_arm import CAPSULES
from lemma.env.control.safety_filter import transform
from lemma.motion.arm_motion import POSTURE_ALONE, choose_posture

SWING_RAD = 0.25
"""An arm whose base has further to turn than this swings round first."""


@kernel
def aim_arms(
    records: np.ndarray,
    states: FloatArray,
    parks: FloatArray,
    rows: FloatArray,
    workspaces: np.ndarray,
) -> None:
    """Choose postures for poses, and give both to RMPflow.

    Args:
        records: Records of n arms; see :data:`~lemma.env.control.guarded_arm.ARM`.
        states: Their references, (n, 2, 6) [rad, rad/s].
        parks: Where they wait, (n, 6) [rad].
        rows: Positions and quaternions wxyz of any length but 0 that the tool centre
            points shall have in the world, (n, 8) [m]; the last number does not matter.
        workspaces: The records of RMPflow, (n,); their goals are written.
    """
    pose, unit = np.eye(4), np.empty(7)
    for k in range(records.shape[0]):
        arm, row, goal = records[k], rows[k], workspaces[k].goal
        norm = 0.0
        for i in range(3, 7):
            norm += row[i] * row[i]
        norm = math.sqrt(norm)
        for i in range(7):
            unit[i] = row[i] if i < 3 else row[i] / norm
        transform(unit, pose)
        for i in range(3):
            goal.position[i] = pose[i, 3]
            for j in range(3):
                goal.rotation[i, j] = pose[i, j]
        goal.posture[:] = states[k, 0]
        goal.target_weight = 1.0
        goal.posture_weight = 1.0
        links, capsules = arm.parts[:CAPSULES, 7], arm.parts[:CAPSULES, :7]
        choose_posture(
            arm.dh,
            arm.world_from_base,
            links,
            capsules,
            arm.range,
            parks[k],
            states[k, 0],
            pose,
            goal.posture,
        )


@kernel
def swing_far(states: FloatArray, workspaces: np.ndarray) -> None:
    """Lead arms whose base has far to turn through joint space, others straight.

    Args:
        states: The references of n arms, (n, 2, 6) [rad, rad/s].
        workspaces: The records of RMPflow, (n,), each with a posture; their weights are
            written.
    """
    for k in range(states.shape[0]):
        goal = workspaces[k].goal
        far = abs(goal.posture[0] - states[k, 0, 0]) > SWING_RAD
        goal.target_weight = 0.0 if far else 1.0
        goal.posture_weight = POSTURE_ALONE if far else 1.0
