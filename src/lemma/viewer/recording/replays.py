"""Episodes played again to the bit, and what the expert would have done in them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lemma.dataset.playback import FrameTaker, play_steps
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.teleoperation import LED, Commanded, Teleoperation, is_same, perform
from lemma.env.episode import Episode, EpisodeSnapshot
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.report.episodes import Case, explanation
from lemma.evaluation.run.replay import differences, play_again
from lemma.expert.expert import Expert, solve
from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.viz.recording import (
    FRAME_S,
    Line,
    Recording,
    describe_subtask,
    line_of,
    lines_of_case,
)

EXPERT = "The expert"
BY_HAND = "By hand"


@dataclass(frozen=True)
class Replayed:
    """An episode of a result, played again from its line."""

    recording: Recording
    differs: str
    """Its first difference from the line, in a sentence; ``""`` if there is none."""
    state_hash: str
    """Of its last state."""
    turn: EpisodeSnapshot
    """The episode before the sub-task that decided it, see :func:`turn_of`."""
    turn_s: float
    """Simulated time of that [s]."""
    kept: int
    """Number of sub-tasks before."""


def replay_record(record: EpisodeRecord) -> Recording:
    """Execute the sub-tasks of an episode of a recipe."""
    episode = Episode(Instance.from_dict(record.instance_data()))
    taker = FrameTaker(episode.simulation, FRAME_S)
    play_steps(episode, [step.grounded for step in record.subtasks])
    lines = [
        line_of(step.instruction, step.start_s, done.result)
        for step, done in zip(record.subtasks, episode.executed, strict=False)
    ]
    episode.stop()
    return _recording(EXPERT, episode, taker, lines)


def replay_teleoperation(done: Teleoperation) -> tuple[Recording, bool]:
    """Repeat an episode that a policy and a visitor played.

    Returns:
        The episode, and whether it came to the same state, to the bit.

    Raises:
        LemmaError: It cannot be repeated.
    """
    episode = Episode(done.instance)
    taker = FrameTaker(episode.simulation, FRAME_S)
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
    return _recording(BY_HAND, episode, taker, lines), is_same(done, episode)


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
    """Execute the sub-tasks of a line of a result.

    Args:
        case: An episode that can be repeated.
    """
    row, turn = case.row, turn_of(case)
    watched: list[tuple[Episode, FrameTaker]] = []
    turns: list[tuple[EpisodeSnapshot, float]] = []

    def watch(episode: Episode, number: int) -> None:
        if not watched:
            watched.append((episode, FrameTaker(episode.simulation, FRAME_S)))
        if number == turn:
            # The expert goes on even where the policy stopped.
            now = replace(episode.snapshot(), stopped=False, ended_s=None, verdict=None)
            turns.append((now, episode.simulation.time_s))

    again = play_again(row, case.instance, case.about, watch, strictly=True)
    differs = next(differences(row, again, strictly=True), "")
    ((episode, taker),) = watched
    recording = Recording(
        case.policy,
        case.instance,
        lines_of_case(case),
        taker.frames,
        row["success"],
        row["failure"],
        row["elapsed_s"],
        because=explanation(case),
    )
    state_hash = episode.simulation.scene.state_hash()
    return Replayed(recording, differs, state_hash, *turns[0], turn)


def expert_instead(case: Case, again: Replayed) -> Recording:
    """Let the expert go on from where an episode went wrong.

    Args:
        case: The episode.
        again: The same, played again.
    """
    episode = Episode(case.instance, horizon_s=case.about["horizon_s"])
    episode.restore(again.turn)
    kept = [frame for frame in again.recording.frames if frame[0] <= again.turn_s]
    taker = FrameTaker(episode.simulation, FRAME_S, kept)
    expert = Expert(episode.simulation.scene, case.instance.goal)
    lines = [*again.recording.lines[: again.kept]]
    for step in solve(episode, expert):
        words = describe_subtask(step.subtask, case.instance)
        lines.append(line_of(words, step.start_s, step.result, step.subtask))
    title = f"{EXPERT}, from sub-task {again.kept + 1} on" if again.kept else EXPERT
    found = _recording(title, episode, taker, lines)
    if len(lines) == again.kept and not found.success:
        return replace(found, because="The expert knows no way from there.")
    return found


def _recording(
    title: str, episode: Episode, taker: FrameTaker, lines: Sequence[Line]
) -> Recording:
    return Recording(
        title,
        episode.instance,
        tuple(lines),
        taker.frames,
        episode.is_success,
        episode.failure,
        episode.elapsed_s,
    )
