"""What happened on a table: states, and the sub-tasks in words."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

from lemma.core.poses import FloatArray
from lemma.env.playback import FrameTaker
from lemma.env.simulation import Simulation
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.viewer.episode.status import Line
from lemma.viz.recording import Recording

FRAME_S = 0.05
"""Simulated time from one state to the next [s]."""
EXPERT = "The expert"
BY_HAND = "By hand"
SOLVED = "Solved."
"""What is said of an episode that succeeded."""

Frames = Sequence[tuple[float, FloatArray]]
"""Simulated time [s] and positions of all joints, (nq,), in order."""


@dataclass(frozen=True)
class Track:
    """What one policy did with an instance."""

    title: str
    """Who did it, in words."""
    instance: Instance
    frames: Frames
    lines: tuple[Line, ...]
    """Its sub-tasks."""
    verdict: str
    """What came of it, in a sentence."""
    solved: bool
    times: list[float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Keep the times, which are looked up often."""
        object.__setattr__(self, "times", [time_s for time_s, _ in self.frames])

    @property
    def end_s(self) -> float:
        """Simulated time of the last state [s]."""
        return self.times[-1]

    def at(self, time_s: float) -> FloatArray:
        """Return positions of all joints at a time, the first or last outside."""
        return self.frames[max(0, bisect_right(self.times, time_s + 1e-6) - 1)][1]


def keep_frames(simulation: Simulation, before: Frames = ()) -> FrameTaker:
    """Keep the joints' positions of a simulation from now on.

    Args:
        simulation: It is not changed.
        before: Frames of an earlier part of the episode.
    """
    data = simulation.scene.data
    return FrameTaker(simulation, FRAME_S, lambda: data.qpos.copy(), before)


def track_of(recording: Recording, title: str) -> Track:
    """Return what was recorded for a video.

    Args:
        recording: With frames.
        title: Who did it, in words.
    """
    scene = Scene(recording.instance.scene)
    frames = []
    for time_s, state in recording.frames:
        scene.restore(state)
        frames.append((time_s, scene.data.qpos.copy()))
    lines = tuple(
        Line(
            step.words,
            step.start_s,
            step.start_s + step.duration_s,
            step.outcome,
            step.explanation,
            step.ok,
        )
        for step in recording.steps
    )
    done = recording.success
    return Track(
        title,
        recording.instance,
        frames,
        lines,
        SOLVED if done else unsolved(recording.failure),
        done,
    )


def unsolved(failure: str | None) -> str:
    """Return why an episode failed, in a sentence."""
    return f"Not solved: {(failure or 'goal_not_reached').replace('_', ' ')}."
