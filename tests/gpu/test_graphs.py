"""The work of a control step beside physics can be recorded as a CUDA graph."""

import dataclasses
from typing import Any

import numpy as np
import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)
torch = pytest.importorskip("torch")

from torch.overrides import TorchFunctionMode  # noqa: E402
from torch.utils._python_dispatch import TorchDispatchMode  # noqa: E402
from torch.utils._pytree import tree_leaves  # noqa: E402

import lemma  # noqa: E402
from lemma.bench.worlds import measure_pictures, measure_worlds  # noqa: E402
from lemma.policies.control.hand_steps import Arms  # noqa: E402
from lemma.robots.ur.kinematics import forward  # noqa: E402
from lemma.warp.draws import Draws, uniform  # noqa: E402
from lemma.warp.graphs import recorded_if_possible  # noqa: E402
from lemma.warp.hands import hand_poses  # noqa: E402
from lemma.warp.vector_env import GpuVecEnv  # noqa: E402

HOST = ("local_scalar_dense", "nonzero", "masked_select", "lift_fresh")
"""Parts of the names of operations that read on the host, or copy from it."""


class OnDeviceOnly(TorchDispatchMode):
    """Notes operations that touch the host."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        tensors = [x for x in tree_leaves((args, kwargs)) if torch.is_tensor(x)]
        there = any(x.device.type == "cpu" for x in tensors)
        if there or any(part in str(func) for part in HOST):
            self.found.append(str(func))
        return func(*args, **(kwargs or {}))


class NoLists(TorchFunctionMode):
    """Notes lists as indices: on a device they are copied from the host."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_function__(
        self, func: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        name = getattr(func, "__name__", "")
        indices = name in ("__getitem__", "__setitem__")
        if indices and any(isinstance(x, list) for x in _parts(args[1])):
            self.found.append(f"{name} {args[1:2]}")
        return func(*args, **(kwargs or {}))


def _parts(index: Any) -> tuple[Any, ...]:
    return index if isinstance(index, tuple) else (index,)


def on_meta(value: Any, seen: dict[int, Any]) -> Any:
    """Return the value with tensors that have no memory, on another device."""
    if torch.is_tensor(value):
        # The original is kept, so that its number is not given to another.
        return seen.setdefault(id(value), (value, value.to("meta")))[1]
    if isinstance(value, dict):
        return {key: on_meta(each, seen) for key, each in value.items()}
    if isinstance(value, Arms):
        parts = (getattr(value, f.name) for f in dataclasses.fields(value))
        return Arms(*(on_meta(part, seen) for part in parts))
    return value


@pytest.mark.parametrize(
    ("task", "control", "reward", "near"),
    [
        ("lift_fixed", "delta_hand", "level", 0.5),
        ("stack", "delta_joint", "dense", 0.0),
        ("hand_over_fixed", "joint_position", "sparse", 0.0),
        ("place_fixed", "delta_ee_pose", "dense", 0.0),
    ],
)
def test_a_step_beside_physics_touches_no_host(
    task: str, control: str, reward: str, near: float
) -> None:
    env = GpuVecEnv(
        task, 2, pool=2, device="cpu", control=control, reward=reward, near=near
    )
    seen: dict[int, Any] = {}
    for owner in (env, env.signals, env.draws):
        for name, value in list(vars(owner).items()):
            if name not in ("pool", "model", "data"):
                vars(owner)[name] = on_meta(value, seen)
    env.device = "meta"
    with torch.no_grad(), OnDeviceOnly() as noted, NoLists() as lists:
        env._command()
        told = env._judge()
    assert noted.found == []
    assert lists.found == []
    assert told["reward"].device.type == "meta"


def test_draws_are_the_same_after_the_same_seed_and_differ_otherwise() -> None:
    draws = Draws(1000, 6, seed=5, device="cpu")
    first, second = draws.draw(), draws.draw()
    draws.seed(5)
    assert torch.equal(draws.draw(), first)
    draws.seed(6)
    assert not torch.equal(draws.draw(), first)
    assert not torch.equal(first, second)
    shares = uniform(torch.cat([first, second]))
    assert float(shares.min()) >= 0.0
    assert float(shares.max()) < 1.0
    assert shares.mean(0).tolist() == pytest.approx([0.5] * 6, abs=0.05)
    assert float(torch.corrcoef(shares.T).fill_diagonal_(0.0).abs().max()) < 0.1


def test_hands_are_where_forward_kinematics_says() -> None:
    rng = np.random.default_rng(0)
    names = ["ur5", "ur10"]
    q = rng.uniform(-3.0, 3.0, (20, 2, 6))
    base = rng.uniform(-1.0, 1.0, (20, 2, 3))
    found = hand_poses(torch.tensor(q), torch.tensor(base), Arms.of(names)).numpy()
    for world in range(20):
        for robot, name in enumerate(names):
            x, y, yaw = base[world, robot]
            c, s = np.cos(yaw), np.sin(yaw)
            stand = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
            pose = stand @ forward(lemma.ARMS[name].dh, q[world, robot])
            here = pose[:3, 3] + 0.12 * pose[:3, 2]
            told = found[world, robot]
            assert told[:3] == pytest.approx(here, abs=1e-5)
            assert told[3:] == pytest.approx(pose[:3, :3].ravel(), abs=1e-5)


def test_where_nothing_is_recorded_a_warning_says_why() -> None:
    def work() -> None:
        raise RuntimeError("no such operation")

    with pytest.warns(RuntimeWarning, match="No CUDA graph of this"):
        assert recorded_if_possible("this", work, "cuda:0") is work


def test_speed_is_told_with_how_much_both_ways_differ() -> None:
    found = measure_worlds("lift_fixed", 2, steps=2, pool=1, device="cpu")
    assert found["graphed"] is False
    assert found["graph_hz"] > 0.0
    assert 0.0 < found["physics_ms"] < found["step_ms"]
    assert 0.0 < found["outside"] < 1.0
    assert {"reward", "goal_state", "commands", "memory"} <= set(found["differences"])
    # On a CPU both ways are the same functions, and draw the same.
    assert set(found["differences"].values()) == {0.0}


def test_speed_of_pictures_is_told() -> None:
    options = {"pool": 1, "device": "cpu", "width": 16, "height": 16}
    found = measure_pictures("lift_fixed", 2, steps=1, **options)
    assert found["cameras"] == 2
    assert found["images_hz"] > found["rgbd_hz"] > 0.0
