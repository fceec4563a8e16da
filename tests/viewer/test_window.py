"""``render_mode="human"``: a window where there is a display, else an explanation."""

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lemma import make
from lemma.core.errors import RenderingError


class Viewer:
    """Stands for MuJoCo's: counts how often it is told to look."""

    def __init__(self) -> None:
        self.opened: list[Any] = []
        self.looks = self.closed = 0

    def launch_passive(self, model: object, data: object, **_: object) -> "Viewer":
        self.opened.append(data)
        return self

    def is_running(self) -> bool:
        return True

    def sync(self) -> None:
        self.looks += 1

    def close(self) -> None:
        self.closed += 1


def test_without_a_display_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RenderingError, match="lemma play"):
        make("stack", render_mode="human")


def test_window_follows_every_episode_and_changes_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    viewer = Viewer()
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    hashes = []
    for mode in ("human", None):
        env = make(
            "stack", control="joint_velocity", render_mode=mode, split="test", index=0
        )
        still = np.zeros(env.action_space.shape or ())
        for _ in range(2):
            env.reset()
            for _ in range(4):
                env.step(still)
        hashes.append(env.state_hash())
        env.close()
    assert hashes[0] == hashes[1]
    assert len(viewer.opened) == 2
    assert viewer.closed == 2
    # 0.2 s at 30 Hz, twice.
    assert 8 <= viewer.looks <= 12


def test_failing_window_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    def launch(*_: object, **__: object) -> None:
        raise RuntimeError("mjpython is needed")

    monkeypatch.setenv("DISPLAY", ":0")
    broken = SimpleNamespace(launch_passive=launch)
    monkeypatch.setitem(sys.modules, "mujoco.viewer", broken)
    env = make("stack", render_mode="human")
    with pytest.raises(RenderingError, match=r"mjpython.*rgb_array"):
        env.reset()
