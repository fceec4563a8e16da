"""Renderers of color and depth of many states of a scene, by name.

``opengl`` draws one picture after the other, as environments do. ``warp`` traces the
rays of hundreds of states at once on an NVIDIA GPU, see
:mod:`lemma.scene.rendering.ray_tracer`. Both see the same to within a step of 8-bit
color and a micrometre of depth, except where an edge runs through a pixel.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from lemma.core.poses import FloatArray
from lemma.core.registry import Registry
from lemma.scene.rendering.gl_backend import choose_backend
from lemma.scene.rendering.pictures import Aim, Pictures
from lemma.scene.rendering.ray_tracer import RayTracer, has_gpu
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene

AUTO = "auto"
"""Stands for the fastest renderer that works here."""


class BatchRenderer(Protocol):
    """Renders many states of one scene. Make one per process and keep it."""

    def render(
        self, scene: Scene, qpos: FloatArray, aim: Aim, *, depth: bool
    ) -> Pictures:
        """Render some states.

        Args:
            scene: What to look at; its own state is left alone.
            qpos: The positions of all joints in each state, shape (states, nq).
            aim: Says which cameras look; as many for every state.
            depth: Whether to render depth too.

        Raises:
            UnknownNameError: The scene has no such camera.
            RenderingError: It does not work here.
        """
        ...

    def describe(self) -> str:
        """Return the software and the device that draw; both decide the bytes."""
        ...

    def close(self) -> None:
        """Forget the last scene; the renderer can still be used afterwards."""
        ...


class OpenGLRenderer:
    """Draws picture after picture, on a GPU if EGL finds one, else in software."""

    def __init__(self, width: int, height: int) -> None:
        """Prepare; OpenGL is started by the first picture.

        Raises:
            InvalidConfigError: The size is impossible.
        """
        self._renderer = Renderer(width, height)

    def render(
        self, scene: Scene, qpos: FloatArray, aim: Aim, *, depth: bool
    ) -> Pictures:
        """Render some states; see :class:`BatchRenderer`."""
        colors, depths = [], []
        for row in qpos:
            data = scene.posed(row)
            for camera in aim(data):
                if depth:
                    image = self._renderer.rgbd(scene.model, data, camera)
                    depths.append(image.depth_m)
                    colors.append(image.rgb)
                else:
                    colors.append(self._renderer.rgb(scene.model, data, camera))
        size = (len(qpos), -1, self._renderer.height, self._renderer.width)
        return Pictures(
            np.array(colors).reshape(*size, 3),
            np.array(depths).reshape(size) if depth else None,
        )

    def describe(self) -> str:
        """Return the name that the OpenGL library gives itself."""
        return choose_backend().renderer

    def close(self) -> None:
        """Forget the last scene."""
        self._renderer.close()


MakeRenderer = Callable[[int, int], BatchRenderer]

BATCH_RENDERERS: Registry[MakeRenderer] = Registry("renderer", MakeRenderer)
"""Makers of renderers by name; each takes the width and height of pictures [px]."""
BATCH_RENDERERS.add("opengl", OpenGLRenderer)
BATCH_RENDERERS.add("warp", RayTracer)


def choose_renderer(name: str) -> str:
    """Return the name of a renderer that is to be used here.

    Args:
        name: A name in :data:`BATCH_RENDERERS`, or ``"auto"``: ``warp`` where it is
            installed and there is a GPU for it, else ``opengl``.

    Raises:
        UnknownNameError: There is no such renderer.
        RenderingError: It is not installed.
    """
    if name == AUTO:
        return "warp" if has_gpu() else "opengl"
    # A missing package is known before any worker starts.
    BATCH_RENDERERS[name](1, 1)
    return name
