"""An episode of a policy, with a state for every frame of its video."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from lemma.core.poses import FloatArray
from lemma.env.playback import FrameTaker
from lemma.env.simulation import HORIZON_S
from lemma.evaluation.run.rollout import Player, Rollout, TakenStep, roll_out
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases, sub_instruction
from lemma.tasks.subtask import SubTask


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """One sub-task of a recording, in words and numbers."""

    robot: str
    """The robot in words: ``"red UR5"``."""
    subtask: SubTask
    words: str
    """The sub-task in words: ``"red robot: hook the blue cube ..."``."""
    outcome: str
    explanation: str
    ok: bool
    start_s: float
    """Simulated time at which it began [s]."""
    duration_s: float
    """Simulated time that it took [s]."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            **self.subtask.to_dict(),
            "outcome": self.outcome,
            "start_s": round(self.start_s, 3),
            "duration_s": round(self.duration_s, 3),
        }


@dataclass(frozen=True, slots=True)
class Recording:
    """What a policy did with an instance."""

    instance: Instance
    steps: tuple[RecordedStep, ...]
    frames: tuple[tuple[float, FloatArray], ...]
    """Simulated time [s] and full state of every frame of the video, if one is made."""
    success: bool
    failure: str | None
    """Why it failed."""
    elapsed_s: float
    """Simulated time [s]."""
    wall_s: float
    """Real time that simulating and planning took [s]."""

    @property
    def realtime_factor(self) -> float:
        """Simulated seconds per second of real time."""
        return self.elapsed_s / self.wall_s

    def thinned(self, every: int) -> "Recording":
        """Return the same with one frame of so many, and the last."""
        last = len(self.frames) - 1
        kept = [
            frame
            for number, frame in enumerate(self.frames)
            if number % every == 0 or number == last
        ]
        return replace(self, frames=tuple(kept))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            "task": self.instance.task,
            "instance": self.instance.key,
            "instruction": main_sentence(self.instance),
            "team": self.instance.team,
            "success": self.success,
            "failure": self.failure,
            "simulated_s": round(self.elapsed_s, 3),
            "wall_s": round(self.wall_s, 3),
            "subtasks": [step.to_dict() for step in self.steps],
        }


def record(
    instance: Instance,
    player: Player | None = None,
    *,
    frame_s: float | None = None,
    on_step: Callable[[RecordedStep], None] | None = None,
    horizon_s: float = HORIZON_S,
) -> Recording:
    """Let a policy work on an instance.

    Args:
        instance: The problem.
        player: The policy; the expert if None.
        frame_s: Simulated time from one frame to the next [s]; no frames if None.
        on_step: Told of every sub-task as soon as it has ended.
        horizon_s: Simulated time after which the episode ends [s].
    """
    started = time.perf_counter()
    play = Rollout(instance, horizon_s=horizon_s)
    episode, simulation = play.episode, play.episode.simulation
    taker = None
    if frame_s is not None:
        taker = FrameTaker(simulation, frame_s, simulation.scene.snapshot)
    steps = []

    def take_step(_: Rollout, step: TakenStep) -> None:
        steps.append(describe_step(step, instance))
        if on_step:
            on_step(steps[-1])

    player = player or Player.load(PolicySpec())
    for _ in roll_out([play], player, on_step=take_step):
        pass
    return Recording(
        instance=instance,
        steps=tuple(steps),
        frames=tuple(taker.frames) if taker else (),
        success=play.success,
        failure=play.failure,
        elapsed_s=episode.elapsed_s,
        wall_s=time.perf_counter() - started,
    )


def main_sentence(instance: Instance) -> str:
    """Return the sentence by which an instance is named; an own one may have none."""
    sentences = instance.instructions
    return sentences.get("high_level") or next(iter(sentences.values()), "")


def describe_step(step: TakenStep, instance: Instance) -> RecordedStep:
    """Put an executed sub-task into words."""
    number = instance.scene.robot_names.index(step.subtask.robot)
    return RecordedStep(
        robot=robot_titles(instance)[number],
        subtask=step.subtask,
        words=describe_subtask(step.subtask, instance),
        outcome=str(step.result.outcome),
        explanation=step.result.explanation,
        ok=step.result.ok,
        start_s=step.start_s,
        duration_s=step.result.duration_s,
    )


def describe_subtask(subtask: SubTask, instance: Instance) -> str:
    """Put a sub-task into words: ``"red robot: hook the blue cube ..."``."""
    number = instance.scene.robot_names.index(subtask.robot)
    robot = robot_phrases(instance.scene.robots)[number]
    # A model that acts from end to end names no objects.
    if subtask.pick and subtask.place:
        return sub_instruction(robot, subtask.primitive, subtask.pick, subtask.place)
    return f"{robot}: {subtask.primitive}"


def robot_titles(instance: Instance) -> tuple[str, ...]:
    """Return color and arm type of every robot: ``"red UR5"``, ``"left red UR5"``."""
    robots = instance.scene.robots
    kinds = [(robot.color, robot.arm) for robot in robots]
    colors = robot_phrases(robots)
    return tuple(
        f"{color} {arm.upper()}"
        if kinds.count((color, arm)) == 1
        else f"{phrase.removesuffix(' robot')} {arm.upper()}"
        for (color, arm), phrase in zip(kinds, colors, strict=True)
    )


def warm_up(instance: Instance) -> float:
    """Compile what the expert needs, which happens once per machine.

    Returns:
        How long it took [s].
    """
    started = time.perf_counter()
    record(instance, horizon_s=2.0)
    return time.perf_counter() - started
