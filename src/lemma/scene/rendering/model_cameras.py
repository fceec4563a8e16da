"""The cameras of a MuJoCo scene: added to it, and read from it with calibration.

MuJoCo's camera frames have y up and z backward; ours are those of
:mod:`lemma.scene.cameras`.
"""

import math

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose, quaternion_from_matrix
from lemma.scene.cameras import Camera, CameraIntrinsics

# OpenCV's camera frame in MuJoCo's, and the reverse: half a turn about x.
_FLIP = np.array([1.0, -1.0, -1.0])


def add_camera(
    spec: mujoco.MjSpec, name: str, world_from_camera: Pose, fovy_rad: float
) -> None:
    """Add a fixed camera to a scene that is being composed.

    Args:
        spec: The scene.
        name: The camera's name.
        world_from_camera: Where it is; x right, y down, z forward.
        fovy_rad: Vertical field of view [rad].
    """
    rotation = world_from_camera.matrix()[:3, :3] * _FLIP
    spec.worldbody.add_camera(
        name=name,
        pos=world_from_camera.position,
        quat=quaternion_from_matrix(rotation),
        # In degrees whatever the unit of angles in the rest of the scene.
        fovy=math.degrees(fovy_rad),
    )


def camera_from_model(
    model: mujoco.MjModel, data: mujoco.MjData, name: str, width: int, height: int
) -> Camera:
    """Return a camera of a compiled scene, where it is now.

    Args:
        model: The scene.
        data: Its state, with derived poses up to date (``mj_forward``).
        name: The camera's name.
        width: Image width [px].
        height: Image height [px].

    Raises:
        UnknownNameError: The scene has no such camera.
        InvalidConfigError: It is no perspective camera given by a field of view.
    """
    index = camera_index(model, name)
    if model.cam_sensorsize[index].any() or model.cam_projection[index]:
        raise InvalidConfigError(
            f"Camera {name!r} is orthographic or has a sensor size. Only perspective "
            "cameras given by their field of view (fovy) are supported."
        )
    matrix = np.eye(4)
    matrix[:3, :3] = data.cam_xmat[index].reshape(3, 3) * _FLIP
    matrix[:3, 3] = data.cam_xpos[index]
    fovy_rad = math.radians(float(model.cam_fovy[index]))
    lens = CameraIntrinsics.from_fovy(fovy_rad, width, height)
    return Camera(name, Pose.from_matrix(matrix), lens)


def camera_index(model: mujoco.MjModel, name: str) -> int:
    """Return the number of a camera in a model.

    Raises:
        UnknownNameError: The scene has no such camera.
    """
    index: int = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA.value, name)
    if index < 0:
        names = [model.camera(i).name for i in range(model.ncam)]
        raise UnknownNameError("camera", name, names)
    return index
