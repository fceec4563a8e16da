"""What a page looks at: one play after another, and the policies that are loaded."""

import threading
from collections.abc import Callable
from dataclasses import replace

from lemma.core.errors import UnknownNameError
from lemma.evaluation.run.rollout import Player
from lemma.policies.spec import PolicySpec
from lemma.viewer.play import Play
from lemma.viewer.wish import Wish

_PATIENCE_S = 1.0
"""How long a policy is waited for that shall stop [s]."""


def load_player(name: str) -> Player:
    """Return a policy, with what it sees with."""
    return Player.load(PolicySpec(name))


class Session:
    """Commands of a page; safe to use from any thread."""

    def __init__(
        self,
        wish: Wish,
        policies: tuple[str, ...],
        load: Callable[[str], Player] = load_player,
        *,
        acts: bool = False,
    ) -> None:
        """Set the first table.

        Args:
            wish: What to begin with.
            policies: Names of those that may be chosen.
            load: Loads one.
            acts: Whether to act at once.
        """
        self.policies = policies
        self._load = load
        self._loaded: dict[str, Player] = {}
        self._loading = threading.Lock()
        self._commands = threading.Lock()
        self._speed = 1.0
        self._check(wish)
        self.play = self._begin(wish, acts)

    def _begin(self, wish: Wish, acts: bool, steps: bool = False) -> Play:
        return Play(wish, self._player, acts=acts, steps=steps, speed=self._speed)

    def _player(self, name: str) -> Player:
        with self._loading:
            if name not in self._loaded:
                self._loaded[name] = self._load(name)
            # What renders belongs to one thread.
            player = self._loaded[name]
        rig = None if player.rig is None else type(player.rig)()
        return replace(player, rig=rig)

    def ask(self, wish: Wish, *, acts: bool, steps: bool = False) -> None:
        """Leave what is played, and set the table for something else.

        Args:
            wish: What is asked for.
            acts: Whether to act; else the table is looked at.
            steps: Whether to pause after the first sub-task.

        Raises:
            UnknownNameError: The policy is none of those that may be chosen.
        """
        self._check(wish)
        with self._commands:
            before = self.play
            if not before.leave(_PATIENCE_S) and not self._loading.locked():
                # It is still at work on what it was asked: the next play loads another.
                self._loaded.pop(before.wish.policy, None)
            self.play = self._begin(wish, acts, steps)

    def _check(self, wish: Wish) -> None:
        if wish.policy not in self.policies:
            raise UnknownNameError("policy", wish.policy, self.policies)

    def restart(self) -> None:
        """Set the same table again, and act again if it was acted on."""
        self.ask(self.play.wish, acts=self.play.acts)

    def set_speed(self, speed: float) -> None:
        """Set how many times real time is played, from now on."""
        self._speed = speed
        self.play.transport.set_speed(speed)

    def close(self) -> None:
        """End what is played, and give back what was loaded."""
        with self._commands:
            self.play.leave(_PATIENCE_S)
            for player in self._loaded.values():
                close = getattr(player.policy, "close", None)
                if callable(close):
                    close()
            self._loaded.clear()
