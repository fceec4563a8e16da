"""From where visitors look at first: they see all robots, however narrow the window."""

import math
from dataclasses import dataclass

import numpy as np
import viser

from lemma.core.poses import FloatArray

_TARGET_M = np.array([0.0, -0.05, 0.05])
"""Where a visitor looks at first [m]."""
_FROM = np.array([0.0, -0.81, 0.59])
_UP = np.array([0.0, 0.59, 0.81])
_FOV_RAD = math.radians(40.0)
"""How wide the view is, from bottom to top [rad]."""
_PORTRAIT, _PANEL_PX = 0.8, 390
_COVERED = 0.55
_HALF_HEIGHT_M = 0.9
"""What shall be seen at least above and below [m]."""
_MUCH_M = 0.5
_SAME_M = 1e-3


class Viewpoint:
    """Cameras of all visitors of a page; moved once for each width of what is shown."""

    def __init__(
        self, server: viser.ViserServer, half_width_m: float, aspect: float = 1.5
    ) -> None:
        """Choose where somebody stands who comes later.

        Args:
            server: The page.
            half_width_m: What shall be seen at least to the left and right [m].
            aspect: Width of a window nobody knows yet, in heights.
        """
        self._server, self._aspect = server, aspect
        self._places: dict[int, _Place] = {}
        server.initial_camera.look_at = _TARGET_M
        server.initial_camera.fov = _FOV_RAD
        self._set(half_width_m)

    def _set(self, half_width_m: float) -> None:
        self.half_width_m = half_width_m
        self._start = eye_for(self._aspect, half_width_m)
        self._server.initial_camera.position = self._start

    def widen(self, half_width_m: float) -> None:
        """Let more be seen, or much less [m]; a little less changes nothing."""
        if not 0.0 <= self.half_width_m - half_width_m <= _MUCH_M:
            self._set(half_width_m)

    def step_back(self) -> None:
        """Let visitors see all of it who do not yet."""
        visitors, half_m = self._server.get_clients(), self.half_width_m
        places = {}
        for number, client in visitors.items():
            place = self._places.get(number)
            if place is None or place.half_width_m != half_m:
                place = self._place_for(client, new=place is None)
                _put(client, place)
            elif _is_at(client, self._start) and not _is_at(client, place.eye):
                # Where everybody begins: a page that is slow goes there afterwards.
                _put(client, place)
            places[number] = place
        self._places = places

    def _place_for(self, client: viser.ClientHandle, *, new: bool) -> "_Place":
        width, height = client.camera.image_width, client.camera.image_height
        # In pixels that are drawn, of which the page's may have many or few.
        portrait = width < _PORTRAIT * height
        if new and width > 2 * _PANEL_PX and not portrait:
            # The panel docks later.
            width -= _PANEL_PX
        eye = eye_for(width / max(height, 1), self.half_width_m)
        down = 0.0
        if portrait:
            # The panel covers what is below.
            away = float(np.linalg.norm(eye - _TARGET_M))
            down = _COVERED * away * math.tan(_FOV_RAD / 2.0)
        return _Place(self.half_width_m, eye - down * _UP, _TARGET_M - down * _UP)


@dataclass(frozen=True)
class _Place:
    """Where a visitor was put."""

    half_width_m: float
    """To see so much to the left and right [m]."""
    eye: FloatArray
    target: FloatArray


def _put(client: viser.ClientHandle, place: _Place) -> None:
    client.camera.position, client.camera.look_at = place.eye, place.target


def _is_at(client: viser.ClientHandle, eye: FloatArray) -> bool:
    return bool(np.allclose(client.camera.position, eye, atol=_SAME_M))


def eye_for(aspect: float, half_width_m: float) -> FloatArray:
    """Return where to stand to see the table, (3,) [m].

    Args:
        aspect: Width of the window, in heights.
        half_width_m: What shall be seen at least to the left and right [m].
    """
    half = math.tan(_FOV_RAD / 2.0)
    away = max(_HALF_HEIGHT_M, half_width_m / max(aspect, 0.2)) / half
    eye: FloatArray = _TARGET_M + away * _FROM
    return eye
