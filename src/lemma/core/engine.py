"""MuJoCo, independent of ``MUJOCO_GL``: ``from lemma.core.engine import mujoco``.

During its import MuJoCo loads the OpenGL library that ``MUJOCO_GL`` names, and the
import fails if there is none. Physics does not need it, so MuJoCo is then imported
without OpenGL. :func:`lemma.scene.rendering.gl_backend.choose_backend` reports the
problem when an image is to be rendered.
"""

import ctypes
import os
from pathlib import Path
from typing import Any

import llvmlite.binding
import numpy as np
from numba import types
from numpy.typing import NDArray

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray

_VARIABLES = ("MUJOCO_GL", "PYOPENGL_PLATFORM")
_before = {name: os.environ.get(name) for name in _VARIABLES}

try:
    import mujoco
except (AttributeError, ImportError, OSError, RuntimeError):
    # PyOpenGL raises an AttributeError if the library is missing.
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco
    finally:
        for name, value in _before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

__all__ = ["Memory", "memory_of", "mj_step", "mujoco"]

Memory = tuple[NDArray[np.int64], FloatArray, NDArray[np.int32], NDArray[np.int32]]
"""A model and its data for kernels: the addresses of both, (2,), and arrays of MuJoCo's
own memory: time, (1,) [s]; number of contacts, (1,); and both geoms of each
contact, (capacity, 2)."""


def _library() -> str:
    """Return the path of MuJoCo's library of C functions."""
    names = ("libmujoco.", "mujoco.dll")
    folder = Path(mujoco.__file__).parent
    return str(next(p for p in folder.iterdir() if p.name.startswith(names)))


# Kernels find C functions by name, so their code can be cached on disk.
llvmlite.binding.load_library_permanently(_library())
_mj_step: Any = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))


@kernel
def mj_step(addresses: NDArray[np.int64]) -> None:
    """Advance the physics by one step, without Python in between.

    If MuJoCo runs out of memory, or a Python callback of MuJoCo raises an exception,
    MuJoCo prints the error and ends the process.

    Args:
        addresses: The first array of :data:`Memory`.
    """
    _mj_step(addresses[0], addresses[1])


def memory_of(model: mujoco.MjModel, data: mujoco.MjData) -> Memory:
    """Return a model and its data for kernels, valid as long as both exist."""
    timers, pairs = data.timer.duration, data.contact.geom
    # In MuJoCo's `mjData`, the number of contacts follows the timers, and the time
    # precedes the energy. The contacts are at the beginning of the arena.
    count = timers.ctypes.data + timers.size * timers.strides[0]
    time = data.energy.ctypes.data - ctypes.sizeof(ctypes.c_double)
    return (
        np.array([model._address, data._address]),
        np.ctypeslib.as_array(ctypes.c_double.from_address(time)).reshape(1),
        np.ctypeslib.as_array(ctypes.c_int32.from_address(count)).reshape(1),
        np.lib.stride_tricks.as_strided(
            pairs, (data.narena // pairs.strides[0], 2), pairs.strides
        ),
    )
