"""The initial viewpoint of visitors, which shows all robots in any window."""

import math

import numpy as np
import viser

from lemma.core.poses import FloatArray
from lemma.tasks.instance import Instance
from lemma.viewer.server import PHONE_PANEL

_TARGET_M = np.array([0.0, -0.05, 0.05])
"""Point in the middle of the first view [m]."""
_FROM = np.array([0.0, -0.81, 0.59])
_UP = np.array([0.0, 0.59, 0.81])
_FOV_RAD = math.radians(40.0)
"""Vertical field of view [rad]."""
_PORTRAIT, _PANEL_PX = 0.8, 390
_HALF_HEIGHT_M = 0.9
"""Half the least visible height [m]."""
_MUCH_M = 0.5
_SAME_M = 1e-3


_Place = tuple[tuple[float, float], FloatArray, FloatArray]
"""Half the visible width and height, position of a visitor's camera, and its target
[m]."""
_ARM_M, _EDGE = 0.8, 0.94
"""Height of an arm at rest [m], and share of a picture without its margin."""


def half_height_for(*instances: Instance) -> float:
    """Return half the height of a view that contains all robots and objects [m].

    Args:
        instances: The instances of one table or of several side by side.
    """
    scenes = [instance.scene for instance in instances]
    points = [(r.base.x, r.base.y, _ARM_M) for scene in scenes for r in scene.robots]
    points += [(o.pose.x, o.pose.y, 0.0) for scene in scenes for o in scene.objects]
    slope, seen = math.tan(_FOV_RAD / 2.0), np.array(points) - _TARGET_M
    aside, nearer = np.abs(seen @ _UP), seen @ _FROM
    return max(_HALF_HEIGHT_M, float((aside / _EDGE + slope * nearer).max()))


class Viewpoint:
    """Cameras of all visitors of a page, placed again if the scene's size changes."""

    def __init__(
        self,
        server: viser.ViserServer,
        half_width_m: float,
        aspect: float = 1.5,
        half_height_m: float = _HALF_HEIGHT_M,
    ) -> None:
        """Set the initial camera of later visitors.

        Args:
            server: The page's server.
            half_width_m: Half the least visible width [m].
            aspect: Assumed width of a window divided by its height.
            half_height_m: Half the least visible height [m].
        """
        self._server, self._aspect = server, aspect
        self._places: dict[int, _Place] = {}
        server.initial_camera.look_at = _TARGET_M
        server.initial_camera.fov = _FOV_RAD
        self._set(half_width_m, half_height_m)

    def _set(self, half_width_m: float, half_height_m: float) -> None:
        self._view = half_width_m, half_height_m
        self._start = eye_for(self._aspect, *self._view)
        self._server.initial_camera.position = self._start

    def widen(self, half_width_m: float, half_height_m: float = _HALF_HEIGHT_M) -> None:
        """Set the least visible size; keep the cameras if it shrinks only a little.

        Args:
            half_width_m: Half the least visible width [m].
            half_height_m: Half the least visible height [m].
        """
        wanted = half_width_m, half_height_m
        less = [old - new for old, new in zip(self._view, wanted, strict=True)]
        if not all(0.0 <= by <= _MUCH_M for by in less):
            self._set(*wanted)

    def step_back(self) -> None:
        """Place the cameras of visitors who do not see the whole scene yet."""
        places = {}
        for number, client in self._server.get_clients().items():
            place = self._places.get(number)
            # A slow page reports its initial camera after the camera was placed.
            late = (
                place is not None
                and _is_at(client, self._start)
                and not _is_at(client, place[1])
            )
            if place is None or place[0] != self._view:
                place, late = self._place_for(client, new=place is None), True
            if late:
                client.camera.position, client.camera.look_at = place[1:]
            places[number] = place
        self._places = places

    def _place_for(self, client: viser.ClientHandle, *, new: bool) -> _Place:
        # Rendered pixels; their number may differ from that of the page.
        width, height = client.camera.image_width, client.camera.image_height
        portrait = width < _PORTRAIT * height
        if new and width > 2 * _PANEL_PX and not portrait:
            # The panel will take this width.
            width -= _PANEL_PX
        eye = eye_for(width / max(height, 1), *self._view)
        down = 0.0
        if portrait:
            # The panel covers the lower part of the window.
            away = float(np.linalg.norm(eye - _TARGET_M))
            down = PHONE_PANEL * away * math.tan(_FOV_RAD / 2.0)
        return self._view, eye - down * _UP, _TARGET_M - down * _UP


def _is_at(client: viser.ClientHandle, eye: FloatArray) -> bool:
    return bool(np.allclose(client.camera.position, eye, atol=_SAME_M))


def eye_for(
    aspect: float, half_width_m: float, half_height_m: float = _HALF_HEIGHT_M
) -> FloatArray:
    """Return the position of a camera that shows the table, (3,) [m].

    Args:
        aspect: Width of the window divided by its height.
        half_width_m: Half the least visible width [m].
        half_height_m: Half the least visible height [m].
    """
    half_width = max(half_height_m, half_width_m / max(aspect, 0.2))
    eye: FloatArray = _TARGET_M + half_width / math.tan(_FOV_RAD / 2.0) * _FROM
    return eye
