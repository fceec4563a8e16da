"""Where arms shall go that are commanded by poses, in one call for all of them."""

import math

import numpy as np

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.env.control.guarded_arm import CAPSULES
from lemma.motion.arm_motion import choose_posture


@kernel
def aim_arms(
    records: np.ndarray,
    states: FloatArray,
    parks: FloatArray,
    rows: FloatArray,
    workspaces: np.ndarray,
    goals: FloatArray,
) -> None:
    """Choose postures for poses, and give both to RMPflow.

    Args:
        records: Of n arms; see :data:`~lemma.env.control.guarded_arm.ARM`.
        states: Their references, (n, 2, 6) [rad, rad/s].
        parks: Where they wait, (n, 6) [rad].
        rows: Positions and quaternions wxyz of any length but 0 that the tool centre
            points shall have in the world, (n, 8) [m]; the last number does not matter.
        workspaces: The records of RMPflow, (n,); their goals are written.
        goals: Written: position, rotation and posture, (n, 18) [m, rad].
    """
    pose = np.eye(4)
    for k in range(records.shape[0]):
        arm, row, out = records[k], rows[k], goals[k]
        w, x, y, z = row[3], row[4], row[5], row[6]
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / norm, x / norm, y / norm, z / norm
        pose[0, 0] = 1 - 2 * (y * y + z * z)
        pose[0, 1] = 2 * (x * y - w * z)
        pose[0, 2] = 2 * (x * z + w * y)
        pose[1, 0] = 2 * (x * y + w * z)
        pose[1, 1] = 1 - 2 * (x * x + z * z)
        pose[1, 2] = 2 * (y * z - w * x)
        pose[2, 0] = 2 * (x * z - w * y)
        pose[2, 1] = 2 * (y * z + w * x)
        pose[2, 2] = 1 - 2 * (x * x + y * y)
        for i in range(3):
            pose[i, 3] = out[i] = row[i]
            for j in range(3):
                out[3 + 3 * i + j] = pose[i, j]
        out[12:18] = states[k, 0]
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
            out[12:18],
        )
        goal = workspaces[k].goal
        for i in range(3):
            goal.position[i] = out[i]
            for j in range(3):
                goal.rotation[i, j] = pose[i, j]
        for i in range(6):
            goal.posture[i] = out[12 + i]
        goal.target_weight = 1.0
        goal.posture_weight = 1.0
