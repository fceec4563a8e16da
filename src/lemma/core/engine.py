"""MuJoCo, whatever ``MUJOCO_GL`` says: ``from lemma.core.engine import mujoco``.

MuJoCo loads the OpenGL library that ``MUJOCO_GL`` names while it is imported, and
cannot be imported where there is no such library. Physics needs none, so then it is
imported without; who asks for a picture is told what is wrong, by
:func:`lemma.scene.rendering.gl_backend.choose_backend`.
"""

import os

_VARIABLES = ("MUJOCO_GL", "PYOPENGL_PLATFORM")
_before = {name: os.environ.get(name) for name in _VARIABLES}

try:
    import mujoco
except (AttributeError, ImportError, OSError, RuntimeError):
    # PyOpenGL raises an AttributeError for a library that is not there.
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
