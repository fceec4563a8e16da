"""Pictures of many states: the same as one after the other, whoever draws them."""

import importlib.util
from functools import cache

import numpy as np
import pytest

from lemma.core.errors import InvalidConfigError, RenderingError, UnknownNameError
from lemma.core.poses import FloatArray
from lemma.scene.cameras import Camera, FreeCamera
from lemma.scene.rendering import batch
from lemma.scene.rendering.batch import (
    BATCH_RENDERERS,
    OpenGLRenderer,
    choose_renderer,
    states_at_once,
)
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.suite import load_instance

SIZE = (40, 30)
EYE = FreeCamera().camera(*SIZE)


@cache
def scene() -> Scene:
    return Scene(load_instance("pass", "val", 0).scene)


def states() -> FloatArray:
    rows = np.tile(scene().data.qpos, (2, 1))
    rows[1, scene().robots[0].qpos] += 0.3
    return rows


@pytest.mark.render
@pytest.mark.parametrize("depth", [True, False])
def test_opengl_draws_what_it_draws_one_by_one(depth: bool) -> None:
    before = scene().snapshot()
    aims: tuple[str | Camera, ...] = ("robot_0/camera", EYE)
    seen = OpenGLRenderer(*SIZE).render(scene(), states(), lambda _: aims, depth=depth)
    assert np.array_equal(scene().snapshot(), before)
    assert seen.rgb.shape == (2, 2, 30, 40, 3)
    assert (seen.depth_m is None) != depth
    alone = Renderer(*SIZE)
    for i, row in enumerate(states()):
        data = scene().posed(row)
        for j, camera in enumerate(aims):
            image = alone.rgbd(scene().model, data, camera)
            assert np.array_equal(seen.rgb[i, j], image.rgb)
            if seen.depth_m is not None:
                assert np.array_equal(seen.depth_m[i, j], image.depth_m)
    assert not np.array_equal(seen.rgb[0], seen.rgb[1])


@pytest.mark.render
def test_a_camera_of_another_size_is_refused() -> None:
    other = FreeCamera().camera(8, 8)
    with pytest.raises(InvalidConfigError, match="8 x 8"):
        OpenGLRenderer(*SIZE).render(scene(), states(), lambda _: [other], depth=False)


@pytest.mark.parametrize("sides", [(16, 16), (128, 128), (640, 480), (8192, 8192)])
def test_memory_of_one_launch_is_bounded(sides: tuple[int, int]) -> None:
    states, pixels = states_at_once(*sides, 2), 2 * sides[0] * sides[1]
    assert states == 1 or states * pixels <= batch._MOST_PIXELS
    assert 1 <= states <= batch._MOST_STATES


def test_nothing_to_render_is_refused() -> None:
    with pytest.raises(InvalidConfigError, match="0 cameras"):
        states_at_once(64, 48, 0)


def test_renderers_are_chosen_by_name() -> None:
    assert choose_renderer("opengl") == "opengl"
    with pytest.raises(UnknownNameError, match="opengl"):
        choose_renderer("vulkan")


@pytest.mark.parametrize("has_gpu", [True, False])
def test_auto_is_warp_where_there_is_a_gpu_for_it(
    has_gpu: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "has_gpu", lambda: has_gpu)
    assert choose_renderer("auto") == ("warp" if has_gpu else "opengl")


def test_auto_asks_for_no_package() -> None:
    if importlib.util.find_spec("mujoco_warp") is None:
        assert choose_renderer("auto") == "opengl"
        with pytest.raises(RenderingError, match=r"lemma-bench\[warp\]"):
            BATCH_RENDERERS["warp"](64, 48)
