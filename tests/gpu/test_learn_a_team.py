"""A team's network is cloned, improved and saved, in a few worlds on the CPU."""

from pathlib import Path

import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)
torch = pytest.importorskip("torch")

import learn_a_team  # noqa: E402
from lemma.policies.control.team_steps import TeamPolicy  # noqa: E402
from lemma.warp.vector_env import GpuVecEnv  # noqa: E402


def test_a_network_is_cloned_and_improved_for_teams_of_two_kinds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in {"STEPS": 3, "CLONE_BATCHES": 4, "CRITIC_ROUNDS": 1}.items():
        monkeypatch.setattr(learn_a_team, name, value)
    envs = [
        GpuVecEnv(
            "stack", 2, team=team, reward="rise", pool=2, horizon_s=0.4, device="cpu"
        )
        for team in (("ur5", "ur5"), ("ur5", "ur10"))
    ]
    learner = learn_a_team.Learner(envs)
    before = learner.actor[0].weight.detach().clone()
    learn_a_team.train(learner, 0.0, tmp_path / "team.pt")
    first, last = (
        TeamPolicy(str(tmp_path / name)).actor[0].weight
        for name in ("team-cloned.pt", "team.pt")
    )
    assert not torch.equal(before, first)
    # With no minutes there is one round of PPO, in which only the critic learns.
    assert torch.equal(first, last)
    told = capsys.readouterr().out.splitlines()
    assert [line.split("\t")[0] for line in told] == [
        *("phase", "clone", "cloned", "ppo", "learned"),
    ]  # fmt: skip
    batch, _, _ = learner.collect()
    optimizer = torch.optim.Adam(learner.weights, 1e-3)
    learner.learn(batch, optimizer, 1.0, critic_only=False)
    assert not torch.equal(learner.actor[0].weight, last)
