"""A teleoperated episode played again: the same commands at the same times."""

import math

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose, Pose2
from lemma.dataset.playback import Watcher, carry_out, unwatched
from lemma.dataset.teleoperation.schema import (
    Executed,
    Teleoperation,
    joints_sha256,
)
from lemma.env.episode import Episode
from lemma.env.simulation import TICK_S, Simulation
from lemma.expert.symbolic_state import SymbolicState
from lemma.scene.objects.entity import entity_named
from lemma.scene.overlaps import check_place

_EARLY_S = 0.5 * TICK_S


class _ReachedError(Exception):
    """The time is reached at which a step was broken off."""


class _Clock:
    """Moves objects and ends steps at the recorded times, between ticks."""

    def __init__(self, simulation: Simulation, done: Teleoperation) -> None:
        self._simulation = simulation
        self._nudged = list(done.nudged)
        self._end_s = done.end_s
        self.until_s: float | None = None
        simulation.observers.append(self._look)

    def stop(self) -> None:
        """Do so no longer."""
        self._simulation.observers.remove(self._look)

    @property
    def at_end(self) -> bool:
        """Whether the end of the recording is reached."""
        return self._simulation.time_s >= self._end_s - _EARLY_S

    def _look(self) -> None:
        now_s = self._simulation.time_s + _EARLY_S
        while self._nudged and self._nudged[0].time_s <= now_s:
            nudged = self._nudged.pop(0)
            nudge(self._simulation, nudged.name, nudged.pose)
        if self.at_end or (self.until_s is not None and self.until_s <= now_s):
            raise _ReachedError


def perform(
    done: Teleoperation,
    episode: Episode,
    before: Watcher = unwatched,
) -> None:
    """Play a teleoperated episode again, up to the end of what was kept.

    Args:
        done: The recording.
        episode: Episode of its instance, just begun; at the end it needs not be over.
        before: Is told of each part.

    Raises:
        LemmaError: A step is impossible: the file was changed.
    """
    clock = _Clock(episode.simulation, done)
    try:
        _perform(done, episode, clock, before)
    finally:
        clock.stop()
    before(len(done.parts))


def _perform(
    done: Teleoperation, episode: Episode, clock: _Clock, before: Watcher
) -> None:
    simulation = episode.simulation
    for number, part in enumerate(done.parts):
        try:
            while simulation.time_s < part.start_s - _EARLY_S:
                simulation.tick()
            before(number)
            if isinstance(part, Executed):
                clock.until_s = part.until_s
                carry_out(episode, part.grounded)
            else:
                carry_out(episode, part)
        except _ReachedError:
            if clock.at_end:
                return
        finally:
            clock.until_s = None
    try:
        while not clock.at_end:
            simulation.tick()
    except _ReachedError:
        pass


def is_same(done: Teleoperation, episode: Episode) -> bool:
    """Return whether the end of an episode is the recorded one, to the bit."""
    return joints_sha256(episode.simulation.scene.data.qpos) == done.end_sha256


def nudge(simulation: Simulation, name: str, pose: Pose2) -> None:
    """Move an object on the table, at rest, between two steps of physics.

    Args:
        simulation: Between two ticks.
        name: Name of the object.
        pose: Where to put it.

    Raises:
        InvalidConfigError: It cannot be moved, or not there; nothing has moved.
    """
    scene = simulation.scene
    _check_free(simulation, name)
    before, kind = scene.snapshot(), entity_named(name).kind
    half = pose.yaw / 2.0
    turned = (math.cos(half), 0.0, 0.0, math.sin(half))
    scene.set_pose(name, Pose((pose.x, pose.y, kind.origin_m), turned))
    try:
        check_place(scene, name)
    except InvalidConfigError:
        scene.restore(before)
        raise


def _check_free(simulation: Simulation, name: str) -> None:
    scene, phrase = simulation.scene, entity_named(name).phrase
    if name not in scene.movable_names:
        raise InvalidConfigError(
            f"The {phrase} is fixed. It is moved before an episode or after it."
        )
    if name in simulation.held().values():
        raise InvalidConfigError(f"The {phrase} is in a gripper. Wait until it is not.")
    above = SymbolicState.observe(scene).on_top_of(name)
    if above is not None:
        raise InvalidConfigError(
            f"The {entity_named(above).phrase} lies on the {phrase}. Move that first."
        )
