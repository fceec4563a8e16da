"""A page's episodes, one after another, and its loaded policies."""

import threading
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError, shown
from lemma.core.poses import Pose2
from lemma.evaluation.run.control import ControlPlayer, load_player
from lemma.evaluation.run.loading import weights_of
from lemma.evaluation.run.rollout import Player
from lemma.policies.control.interfaces import is_model_server
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.policies.weights import are_here
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.scene.table import Gap
from lemma.serve.websocket import is_address
from lemma.tasks.instance import OWN_SPLIT, Instance
from lemma.tasks.task import TASKS
from lemma.tasks.teams.layouts import LAYOUTS, gap_beyond
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.status import TOGETHER, EpisodeRequest
from lemma.viewer.episode.team_play import TeamPlay
from lemma.viewer.episode.teleoperator import BY_HAND, Teleoperator

_PATIENCE_S = 1.0
"""Longest wait for a policy to stop [s]."""


_PAIR = 2
_LEARNED = ("reachnet", "episodic-transformer+cliport", "m-cliport")


class Session:
    """Commands of a page; safe to use from any thread."""

    def __init__(
        self,
        request: EpisodeRequest,
        policies: tuple[str, ...],
        load: Callable[[str], Player] = lambda name: load_player(PolicySpec(name)),
        *,
        acts: bool = False,
    ) -> None:
        """Set the first table.

        Args:
            request: The first request.
            policies: Names of the policies to choose from.
            load: Function that loads a policy by its name.
            acts: Whether to act at once.
        """
        self.policies = policies
        self._load = load
        self._loaded: dict[str, Player] = {}
        self._loading = threading.Lock()
        self._commands = threading.Lock()
        self._speed = 1.0
        self._check(request)
        self.play = self._begin(request, acts)

    def _begin(self, request: EpisodeRequest, acts: bool, steps: bool = False) -> Play:
        kind = TeamPlay if request.policy == TOGETHER else Play
        return kind(request, self._player, acts=acts, steps=steps, speed=self._speed)

    def _player(self, name: str) -> Player:
        if name == BY_HAND:
            return ControlPlayer(Teleoperator())
        with self._loading:
            if name not in self._loaded:
                self._loaded[name] = self._load(name)
            # A renderer belongs to one thread, so each play gets its own.
            player = self._loaded[name]
        if isinstance(player, ControlPlayer):
            return ControlPlayer(player.policy)
        rig = None if player.rig is None else type(player.rig)()
        return replace(player, rig=rig)

    def offer(self, address: str) -> None:
        """Add the policy of a server to the choices, without connecting to it.

        Args:
            address: Address of ``lemma serve``, or of a model server of vla-eval. Names
                of classes are refused, since loading one would run its code.

        Raises:
            InvalidConfigError: It is not an address.
        """
        address = address.strip()
        if not (is_address(address) or is_model_server(address)):
            raise InvalidConfigError(
                f"{shown(address)} is not the address of a policy. Valid: "
                "http://HOST:PORT of lemma serve, or vla-eval://HOST:PORT."
            )
        PolicySpec(address)
        if address not in self.policies:
            self.policies = (*self.policies, address)

    def ask(self, request: EpisodeRequest, *, acts: bool, steps: bool = False) -> None:
        """Leave the present episode, and set another table.

        Args:
            request: The next request.
            acts: Whether to act; otherwise only the table is set.
            steps: Whether to pause after the first sub-task.

        Raises:
            UnknownNameError: The policy is not among the choices.
        """
        self._check(request)
        with self._commands:
            before = self.play
            if not before.leave(_PATIENCE_S) and not self._loading.locked():
                # The policy hangs, so the next play loads it again.
                self._loaded.pop(before.request.policy, None)
            self.play = self._begin(request, acts, steps)

    def move(self, name: str, pose: Pose2) -> None:
        """Put a robot or an object elsewhere.

        Before and after an episode, the table changes and is set again. A running
        episode is paused, and the object is moved in it if possible.

        Args:
            name: Name of the robot or object.
            pose: New pose in the world's frame.

        Raises:
            InvalidConfigError: It cannot be there, or cannot be moved now.
            UnknownNameError: There is no robot or object of this name.
        """
        play = self.play
        if not play.acts or play.rollout is None or play.transport.over:
            own = moved(play.request.instance(), name, pose)
            self.ask(replace(play.request, own=own), acts=False)
        elif name in play.rollout.instance.scene.robot_names:
            raise InvalidConfigError(
                "Robots can be moved only before or after an episode."
            )
        else:
            play.nudge(name, pose)

    def take(self, instance: Instance) -> None:
        """Set a user-defined table.

        Args:
            instance: Any instance.
        """
        request = replace(self.play.request, task=instance.task, own=instance)
        self.ask(request, acts=False)

    def take_listed(self) -> None:
        """Set the listed table again."""
        self.ask(replace(self.play.request, own=None), acts=False)

    def _check(self, request: EpisodeRequest) -> None:
        known("policy", request.policy, self.policies)

    def restart(self) -> None:
        """Set the same table again, and act again if the last play acted."""
        self.ask(self.play.request, acts=self.play.acts)

    def set_speed(self, speed: float) -> None:
        """Set the speed, as a multiple of real time, for this and later episodes."""
        self._speed = speed
        self.play.transport.set_speed(speed)

    def close(self) -> None:
        """End the episode, and close the loaded policies."""
        with self._commands:
            self.play.leave(_PATIENCE_S)
            for player in self._loaded.values():
                close = getattr(player.policy, "close", None)
                if callable(close):
                    close()
            self._loaded.clear()


def best_for(task: str, policies: tuple[str, ...]) -> str:
    """Return the name of the default policy of a task.

    Args:
        task: Name of the task.
        policies: Names of loadable policies, the best one for two robots first.
    """
    # Learned policies were trained with two robots that take turns.
    is_large = LAYOUTS[TASKS[task].layout].size > _PAIR
    return TOGETHER if is_large and TOGETHER in policies else policies[0]


def choices(wanted: str | None = None) -> tuple[str, ...]:
    """Return names of policies that can be loaded here, the best one first.

    Learned policies are included if their weights are on this machine.

    Args:
        wanted: A policy to include. Its weights are checked now; servers and classes
            are checked when it is loaded.

    Raises:
        LemmaError: ``wanted`` is no policy, or its weights are missing or damaged.
    """
    learned = _LEARNED if find_spec("torch") else ()
    here = [name for name in learned if all(map(are_here, name.split("+")))]
    found = [*here, ORACLE, TOGETHER, BY_HAND]
    if wanted is not None and wanted not in found:
        weights_of(PolicySpec(wanted))
        found.append(wanted)
    return tuple(found)


def moved(instance: Instance, name: str, pose: Pose2) -> Instance:
    """Return an instance in which a robot or an object begins elsewhere.

    Args:
        instance: Any instance.
        name: Name of the robot or object.
        pose: Its new pose in the world's frame.

    Raises:
        InvalidConfigError: The pose is outside of the room.
        UnknownNameError: There is no robot or object of this name.
    """
    scene, pose = instance.scene, pose.rounded()
    if name in scene.robot_names:
        number, robots = scene.robot_names.index(name), [*scene.robots]
        robots[number] = replace(robots[number], base=pose)
        gap_m = _gap_for(scene, tuple(robots))
        spec = replace(scene, robots=tuple(robots), gap_m=gap_m)
    else:
        placed, objects = scene.placement(name), [*scene.objects]
        objects[objects.index(placed)] = replace(placed, pose=pose)
        spec = replace(scene, objects=tuple(objects))
    return replace(instance, scene=spec, split=OWN_SPLIT)


def _gap_for(before: SceneSpec, robots: tuple[RobotPlacement, ...]) -> Gap | None:
    """Return the table's gap, moved together with the robot whose side it bounds."""
    gap = before.gap_m
    if gap is None or len(robots) != 2:
        return gap
    away = [abs(gap_beyond(before.robots, robot)[0] - gap[0]) for robot in (0, 1)]
    return gap_beyond(robots, away.index(min(away)))
