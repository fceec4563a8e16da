"""Camera pictures of the state at the cursor, rendered in their own thread."""

import threading
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import LemmaError
from lemma.core.poses import FloatArray
from lemma.env.camera_rig import CameraRig, camera_names
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.viz.map_overlay import annotated_map

NO_PICTURE, MAP = "none", "map"
"""Choices beside the names of cameras."""
_WIDTH, _HEIGHT = 480, 360
_MAP_PX = 640
_PERIOD_S = 0.25

RgbImage = NDArray[np.uint8]


class Pictures:
    """Renders at most a few pictures a second from joint positions."""

    def __init__(self, show: Callable[[RgbImage | None], None]) -> None:
        """Start the thread.

        Args:
            show: Called in that thread with every new picture, (H, W, 3) uint8; with
                None for no picture.
        """
        self._show = show
        self._changed = threading.Condition()
        self._wanted: tuple[str, Instance, FloatArray] | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def want(self, name: str, instance: Instance, qpos: FloatArray) -> None:
        """Request a picture of a state.

        Args:
            name: Name of a camera, :data:`MAP` or :data:`NO_PICTURE`.
            instance: The instance of the scene.
            qpos: MuJoCo's joint positions, (nq,).
        """
        with self._changed:
            before = self._wanted
            if not before or before[:2] != (name, instance) or before[2] is not qpos:
                self._wanted = (name, instance, qpos)
                self._changed.notify()

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(5.0)

    def _work(self) -> None:
        rig, drawn, scene = CameraRig(_WIDTH, _HEIGHT), None, None
        try:
            while True:
                with self._changed:
                    while self._wanted is drawn and not self._closed:
                        self._changed.wait()
                    if self._closed:
                        return
                    drawn = self._wanted
                assert drawn is not None
                name, instance, qpos = drawn
                if scene is None or scene.spec != instance.scene:
                    scene = Scene(instance.scene)
                # Without OpenGL there is no picture.
                with suppress(LemmaError):
                    self._show(_draw(rig, scene, instance, name, qpos))
                with self._changed:
                    self._changed.wait_for(lambda: self._closed, _PERIOD_S)
        finally:
            rig.close()


def _draw(
    rig: CameraRig, scene: Scene, instance: Instance, name: str, qpos: FloatArray
) -> RgbImage | None:
    robots = instance.scene.robot_names
    if name == MAP:
        scene.data.qpos[:] = qpos
        scene.refresh()
        images = rig.photograph(scene, qpos, robots)
        drawn = annotated_map(instance, scene, list(images.values()), _MAP_PX)
        return np.asarray(drawn.convert("RGB"))
    if name not in camera_names(robots):
        return None
    return rig.photograph(scene, qpos, [name])[name].rgb
