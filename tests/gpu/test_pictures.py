"""Cameras of many tables see what those of the CPU see; `make test-warp`."""

from typing import Any

import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)
torch = pytest.importorskip("torch")

import numpy as np  # noqa: E402

from lemma.env.camera_rig import CameraRig  # noqa: E402
from lemma.env.episode import Episode  # noqa: E402
from lemma.warp.vector_env import GpuVecEnv  # noqa: E402

CAMERAS = ("robot_0_reach", "robot_1_wrist", "robot_0")
SIZE = (48, 32)
EDGES = 0.01
"""Share of pixels through which an edge may run: poses are of single precision here."""


def test_pictures_are_those_of_the_cpu() -> None:
    env = GpuVecEnv(
        "lift_varied", 3, pool=4, device="cpu", observation="rgbd", cameras=CAMERAS,
        width=SIZE[0], height=SIZE[1],
    )  # fmt: skip
    begun: tuple[Any, dict[str, Any]] = env.reset(seed=1)
    observation, info = begun
    space: Any = env.observation_space
    rig = CameraRig(*SIZE, "warp")
    for world, number in enumerate(info["instance"].tolist()):
        scene = Episode(env.pool.instances[number]).simulation.scene
        expected = rig.film(scene, scene.data.qpos[None], CAMERAS)
        assert expected.depth_m is not None
        for k, name in enumerate(CAMERAS):
            rgb = observation["pixels"][name][world].numpy().astype(int)
            depth = observation["depth"][name][world].numpy()
            assert rgb.shape == (SIZE[1], SIZE[0], 3)
            off = np.abs(rgb - expected.rgb[0, k]).max(-1) > 8
            assert off.mean() < EDGES, (world, name)
            apart = np.abs(depth - expected.depth_m[0, k]) > 0.002
            assert apart.mean() < EDGES, (world, name)
    assert space["pixels"]["robot_0"].shape == (3, SIZE[1], SIZE[0], 3)
    after, *_, told = env.step(torch.zeros(3, env.numbers))
    assert set(after["depth"]) == set(CAMERAS)
    assert "pixels" not in told["final_obs"]
