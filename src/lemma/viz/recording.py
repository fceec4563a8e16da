"""Recordings of episodes: states at equal intervals, and sub-tasks as text."""

import time
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lemma.core.poses import FloatArray
from lemma.dataset.playback import FrameTaker
from lemma.env.episode import Episode
from lemma.env.simulation import HORIZON_S
from lemma.evaluation.records import older_versions
from lemma.evaluation.run.rollout import Player, Rollout, StepRecord, roll_out
from lemma.expert.expert import ExpertStep
from lemma.expert.together import solve_together
from lemma.motion.outcome import SkillResult
from lemma.policies.spec import PolicySpec
from lemma.robots.hand import STANDARD
from lemma.scene.scene import Scene
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.bank import phrase, robot_phrases, sub_instruction
from lemma.tasks.subtask import SubTask
from lemma.viz.team_watch import TeamWatch

FRAME_S = 0.05
"""Default simulated time from one state to the next [s]."""
SOLVED = "Solved."
VERDICTS = ("understood", "allocated", "executed")
"""Verdicts on the first object that was moved; see :mod:`lemma.env.stages`."""

Frames = Sequence[tuple[float, FloatArray]]
"""Simulated time [s] and MuJoCo's joint positions, (nq,), in order of time."""


@dataclass(frozen=True, slots=True)
class Line:
    """One sub-task or another event, as text."""

    words: str
    """Such as ``"red robot: hook the blue cube ..."``."""
    start_s: float
    """Simulated time at which it began [s]."""
    end_s: float | None = None
    """Simulated time at which it ended [s]; None while it runs."""
    outcome: str = ""
    explanation: str = ""
    ok: bool = True
    subtask: SubTask | None = None
    """None for another event."""
    waits: tuple[tuple[float, float], ...] = ()
    """Begin and end of the times in which its robot waited for a region [s]."""
    effect_s: float | None = None
    """Simulated time from which other sub-tasks could use its result [s], at the latest
    its end; None if unknown."""

    @property
    def duration_s(self) -> float:
        """Its simulated duration [s]; 0 while it runs."""
        return 0.0 if self.end_s is None else self.end_s - self.start_s

    def watched(self, watch: TeamWatch, now_s: float) -> "Line":
        """Return a copy with waits and effect, from a watch.

        Args:
            watch: The watch of its simulation.
            now_s: The present simulated time [s], for a sub-task that still runs.
        """
        if self.subtask is None:
            return self
        during = self.start_s, now_s if self.end_s is None else self.end_s
        robot = self.subtask.robot
        waits, effect_s = watch.waits(robot, *during), watch.effect_s(robot, *during)
        return replace(self, waits=waits, effect_s=effect_s)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            **(self.subtask.to_dict() if self.subtask else {}),
            "outcome": self.outcome,
            "start_s": round(self.start_s, 3),
            "duration_s": round(self.duration_s, 3),
        }


@dataclass(frozen=True)
class Recording:
    """An episode of a policy, or by hand."""

    title: str
    """Title of the policy."""
    instance: Instance
    lines: tuple[Line, ...]
    """Its sub-tasks, in order."""
    frames: Frames
    """States, the first one at 0 s; empty if none were recorded."""
    success: bool
    failure: str | None
    """Reason of the failure; None after success."""
    elapsed_s: float
    """Simulated time [s]."""
    wall_s: float = 0.0
    """Real time of simulation and planning [s]; 0 if it was not measured."""
    because: str = ""
    """Reason of the failure as a sentence, if more than :attr:`failure` is known."""
    stages: Mapping[str, Any] = field(default_factory=dict)
    """Its stages, as in lines of results; empty if they were not computed."""

    @property
    def verdict(self) -> str:
        """The result, as a sentence."""
        why = (self.failure or "goal_not_reached").replace("_", " ")
        return SOLVED if self.success else self.because or f"Not solved: {why}."

    @property
    def realtime_factor(self) -> float:
        """Simulated seconds per second of real time."""
        return self.elapsed_s / self.wall_s

    def at(self, time_s: float) -> FloatArray:
        """Return the joint positions, (nq,), at a simulated time [s].

        Before the first and after the last frame, they are those of that frame.
        """
        found = bisect_right(self.frames, time_s + 1e-6, key=lambda frame: frame[0])
        return self.frames[max(0, found - 1)][1]

    def thinned(self, every: int) -> "Recording":
        """Return a copy with one in ``every`` frames, and the last."""
        kept = [*self.frames[:-1:every], self.frames[-1]]
        return replace(self, frames=kept)

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
            "subtasks": [line.to_dict() for line in self.lines],
        }


class Recorder:
    """Records the frames of an episode as it is played, and its sub-tasks."""

    def __init__(
        self,
        episode: Episode,
        frame_s: float | None = FRAME_S,
        before: Iterable[tuple[float, FloatArray]] = (),
    ) -> None:
        """Observe an episode.

        Args:
            episode: The episode.
            frame_s: Simulated time from one frame to the next [s]; no frames if None.
            before: Frames up to now.
        """
        self._episode = episode
        self._taker = (
            FrameTaker(episode.simulation, frame_s, before) if frame_s else None
        )
        self._watch = TeamWatch(episode.simulation)
        self.lines: list[Line] = []
        """The sub-tasks, in order."""

    def add(self, line: Line, now_s: float | None = None) -> Line:
        """Add a sub-task with what its robot waited for.

        Args:
            line: The sub-task.
            now_s: End of a sub-task without an end [s]; the present if None.
        """
        now_s = self._episode.elapsed_s if now_s is None else now_s
        self.lines.append(line.watched(self._watch, now_s))
        return self.lines[-1]

    @property
    def frames(self) -> Frames:
        """States, the first one at 0 s; empty if none are recorded."""
        return self._taker.frames if self._taker else ()

    def recording(self, title: str) -> Recording:
        """Return the recording of an episode that is over, under a title."""
        episode = self._episode
        return Recording(
            title,
            episode.instance,
            tuple(self.lines),
            self.frames,
            episode.is_success,
            episode.failure,
            episode.elapsed_s,
            stages=episode.stages.record(),
        )


def record(
    instance: Instance,
    player: Player | None = None,
    *,
    title: str = "The expert",
    frame_s: float | None = None,
    on_step: Callable[[Line], object] = lambda line: None,
    horizon_s: float = HORIZON_S,
) -> Recording:
    """Play an instance with a policy, and record it.

    Args:
        instance: The problem.
        player: The policy; the expert if None.
        title: Title of the policy.
        frame_s: Simulated time from one frame to the next [s]; no frames if None.
        on_step: Called with every sub-task as soon as it has ended.
        horizon_s: Simulated time after which the episode ends [s].
    """
    started = time.perf_counter()
    play = Rollout(instance, horizon_s=horizon_s)
    recorder = Recorder(play.episode, frame_s)

    def take_step(_: Rollout, step: StepRecord) -> None:
        on_step(recorder.add(describe_step(step, instance)))

    player = player or Player.load(PolicySpec())
    for _ in roll_out([play], player, on_step=take_step):
        pass
    done, wall_s = recorder.recording(title), time.perf_counter() - started
    return replace(done, success=play.success, failure=play.failure, wall_s=wall_s)


def record_together(
    instance: Instance,
    *,
    frame_s: float | None = None,
    on_step: Callable[[Line], object] = lambda line: None,
) -> Recording:
    """Play an instance with the expert and all robots at the same time; record it.

    Args:
        instance: The problem.
        frame_s: Simulated time from one frame to the next [s]; no frames if None.
        on_step: Called with every sub-task as soon as it has ended.

    Returns:
        The episode, with its sub-tasks in the order in which they began.
    """
    started = time.perf_counter()
    episode = Episode(instance)
    recorder = Recorder(episode, frame_s)
    for step in solve_together(episode):
        on_step(recorder.add(describe_step(step, instance)))
    recorder.lines.sort(key=lambda line: line.start_s)
    done = recorder.recording("The expert, all robots at once")
    return replace(done, wall_s=time.perf_counter() - started)


def reached_words(stages: Mapping[str, Any]) -> str:
    """Return an episode's progress: ``"60% of the stages; furthest: lifted, ..."``.

    Args:
        stages: As in lines of results; see :mod:`lemma.env.stages`.
    """
    words = f"{stages['progress']:.0%} of the stages"
    if stages["stage"]:
        words += f"; furthest: {stages['stage']}"
        if stages["subtask"] is not None:
            words += f", sub-task {stages['subtask'] + 1} of the expert's plan"
        words += f", at {stages['time_s']:.1f} s"
    return words


def judged(stages: Mapping[str, Any]) -> dict[str, str]:
    """Return the three verdicts on the first moved object, as text, by name.

    Args:
        stages: As in lines of results; see :mod:`lemma.env.stages`.
    """
    words = {True: "yes", False: "no", None: "open" if stages["moved"] else "not begun"}
    return {name: words[stages[name]] for name in VERDICTS}


def trained_words(weights: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a sentence if weights were trained on another version, else ``""``.

    Args:
        weights: Facts about weights by name of the model, as in ``about.json``.
    """
    older = older_versions(weights, BENCHMARK_VERSION)
    if not older:
        return ""
    versions = " and ".join(name.removeprefix("v") for name in older)
    return (
        f"Its weights were trained on version {versions} of the benchmark; this is "
        f"version {BENCHMARK_VERSION.removeprefix('v')}."
    )


def pose(scene: Scene, qpos: FloatArray) -> None:
    """Set the joint positions, (nq,), of a scene and update its bodies' poses."""
    scene.data.qpos[:] = qpos
    scene.refresh()


def main_sentence(instance: Instance) -> str:
    """Return the sentence that names an instance; user-defined ones may have none."""
    sentences = instance.instructions
    return sentences.get("high_level") or next(iter(sentences.values()), "")


def describe_step(step: StepRecord | ExpertStep, instance: Instance) -> Line:
    """Return the line of an executed sub-task."""
    words = describe_subtask(step.subtask, instance)
    return line_of(words, step.start_s, step.result, step.subtask)


def line_of(
    words: str, start_s: float, result: SkillResult, subtask: SubTask | None = None
) -> Line:
    """Return the line of a finished sub-task.

    Args:
        words: Its description.
        start_s: Simulated time at which it began [s].
        result: Its result.
        subtask: The sub-task; None for another event.
    """
    end_s, outcome = start_s + result.duration_s, str(result.outcome)
    return Line(words, start_s, end_s, outcome, result.explanation, result.ok, subtask)


def describe_subtask(subtask: SubTask, instance: Instance) -> str:
    """Return the text of a sub-task: ``"red robot: hook the blue cube ..."``."""
    number = instance.scene.robot_names.index(subtask.robot)
    robot = robot_phrases(instance.scene.robots)[number]
    # End-to-end models give poses without names of objects.
    if subtask.pick and subtask.place:
        words = sub_instruction(robot, subtask.primitive, subtask.pick, subtask.place)
        return name_region(words, subtask.place, instance)
    return f"{robot}: {subtask.primitive}"


def name_region(words: str, place: str, instance: Instance) -> str:
    """Replace a region's name by the colors of its robots, whose numbers are not shown.

    Args:
        words: Text of a sub-task.
        place: Its place; the text stays as it is unless this is a region.
        instance: The instance, with its robots.

    Returns:
        The text.
    """
    scene = instance.scene
    members = scene.regions.get(place, ())
    # The region of a whole team has a name of its own.
    if len(members) == len(scene.robots) or not members:
        return words
    phrases = robot_phrases(scene.robots)
    names = [phrases[number].removesuffix(" robot") for number in members]
    return words.replace(phrase(place), f"space of {' and '.join(names)}")


def robot_titles(instance: Instance) -> dict[str, str]:
    """Return color and arm type of every robot, by name: ``"red UR5"``.

    Robots of the same color and type also have a side: ``"left red UR5"``. Hands
    other than the standard one are named: ``"red UR5, weak hand"``.
    """
    scene = instance.scene
    kinds = [(robot.color, robot.arm) for robot in scene.robots]
    phrases = robot_phrases(scene.robots)
    titles = {}
    for name, kind, said in zip(scene.robot_names, kinds, phrases, strict=True):
        color, arm = kind
        words = color if kinds.count(kind) == 1 else said.removesuffix(" robot")
        titles[name] = f"{words} {arm.upper()}"
    for name, hand in zip(titles, scene.other_hands, strict=False):
        titles[name] += "" if hand == STANDARD else f", {hand} hand"
    return titles
