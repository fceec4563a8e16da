"""Where visitors stand: far enough to see all, however late their page is."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lemma.tasks.suite import load_instance
from lemma.viewer.scene.viewpoint import Viewpoint, eye_for, half_height_for

HALF_M = 3.0
NARROW = (812, 660)


class Server:
    """Stands for viser's: a camera to begin with, and visitors."""

    def __init__(self) -> None:
        self.initial_camera = SimpleNamespace(position=None, look_at=None, fov=None)
        self.clients: dict[int, Any] = {}

    def get_clients(self) -> dict[int, Any]:
        return dict(self.clients)

    def enter(self, number: int, width: int, height: int) -> Any:
        """Let somebody in, who stands where everybody begins."""
        camera = SimpleNamespace(
            image_width=width,
            image_height=height,
            position=self.initial_camera.position,
            look_at=self.initial_camera.look_at,
        )
        self.clients[number] = SimpleNamespace(camera=camera)
        return camera


@pytest.fixture
def server() -> Server:
    return Server()


@pytest.fixture
def view(server: Server) -> Viewpoint:
    found: Any = server
    return Viewpoint(found, HALF_M)


def test_narrow_windows_step_back(server: Server, view: Viewpoint) -> None:
    camera = server.enter(0, 700, 600)
    view.step_back()
    assert np.array_equal(camera.position, eye_for(700 / 600, HALF_M))
    far = np.linalg.norm(camera.position - camera.look_at)
    start = server.initial_camera.position
    assert far > np.linalg.norm(start - server.initial_camera.look_at)


def test_a_page_that_begins_late_is_moved_again(
    server: Server, view: Viewpoint
) -> None:
    camera = server.enter(0, *NARROW)
    view.step_back()
    fits = camera.position
    # The browser says where it stands: where everybody begins.
    camera.position = np.array(server.initial_camera.position)
    view.step_back()
    assert np.array_equal(camera.position, fits)


def test_moved_cameras_are_left_alone(server: Server, view: Viewpoint) -> None:
    camera = server.enter(0, *NARROW)
    view.step_back()
    camera.position = np.array([1.0, -2.0, 3.0])
    view.step_back()
    assert camera.position.tolist() == [1.0, -2.0, 3.0]
    # Another scene, of which much more is to be seen, is looked at anew.
    view.widen(2.0 * HALF_M)
    view.step_back()
    assert np.linalg.norm(camera.position) > 2.0 * HALF_M


def test_a_visitor_who_returns_is_placed_anew(server: Server, view: Viewpoint) -> None:
    server.enter(0, *NARROW)
    view.step_back()
    server.clients.clear()
    view.step_back()
    camera = server.enter(0, *NARROW)
    view.step_back()
    # As wide as without the panel, which docks later.
    assert np.array_equal(camera.position, eye_for((812 - 390) / 660, HALF_M))


@pytest.mark.parametrize("task", ["stack", "line", "carousel", "tower"])
def test_all_robots_and_objects_of_a_table_are_in_view(task: str) -> None:
    for index in range(20):
        instance = load_instance(task, "test", index)
        server: Any = Server()
        wide = 2.0
        Viewpoint(server, 1.0, wide, half_height_for(instance))
        camera = server.initial_camera
        ahead = camera.look_at - camera.position
        ahead = ahead / np.linalg.norm(ahead)
        up = np.cross(np.cross(ahead, (0.0, 0.0, 1.0)), ahead)
        up = up / np.linalg.norm(up)
        scene = instance.scene
        placed = [*(r.base for r in scene.robots), *(o.pose for o in scene.objects)]
        for pose in placed:
            seen = np.array([*pose.xy, 0.0]) - camera.position
            high = abs(seen @ up) / (seen @ ahead)
            assert high < np.tan(camera.fov / 2.0)
