"""Plays that tests look at: a policy that needs no images, and time that they make."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from lemma.evaluation.run.rollout import Player
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.spec import PolicySpec
from lemma.tasks.subtask import STOP
from lemma.viewer.play import Play
from lemma.viewer.session import Session
from lemma.viewer.wish import OWN_WORDS, Wish

WAIT_S = 120.0
STACK = Wish("stack", "test", 0)
SAID = "Put it there, please"


def own(text: str, policy: str = "oracle") -> Wish:
    return Wish("stack", "test", 0, OWN_WORDS, text, policy)


class Reads:
    """Understands always the same, and stops at once."""

    def __init__(self, pairs: tuple[tuple[str, str], ...], certainty: float) -> None:
        self.answer = (pairs, certainty)

    def understand(self, inputs: Sequence[PolicyInput]) -> list[Any]:
        return [self.answer for _ in inputs]

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return [Decision(STOP, None) for _ in inputs]


def player_of(**policies: object) -> Callable[[str], Player]:
    """Return what loads the expert, and policies of tests by their names."""

    def load(name: str) -> Player:
        if name in policies:
            return Player(policies[name])
        return Player.load(PolicySpec(name))

    return load


def until(true: Callable[[], bool], play: Play | None = None) -> None:
    """Wait until something is true, while time passes for a play."""
    end = time.monotonic() + WAIT_S
    while not true():
        assert time.monotonic() < end, "never true"
        if play is not None:
            play.transport.advance(1.0)
        time.sleep(0.002)


def session_of(wish: Wish = STACK, **policies: object) -> Session:
    return Session(wish, ("oracle", *policies), player_of(**policies))
