"""Worlds of MuJoCo Warp agree with the CPU; on Warp's CPU device: `make test-warp`."""

import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)
torch = pytest.importorskip("torch")

import mujoco  # noqa: E402
import numpy as np  # noqa: E402

import lemma  # noqa: E402
from lemma.env.signals.goal_state import goal_state  # noqa: E402
from lemma.env.signals.rewards import goal_potential  # noqa: E402
from lemma.policies.control.hand_steps import Arms, joints  # noqa: E402
from lemma.warp.vector_env import GpuVecEnv  # noqa: E402


@pytest.fixture(scope="module")
def env() -> GpuVecEnv:
    return GpuVecEnv("lift_fixed", 2, pool=1, horizon_s=2.0, device="cpu", seed=3)


def test_the_first_state_has_the_signals_of_the_cpu(env: GpuVecEnv) -> None:
    env.near = 0.0
    observation, _ = env.reset(seed=0)
    episode = lemma.Episode(env.pool.instances[0])
    ours = goal_state(episode, episode.instance.scene.robot_names)
    assert observation["goal_state"][1].numpy() == pytest.approx(ours, abs=1e-3)
    assert float(env.potential[0]) == pytest.approx(goal_potential(episode), abs=1e-3)
    assert env.sentences() == [episode.instance.instructions["high_level"]] * 2


def test_a_script_that_lifts_ends_in_success_and_rises_as_on_the_cpu(
    env: GpuVecEnv,
) -> None:
    """The same rows of the goal state lead to the cube, and up."""
    env.near = 1.0
    observation, _ = env.reset(seed=0)
    episode = lemma.Episode(env.pool.instances[0])
    scene, names = episode.simulation.scene, episode.instance.scene.robot_names
    won = torch.zeros(2, dtype=torch.bool)
    for _ in range(20):
        state = observation["goal_state"].view(2, 2, 13)[:, 0]
        way, holds = state[:, 6:9] / 0.02, state[:, 5]
        beside = state[:, 6:8].norm(dim=1)
        near = (beside < 0.012) & (state[:, 8].abs() < 0.012)
        way[:, 2] = torch.where(beside > 0.02, way[:, 2].clamp_min(-0.2), way[:, 2])
        way[:, 2] = torch.where(holds > 0, 1.0, way[:, 2])
        rows = torch.zeros(2, 10)
        rows[:, :3], rows[:, 3] = way, state[:, 9] / 0.25
        rows[:, 4] = torch.where(near | (holds > 0), -1.0, 1.0)
        observation, _, _, _, info = env.step(rows.clamp(-1, 1))
        won |= info["success"]
        scene.data.qpos[:] = env.qpos[0].numpy()
        mujoco.mj_forward(scene.model, scene.data)
        ours = goal_state(episode, names)
        if ours[5] == float(observation["goal_state"][0, 5]):
            # Contacts are those of the last step there, and of this state here.
            assert observation["goal_state"][0].numpy() == pytest.approx(ours, abs=1e-3)
            found = goal_potential(episode)
            assert float(env.potential[0]) == pytest.approx(found, abs=1e-3)
    assert bool(won.all())
    assert int(env.lost_worlds) == 0


def test_states_that_are_no_numbers_are_reset_and_counted(env: GpuVecEnv) -> None:
    env.reset(seed=0)
    env.qvel[0] = float("nan")
    before = int(env.lost_worlds)
    observation, reward, _, truncated, _ = env.step(torch.zeros(2, 10))
    assert int(env.lost_worlds) == before + 1
    assert truncated.tolist() == [True, False]
    assert all(bool(value.isfinite().all()) for value in observation.values())
    assert bool(reward.isfinite().all())


def test_objects_that_an_instance_does_not_have_are_not_thrown() -> None:
    """They float high above the table, where nothing carries them."""
    env = GpuVecEnv("stack", 4, pool=4, horizon_s=10.0, device="cpu", seed=5)
    env.reset(seed=0)
    scene = env.pool.scene
    movable = [scene.object_names.index(name) for name in scene.movable_names]
    parked = env.pool.rows["present"][env.instance.tolist()][:, movable] == 0
    assert parked.any()
    dof = int(scene.model.joint(scene.movable_names[0]).dofadr[0])
    for _ in range(4):
        # Throws are looked for only while something moves.
        env.qvel[:, dof] = 0.05
        _, _, terminated, _, info = env.step(torch.zeros(4, 10))
        assert not terminated.any()
        assert not info["thrown"].any()


@pytest.mark.parametrize("name", ["ur5", "ur10"])
def test_hands_are_where_they_are_sent(name: str) -> None:
    from lemma.robots.ur.kinematics import forward  # noqa: PLC0415

    arms = Arms.of([name])
    target = torch.tensor([[0.3, -0.4, 0.05, 0.7]])
    q = joints(target, torch.zeros(1, 3), arms, arms.park)[0].double().numpy()
    pose = forward(lemma.ARMS[name].dh, q)
    hand = pose[:3, 3] + 0.12 * pose[:3, 2]
    assert hand == pytest.approx([0.3, -0.4, 0.05], abs=1e-5)
    assert pose[:3, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-5)
    assert np.arctan2(pose[1, 0], pose[0, 0]) == pytest.approx(0.7, abs=1e-5)
