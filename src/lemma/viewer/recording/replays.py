"""Episodes done again to the bit, and what the expert would have done in them."""

from dataclasses import dataclass, replace

from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.teleoperation.perform import is_same, perform
from lemma.dataset.teleoperation.schema import LED, Commanded, Teleoperation
from lemma.env.episode import Episode, EpisodeSnapshot
from lemma.env.playback import FrameTaker, play_steps
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.report.episodes import Case, explanation, subtask_words
from lemma.evaluation.run.replay import differences, play_again
from lemma.expert.expert import Expert, ExpertStep, solve
from lemma.motion.outcome import Outcome, SkillResult
from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.viewer.episode.status import Line
from lemma.viewer.recording.track import (
    BY_HAND,
    EXPERT,
    SOLVED,
    Frames,
    Track,
    keep_frames,
    unsolved,
)
from lemma.viz.recording import describe_subtask


@dataclass(frozen=True)
class Replayed:
    """An episode of a result, done again from its line."""

    track: Track
    differs: str
    """Where it first differs from the line, in a sentence; ``""`` if nowhere."""
    state_hash: str
    """Of its last state."""
    turn: EpisodeSnapshot
    """The episode before the sub-task that decided it, see :func:`turn_of`."""
    turn_s: float
    """When that was [s]."""
    kept: int
    """How many sub-tasks came before."""


def replay_record(record: EpisodeRecord) -> Track:
    """Execute what an episode of a recipe executed."""
    instance = Instance.from_dict(record.instance_data())
    episode = Episode(instance)
    taker = keep_frames(episode.simulation)
    play_steps(episode, [step.grounded for step in record.subtasks])
    lines = [
        _line(step.instruction, step.start_s, done.result)
        for step, done in zip(record.subtasks, episode.executed, strict=False)
    ]
    episode.stop()
    return _track(EXPERT, episode, taker.frames, lines)


def replay_teleoperation(done: Teleoperation) -> tuple[Track, bool]:
    """Do what a policy and somebody's hand did.

    Returns:
        It, and whether it came to the same, to the bit.

    Raises:
        LemmaError: It cannot be done.
    """
    episode = Episode(done.instance)
    taker = keep_frames(episode.simulation)
    perform(done, episode)
    starts = [part.start_s for part in done.parts]
    lines = []
    for part, next_s in zip(done.parts, [*starts[1:], done.end_s], strict=True):
        if isinstance(part, Commanded):
            line = Line(LED, part.start_s, next_s, "by hand")
        else:
            words = describe_subtask(part.subtask, done.instance)
            cut = part.until_s is not None
            line = Line(words, part.start_s, next_s, "taken over" if cut else "")
        lines.append(line)
    for nudged in done.nudged:
        words = f"The {entity_named(nudged.name).phrase} was moved"
        lines.append(Line(words, nudged.time_s, nudged.time_s, "by hand"))
    lines.sort(key=lambda line: line.start_s)
    solved = episode.is_success
    verdict = SOLVED if solved else unsolved(episode.failure)
    track = Track(BY_HAND, done.instance, taker.frames, tuple(lines), verdict, solved)
    return track, is_same(done, episode)


def turn_of(case: Case) -> int:
    """Return before which sub-task the expert takes over, from 0.

    At the mistake; where none was one, but there was work left, at the end, and where
    the time was over, at the beginning.
    """
    if case.mistake is not None:
        return case.mistake
    late = case.cause in (None, Cause.OUT_OF_TIME)
    return 0 if late else len(case.row["subtasks"])


def replay_line(case: Case) -> Replayed:
    """Execute what a line of a result says was executed.

    Args:
        case: An episode that can be repeated.
    """
    row, turn = case.row, turn_of(case)
    episodes: list[Episode] = []
    takers: list[FrameTaker] = []
    turns: list[tuple[EpisodeSnapshot, float]] = []

    def watch(episode: Episode, number: int) -> None:
        if not episodes:
            episodes.append(episode)
            takers.append(keep_frames(episode.simulation))
        if number == turn:
            # Where the policy stopped, the expert does not.
            now = replace(episode.snapshot(), stopped=False, ended_s=None, verdict=None)
            turns.append((now, episode.simulation.time_s))

    again = play_again(row, case.instance, case.about, watch, strictly=True)
    differs = next(differences(row, again, strictly=True), "")
    lines = tuple(
        Line(
            subtask_words(case, step),
            step["start_s"],
            step["start_s"] + step["duration_s"],
            step["outcome"],
            step["explanation"],
            step["outcome"] == Outcome.SUCCESS,
        )
        for step in row["subtasks"]
    )
    verdict = explanation(case) or SOLVED
    track = Track(
        case.policy, case.instance, takers[0].frames, lines, verdict, row["success"]
    )
    state_hash = episodes[0].simulation.scene.state_hash()
    return Replayed(track, differs, state_hash, *turns[0], turn)


def expert_instead(case: Case, again: Replayed) -> Track:
    """Let the expert go on from where an episode went wrong.

    Args:
        case: The episode.
        again: The same, done again.
    """
    episode = Episode(case.instance, horizon_s=case.about["horizon_s"])
    episode.restore(again.turn)
    kept = [frame for frame in again.track.frames if frame[0] <= again.turn_s]
    taker = keep_frames(episode.simulation, kept)
    expert = Expert(episode.simulation.scene, case.instance.goal)
    lines = [*again.track.lines[: again.kept]]
    for step in solve(episode, expert):
        lines.append(_expert_line(step, case.instance))
    title = f"{EXPERT}, from sub-task {again.kept + 1} on" if again.kept else EXPERT
    track = _track(title, episode, taker.frames, lines)
    if len(lines) == again.kept and not track.solved:
        return replace(track, verdict="The expert knows no way from there.")
    return track


def _expert_line(step: ExpertStep, instance: Instance) -> Line:
    return _line(describe_subtask(step.subtask, instance), step.start_s, step.result)


def _line(words: str, start_s: float, result: SkillResult) -> Line:
    return Line(
        words,
        start_s,
        start_s + result.duration_s,
        str(result.outcome),
        result.explanation,
        result.ok,
    )


def _track(title: str, episode: Episode, frames: Frames, lines: list[Line]) -> Track:
    done = episode.is_success
    verdict = SOLVED if done else unsolved(episode.failure)
    return Track(title, episode.instance, frames, tuple(lines), verdict, done)
