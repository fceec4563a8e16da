"""Adds cameras to a MuJoCo scene, and returns its cameras with calibration.

MuJoCo's camera frames have y up and z backward; calibrated cameras have the frames of
:mod:`lemma.scene.cameras`.
"""

import math

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose, quaternion_from_matrix
from lemma.scene.cameras import Camera, CameraIntrinsics

# Half a turn about x converts between the camera frames of OpenCV and MuJoCo.
_FLIP = np.array([1.0, -1.0, -1.0])


def add_camera(
    spec: mujoco.MjSpec, name: str, world_from_camera: Pose, fovy_rad: float
) -> None:
    """Add a fixed camera to a scene.

    Args:
        spec: The MuJoCo specification of the scene.
        name: The camera's name.
        world_from_camera: World from camera; x right, y down, z forward.
        fovy_rad: Vertical field of view [rad].
    """
    rotation = world_from_camera.matrix()[:3, :3] * _FLIP
    spec.worldbody.add_camera(
        name=name,
        pos=world_from_camera.position,
        quat=quaternion_from_matrix(rotation),
        # Always in degrees, independent of the scene's unit of angles.
        fovy=math.degrees(fovy_rad),
    )


def camera_from_model(
    model: mujoco.MjModel, data: mujoco.MjData, name: str, width: int, height: int
) -> Camera:
    """Return a camera of a compiled scene at its present pose.

    Args:
        model: The scene.
        data: Its state, with up-to-date derived poses (``mj_forward``).
        name: The camera's name.
        width: Image width [px].
        height: Image height [px].

    Raises:
        UnknownNameError: The scene has no such camera.
        InvalidConfigError: The camera is orthographic or has a sensor size.
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
    """Return the index of a camera in a model.

    Raises:
        UnknownNameError: The scene has no such camera.
    """
    index: int = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA.value, name)
    if index < 0:
        names = [model.camera(i).name for i in range(model.ncam)]
        raise UnknownNameError("camera", name, names)
    return index
