"""Cameras that are chosen: what they are called, what they see, and at any size."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.env.camera_rig import CameraRig, camera_names
from lemma.env.control_env import ControlEnv
from lemma.scene.cameras import CLOSE_PX
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M

NAMES = ("robot_0", "overview", "robot_1_wrist")


def seeing(**options: Any) -> ControlEnv:
    size = {"width": 96, "height": 64, "observation": "rgbd"}
    options = {"split": "test", "index": 0, **size, **options}
    return lemma.make("stack", control="delta_ee_pose", **options)


def test_a_team_has_a_camera_for_each_robot_the_overview_and_the_wrists() -> None:
    assert camera_names(("robot_0", "robot_1")) == (
        *("robot_0", "robot_1", "overview"),
        *("robot_0_wrist", "robot_1_wrist"),
        *("robot_0_reach", "robot_1_reach", "table"),
    )


def shapes(space: Any) -> dict[str, tuple[int, ...]]:
    return {name: box.shape[:2] for name, box in space.items()}


def test_images_at_control_level_are_close_ones_unless_others_are_chosen() -> None:
    close = ("robot_0_reach", "robot_1_reach", "robot_0_wrist", "robot_1_wrist")
    usual = dict.fromkeys((*close, "table"), (224, 224))
    space: Any = lemma.make("pass", observation="rgbd").observation_space
    assert shapes(space["pixels"]) == shapes(space["depth"]) == usual
    agents = lemma.parallel_env("pass", observation="rgb")
    for agent in agents.possible_agents:
        seen = shapes(agents.observation_space(agent)["pixels"])
        assert set(seen) == {f"{agent}_reach", f"{agent}_wrist", "table"}
    space = seeing(cameras=("robot_1",), height=120).observation_space
    assert shapes(space["depth"]) == {"robot_1": (120, 96)}
    # Maps are fused from each robot's own camera at its usual size.
    for observation in ("map", "state"):
        env = lemma.make("pass", observation=observation)
        assert env.config.image_size == (640, 480)
    space = lemma.make("pass", level="skill", observation="rgb").observation_space
    own = ("robot_0", "robot_1")
    assert shapes(space["pixels"]) == dict.fromkeys(own, (480, 640))


@pytest.mark.render
def test_gymnasium_finds_no_fault_in_chosen_cameras() -> None:
    check_env(seeing(cameras=NAMES), skip_render_check=True)


@pytest.mark.render
def test_chosen_cameras_are_observed_as_the_view_has_them() -> None:
    env = seeing(cameras=NAMES)
    found, _ = env.reset()
    view = env.view()
    assert tuple(found["pixels"]) == tuple(found["depth"]) == NAMES
    assert tuple(view.cameras) == tuple(env.cameras()) == NAMES
    for name in NAMES:
        assert found["pixels"][name].shape == (64, 96, 3)
        assert np.array_equal(found["pixels"][name], view.cameras[name].rgb)
        assert np.array_equal(found["depth"][name], view.cameras[name].depth_m)
        assert view.cameras[name].camera == env.cameras()[name]
    close, _ = seeing().reset()
    wrist = "robot_1_wrist"
    assert np.array_equal(found["pixels"][wrist], close["pixels"][wrist])


@pytest.mark.render
def test_maps_are_fused_from_the_cameras_of_robots_whatever_is_chosen() -> None:
    env = seeing()
    env.reset()
    scene, rig = env.episode.simulation.scene, CameraRig(96, 64)
    expected = rig.look(scene)
    for cameras in (("overview",), (*NAMES, "robot_1"), ("robot_1", "robot_0")):
        chosen = rig.look(scene, cameras=cameras)
        assert set(chosen.cameras) == set(cameras)
        assert np.array_equal(chosen.height_m, expected.height_m)
        assert np.array_equal(chosen.rgb, expected.rgb)


@pytest.mark.render
def test_what_cameras_see_is_where_they_say() -> None:
    # A cube that the first hand gets above within these steps.
    env = seeing(index=1, width=160, height=120, cameras=("overview", "robot_0_wrist"))
    _, info = env.reset()
    arm = next(iter(env.episode.simulation.arms.values()))
    cubes = [row[:3] for name, row in info["state"].items() if name.endswith("cube")]
    cube = min(cubes, key=lambda at: float(np.linalg.norm(at - arm.tcp_pose()[:3, 3])))
    action = np.zeros((2, 7))
    action[:, -1] = 1.0
    for _ in range(60):
        offset = cube + np.array([0.0, 0.0, 0.12]) - arm.tcp_pose()[:3, 3]
        action[0, :3] = np.clip(offset / 0.05, -1.0, 1.0)
        env.step(action)
    image = env.view().cameras["robot_0_wrist"]
    points = image.camera.unproject(image.depth_m)
    near = np.linalg.norm(points - cube, axis=-1) < 0.04
    assert near.sum() > 50
    # A cube has one color, unlike the table and the hand.
    colors = image.rgb[near].astype(float)
    assert (colors.max(axis=1) - colors.min(axis=1)).mean() > 40.0
    (pixel,), (depth,) = image.camera.project([cube])
    assert abs(pixel[0] - 79.5) < 25.0
    assert 0.05 < depth < 0.4


@pytest.mark.render
def test_close_cameras_draw_cubes_where_they_project_and_one_sees_all_the_table() -> (
    None
):
    env = seeing(width=None, height=None)
    env.reset()
    scene, cameras = env.episode.simulation.scene, env.cameras()
    x, y = TABLE_HALF_X_M, TABLE_HALF_Y_M
    rim = [(a, b, 0.05) for a in (-x, x) for b in (-y, y)]
    pixels, _ = cameras["table"].project(rim)
    assert (pixels > 0).all()
    assert (pixels < CLOSE_PX - 1).all()
    renderer, drawn_in = Renderer(CLOSE_PX, CLOSE_PX), []
    cubes = [name for name in scene.object_names if name.endswith("cube")]
    for name in ("robot_0_reach", "robot_1_reach", "table"):
        geoms = renderer.segmentation(scene.model, scene.data, cameras[name])
        for cube in cubes:
            rows, columns = np.nonzero(
                scene.model.geom_bodyid[geoms] == scene.model.body(cube).id
            )
            if len(rows) >= 8:
                drawn_in.append(name)
                (pixel,), _ = cameras[name].project([scene.position(cube)])
                assert (columns.mean(), rows.mean()) == pytest.approx(pixel, abs=1.0)
    assert set(drawn_in) == {"robot_0_reach", "robot_1_reach", "table"}


@pytest.mark.render
def test_pictures_for_people_have_the_size_asked_for() -> None:
    env = gymnasium.make(
        "lemma/Stack-v0", render_mode="rgb_array", render_width=96, render_height=48
    )
    env.reset(seed=0)
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (48, 96, 3)


@pytest.mark.render
def test_agents_see_their_own_cameras_and_nobodys() -> None:
    env = lemma.parallel_env(
        "stack", split="test", index=0, observation="rgb", width=32, height=24,
        cameras=("robot_0", "robot_1_wrist", "overview"),
    )  # fmt: skip
    found, _ = env.reset()
    assert set(found["robot_0"]["pixels"]) == {"robot_0", "overview"}
    assert set(found["robot_1"]["pixels"]) == {"robot_1_wrist", "overview"}


@pytest.mark.parametrize("cameras", [(), "overview", 3, ("overview", "overview")])
def test_impossible_choices_are_refused(cameras: Any) -> None:
    with pytest.raises(InvalidConfigError, match="camera"):
        seeing(cameras=cameras)


def test_unknown_cameras_are_refused_with_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match="robot_0_wrist"):
        seeing(cameras=("wrist",))
    with pytest.raises(InvalidConfigError, match="render_width"):
        seeing(render_width=0)
