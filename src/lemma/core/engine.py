"""MuJoCo, independent of ``MUJOCO_GL``: ``from lemma.core.engine import mujoco``.

During its import MuJoCo loads the OpenGL library that ``MUJOCO_GL`` names, and the
import fails if there is none. Physics does not need it, so MuJoCo is then imported
without OpenGL. :func:`lemma.scene.rendering.gl_backend.choose_backend` reports the
problem when an image is to be rendered.
"""

import os

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

__all__ = ["mujoco"]
