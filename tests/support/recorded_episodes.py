"""Expert episodes that several tests look at: each is run once and watched closely."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from kept import kept
from physics_steps import each_step

from lemma.dataset.recipe.record import EpisodeRecorder, record_episode
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.env.episode import Episode
from lemma.evaluation.run.watches import ClearanceWatch
from lemma.expert.expert import Expert, ExpertStep, solve
from lemma.expert.together import solve_together
from lemma.scene.scene import Scene
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, load_instance

TEAMS = ("ur5+ur5", "ur5+ur10", "ur10+ur10")
EPISODES = [(task, team) for task in SUITE for team in TEAMS]
"""One episode of every task with every team type."""
INDEX = 3
"""Of the test instances that :func:`played` and :func:`acted_together` play."""


@dataclass
class Extremes:
    """The worst that a scene saw in any physics step."""

    penetration_m: float = 0.0
    penetrating: tuple[str, ...] = ()
    """Names of the geoms."""
    velocity_ratio: float = 0.0
    """Largest joint velocity over its limit."""
    effort_ratio: float = 0.0
    """Largest joint torque, gravity compensation included, over its limit."""
    steps: int = 0


@dataclass(frozen=True)
class Recorded:
    """One episode of the expert."""

    instance: Instance
    steps: tuple[ExpertStep, ...]
    """Empty where all robots acted at once."""
    record: EpisodeRecord
    progress: float
    """Of its stages."""
    replans: int
    extremes: Extremes

    @property
    def hashes(self) -> tuple[str, ...]:
        """Of the full integration state at every keyframe."""
        return self.record.keyframe_sha256

    @property
    def success(self) -> bool:
        return self.record.success

    @property
    def elapsed_s(self) -> float:
        return self.record.elapsed_s


@dataclass(frozen=True)
class Together:
    """One episode of the expert in which all robots act at once."""

    steps: tuple[ExpertStep, ...]
    success: bool
    elapsed_s: float
    state_sha256: str
    """At the end."""
    waited_s: dict[str, float]
    """How long each robot waited for a part of the table."""
    clearance_m: float
    """The least between two arms."""


@dataclass
class _Watch:
    scene: Scene
    extremes: Extremes = field(default_factory=Extremes)

    def __post_init__(self) -> None:
        robots = self.scene.robots
        self.dof = np.r_[tuple(robot.dof for robot in robots)]
        self.speed = np.concatenate([r.arm.velocity_limits for r in robots])
        self.effort = np.concatenate([r.arm.effort_limits for r in robots])

    def look(self) -> None:
        model, data, seen = self.scene.model, self.scene.data, self.extremes
        seen.steps += 1
        if data.ncon:
            depths = -np.asarray(data.contact.dist)
            deepest = int(depths.argmax())
            if depths[deepest] > seen.penetration_m:
                seen.penetration_m = float(depths[deepest])
                geoms = data.contact.geom[deepest]
                seen.penetrating = tuple(model.geom(int(g)).name for g in geoms)
        velocity = np.abs(data.qvel[self.dof]) / self.speed
        torque = np.abs(data.qfrc_actuator[self.dof] + data.qfrc_gravcomp[self.dof])
        seen.velocity_ratio = max(seen.velocity_ratio, float(velocity.max()))
        seen.effort_ratio = max(seen.effort_ratio, float((torque / self.effort).max()))


@contextmanager
def watching(scene: Scene) -> Iterator[Extremes]:
    """Look at a scene in every single physics step, whoever makes it."""
    watch = _Watch(scene)
    with each_step(scene, watch.look):
        yield watch.extremes


def run_expert(
    instance: Instance,
) -> tuple[Episode, Expert, list[ExpertStep], list[str]]:
    """Let the expert work on an instance; return also the keyframes' hashes."""
    episode = Episode(instance)
    scene = episode.simulation.scene
    expert = Expert(scene, instance.goal)
    hashes, steps = [scene.state_hash()], []
    for step in solve(episode, expert):
        hashes.append(scene.state_hash())
        steps.append(step)
    return episode, expert, steps, hashes


@cache
def first_instance(task: str, team: str) -> Instance:
    """Return the first frozen test instance of a task with a team type."""
    instances = (load_instance(task, "test", i) for i in range(SPLITS["test"]))
    return next(instance for instance in instances if instance.team == team)


@kept
def recorded(task: str, team: str) -> Recorded:
    """Return the expert's episode of the first test instance with a team type."""
    return _played(first_instance(task, team), watched=True)


@kept
def played(task: str) -> Recorded:
    """Return the expert's episode of a test instance; nobody looks at its steps."""
    return _played(load_instance(task, "test", INDEX), watched=False)


def _played(instance: Instance, *, watched: bool) -> Recorded:
    if not instance.goal.in_turns:
        record = record_episode(instance)
        return Recorded(instance, (), record, record.progress, 0, Extremes())
    episode = Episode(instance)
    scene = episode.simulation.scene
    expert, keeper, steps = Expert(scene, instance.goal), EpisodeRecorder(episode), []
    keeper.keep()
    with watching(scene) if watched else nullcontext(Extremes()) as extremes:
        for step in solve(episode, expert):
            keeper.keep(step)
            steps.append(step)
    record = EpisodeRecord(**keeper.columns())
    progress = episode.progress
    return Recorded(instance, tuple(steps), record, progress, expert.replans, extremes)


@kept
def acted_together(task: str) -> Together:
    """Return how all robots solve the instance of :func:`played` at once."""
    episode = Episode(load_instance(task, "test", INDEX))
    simulation = episode.simulation
    watch = ClearanceWatch(simulation)
    steps = tuple(solve_together(episode))
    return Together(
        steps,
        episode.is_success,
        episode.elapsed_s,
        simulation.scene.state_hash(),
        dict(simulation.reservations.times.waited_s),
        watch.least_m,
    )
