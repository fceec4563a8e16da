"""Observation of a policy at one moment.

Environments, rendered data and evaluation all use the views of
:class:`lemma.env.camera_rig.CameraRig`, so their observations are bit-identical. A view
is plain data: a policy server that receives views over a network needs no simulator.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray
from lemma.scene.cameras import CameraImage


@dataclass(frozen=True, eq=False, repr=False)
class View:
    """Top-down map, camera images and the robots' joints, at one moment.

    Maps have the raster :data:`lemma.scene.raster.RASTER`: row 0 lies at +y and column
    0 at -x. Lengths in images are multiples of 0.1 mm.
    """

    rgb: NDArray[np.uint8]
    """Map: color, (rows, columns, 3)."""
    height_m: NDArray[np.float32]
    """Map: height above the table [m], (rows, columns); 0 where no camera sees the
    cell."""
    coverage: NDArray[np.bool_]
    """Map: whether a camera sees the cell, (rows, columns)."""
    joints: FloatArray
    """Measured joint angles [rad], (robots, 6)."""
    opening_m: FloatArray
    """Measured gripper openings [m], (robots,)."""
    joint_velocities: FloatArray | None = None
    """Measured joint velocities [rad/s], (robots, 6); None if they were not sent."""
    opening_m_s: FloatArray | None = None
    """Rates of the gripper openings [m/s], (robots,); None if they were not sent."""
    cameras: Mapping[str, CameraImage] = field(default_factory=dict)
    """Images with intrinsics and extrinsics, by camera name; by default those of the
    robots' cameras. Empty if they were not sent."""
