"""Hands that are led by whole poses go where the CPU's forward kinematics says."""

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)

from torch import Tensor  # noqa: E402

from lemma.policies.control.hand_steps import Arms  # noqa: E402
from lemma.warp.episodes import JOINT_STEP_RAD  # noqa: E402
from lemma.warp.hands import (  # noqa: E402
    STEP_M,
    TURN_RAD,
    hand_poses,
    moved,
    pose_joints,
)
from lemma.warp.vector_env import GpuVecEnv  # noqa: E402

NAMES = ["ur5", "ur10"]


def parked(count: int) -> tuple[Arms, Tensor, Tensor, Tensor]:
    """Return arms, bases, joint angles near those in which arms wait, and poses."""
    torch.manual_seed(0)
    arms = Arms.of(NAMES)
    base = torch.rand(count, 2, 3) - 0.5
    q = arms.park + 0.2 * torch.randn(count, 2, 6)
    return arms, base, q, hand_poses(q, base, arms)


def test_joints_of_poses_lead_back_to_the_poses() -> None:
    arms, base, q, pose = parked(200)
    found = pose_joints(pose, base, arms, q)
    assert torch.allclose(hand_poses(found, base, arms), pose, atol=2e-4)
    # Most of them are the angles themselves: only wrists could be turned over.
    same = (found - q).abs().amax(-1) < 1e-2
    assert float(same.float().mean()) > 0.9


def test_a_step_is_along_and_about_axes_of_the_world() -> None:
    _, _, _, pose = parked(50)
    rows = torch.zeros(50, 2, 7)
    rows[..., 0], rows[..., 5] = 1.0, -1.0
    after = moved(pose, rows, pose)
    step = after[..., :3] - pose[..., :3]
    inside = (after[..., :2].abs() < 0.5).all(-1) & (pose[..., 2] > 0.02)
    assert torch.allclose(step[inside], torch.tensor([STEP_M, 0.0, 0.0]), atol=1e-5)
    turn = torch.tensor(TURN_RAD)
    c, s = torch.cos(turn), -torch.sin(turn)
    about_z = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = about_z @ pose[..., 3:].view(50, 2, 3, 3)
    assert torch.allclose(after[..., 3:].view(50, 2, 3, 3), turned, atol=1e-5)


def test_targets_are_no_more_than_two_steps_ahead() -> None:
    _, _, _, pose = parked(50)
    aim = pose
    for _ in range(5):
        aim = moved(aim, torch.ones(50, 2, 7), pose)
    inside = (aim[..., :2].abs() < 0.5).all(-1)
    way = torch.linalg.vector_norm(aim[..., :3] - pose[..., :3], dim=-1)
    assert way[inside].tolist() == pytest.approx(
        [2.0 * STEP_M] * int(inside.sum()), abs=1e-5
    )
    turns = aim[..., 3:].view(50, 2, 3, 3) @ pose[..., 3:].view(50, 2, 3, 3).mT
    trace = turns.diagonal(dim1=-2, dim2=-1).sum(-1)
    angle = torch.acos(((trace - 1.0) / 2.0).clamp(-1, 1))
    assert torch.allclose(angle, torch.tensor(2.0 * TURN_RAD), atol=1e-3)


def test_a_hand_goes_where_it_is_led() -> None:
    env = GpuVecEnv(
        "reach_fixed", 1, pool=1, control="delta_ee_pose", device="cpu", horizon_s=9.0
    )
    env.reset(seed=0)
    start = env.hands.clone()
    rows = torch.zeros(1, 2, 7)
    rows[:, 0, 2], rows[:, 0, 3] = -0.5, 0.2
    for _ in range(4):
        env.step(rows.flatten(1))
    for _ in range(8):
        env.step(torch.zeros(1, 14))
    led, left = env.hands[0, 0] - start[0, 0], env.hands[0, 1] - start[0, 1]
    assert led[:3].tolist() == pytest.approx([0.0, 0.0, -0.1], abs=0.01)
    assert env.hands[0, 0, 3:].tolist() == pytest.approx(
        env.aim[0, 0, 3:].tolist(), abs=0.05
    )
    assert float(left.abs().max()) < 0.01


def test_joints_are_led_two_steps_ahead_and_stay_in_range() -> None:
    env = GpuVecEnv("reach_fixed", 1, pool=1, control="delta_joint", device="cpu")
    env.reset(seed=0)
    env._action.fill_(1.0)
    here = env.qpos[:, env.joint_at].flatten(1)
    for _ in range(5):
        env._command()
    ahead = 2.0 * JOINT_STEP_RAD
    assert torch.allclose(env._wanted, here + ahead, atol=1e-5)
    env.qpos[:, env.joint_at] = env.joint_range
    for _ in range(5):
        env._command()
    assert torch.equal(env._wanted, env.joint_range.flatten()[None])
