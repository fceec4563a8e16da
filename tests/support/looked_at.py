"""Plays that tests look at: a policy that needs no images, and time that they make."""

import time
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from lemma.evaluation.run.control import ControlPlayer
from lemma.evaluation.run.rollout import Player, Rollout
from lemma.policies.control.interfaces import ControlInput
from lemma.policies.interfaces import (
    Decision,
    Insight,
    PolicyInput,
    SeenObject,
    SeenRobot,
    Understanding,
)
from lemma.policies.spec import PolicySpec
from lemma.tasks.subtask import STOP, Primitive, SubTask
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.session import Session
from lemma.viewer.episode.status import OWN_WORDS, EpisodeRequest, Phase, Reading

WAIT_S = 120.0
STACK = EpisodeRequest("stack", "test", 0)
SAID = "Put it there, please"
EVIL = "<img src=x onerror=window.evil=1>{1+1}"


def own(text: str, policy: str = "oracle") -> EpisodeRequest:
    return EpisodeRequest("stack", "test", 0, OWN_WORDS, text, policy)


class Reads:
    """Understands always the same, and stops at once."""

    def __init__(
        self, pairs: tuple[tuple[str, str], ...], certainty: float, **more: Any
    ) -> None:
        self.answer = Understanding(pairs, certainty, **more)

    def understand(self, inputs: Sequence[PolicyInput]) -> list[Any]:
        return [self.answer for _ in inputs]

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return [Decision(STOP, None) for _ in inputs]


class Explains(Reads):
    """Knows why, and stops at once."""

    def explain(self, inputs: Sequence[PolicyInput]) -> list[Insight]:
        pairs = self.answer.goal
        things = tuple(SeenObject(name, (0.3, 0.2)) for name in pairs[0])
        robots = (SeenRobot((-0.7, 0.0), (0.2, 0.8)), SeenRobot((0.7, 0.0), (0.2, 0.8)))
        options = ((STOP, 0.9), (SubTask("robot_0", Primitive.MOVE, *pairs[0]), 0.1))
        return [Insight(things, robots, pairs, options) for _ in inputs]


class Raises:
    """Fails, with a message that would be markup."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        raise ValueError(EVIL)


class StandsStill:
    """Commands the motors to stay where they are."""

    control_options: ClassVar = {"control": "joint_velocity", "observation": "state"}

    def act(self, inputs: Sequence[ControlInput]) -> list[Any]:
        return [np.zeros((len(given.robots), 7)) for given in inputs]


def player_of(**policies: object) -> Callable[[str], Player]:
    """Return what loads the expert, and policies of tests by their names."""

    def load(name: str) -> Player:
        if name in policies:
            found: Any = policies[name]
            controls = hasattr(found, "control_options")
            return ControlPlayer(found) if controls else Player(found)
        return Player.load(PolicySpec(name))

    return load


def until(
    true: Callable[[], bool], play: Play | None = None, wait_s: float = WAIT_S
) -> None:
    """Wait until something is true, while time passes for a play."""
    end = time.monotonic() + wait_s
    while not true():
        assert time.monotonic() < end, "never true"
        if play is not None:
            play.transport.advance(1.0)
        time.sleep(0.002)


def until_phase(play: Play, phase: Phase) -> None:
    until(lambda: play.status.phase is phase, play)


def reading_of(play: Play) -> Reading:
    assert play.status.reading is not None
    return play.status.reading


def rollout_of(play: Play) -> Rollout:
    assert play.rollout is not None
    return play.rollout


def session_of(request: EpisodeRequest = STACK, **policies: object) -> Session:
    return Session(request, ("oracle", *policies), player_of(**policies))


def seen_at(
    client: Any, point: Sequence[float], size: Sequence[float]
) -> tuple[float, float]:
    """Return where a visitor sees a point of the world, in a picture of a size [px].

    The picture may have fewer pixels than the page.
    """
    camera = client.camera
    eye, target, up = (
        np.asarray(each, float)
        for each in (camera.position, camera.look_at, camera.up_direction)
    )
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    along, (width, height) = np.asarray(point) - eye, size
    scale = along @ ahead * np.tan(camera.fov / 2.0) * 2.0 / height
    return (
        float(width / 2 + along @ right / scale),
        float(height / 2 - along @ np.cross(right, ahead) / scale),
    )
