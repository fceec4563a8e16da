"""MuJoCo's viewer for ``render_mode="human"``, which needs a display."""

import os
import sys
import threading
import time
from importlib import import_module
from typing import Any

from lemma.core.errors import RenderingError
from lemma.scene.scene import Scene

_FRAME_S = 1.0 / 30.0
_CLOSE_S = 5.0
_INSTEAD = (
    "Look at it in a browser: lemma play --no-open. Or make pictures: "
    'render_mode="rgb_array".'
)


class Window:
    """A window that shows one scene after another in real time."""

    def __init__(self) -> None:
        """Check for a display.

        Raises:
            RenderingError: There is no display.
        """
        if sys.platform.startswith("linux") and not (
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        ):
            raise RenderingError(
                'render_mode="human" opens a window, and there is no display here: '
                f"DISPLAY is not set. {_INSTEAD}"
            )
        self._handle: Any = None
        self._threads: set[threading.Thread] = set()
        self._shown_s = 0.0
        self._at = (0.0, 0.0)

    def show(self, scene: Scene) -> None:
        """Open the window for a scene, which does not change.

        Raises:
            RenderingError: No window can be opened.
        """
        self.close()
        others = set(threading.enumerate())
        try:
            launch = import_module("mujoco.viewer").launch_passive
            self._handle = launch(
                scene.model, scene.data, show_left_ui=False, show_right_ui=False
            )
        except Exception as error:
            # Errors of GLFW, of the driver, or of macOS, which requires mjpython.
            raise RenderingError(
                f'render_mode="human" could not open a window: {error} {_INSTEAD}'
            ) from error
        self._threads = set(threading.enumerate()) - others
        self._at = (time.perf_counter(), scene.time_s)
        self._shown_s = scene.time_s

    def follow(self, scene: Scene) -> None:
        """Show the present state if a frame is due; wait if the simulation is ahead.

        Args:
            scene: The scene of :meth:`show`.
        """
        now_s = scene.time_s
        if self._handle is None or now_s - self._shown_s < _FRAME_S:
            return
        self._shown_s = now_s
        began, began_s = self._at
        ahead_s = (now_s - began_s) - (time.perf_counter() - began)
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        else:
            # After a pause between two steps, real time starts again from here.
            self._at = (time.perf_counter(), now_s)
        if self._handle.is_running():
            self._handle.sync()

    def close(self) -> None:
        """Close the window if it is open."""
        if self._handle is not None:
            self._handle.close()
            self._handle = None
            # A process that ends before the window is closed crashes.
            for thread in self._threads:
                thread.join(_CLOSE_S)
