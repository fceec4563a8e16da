"""Bit-exact replays of episodes, and the expert's solutions of failed ones."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from lemma.audit.attack import ATTACKS
from lemma.audit.control_trial import control_config
from lemma.audit.run import Found
from lemma.core.errors import InvalidConfigError
from lemma.dataset.playback import MotorCommands, Step, play_steps
from lemma.dataset.recipe.replay import play_record
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.teleoperation import LED, Commanded, Teleoperation, is_same, perform
from lemma.env.episode import Episode, EpisodeSnapshot
from lemma.evaluation.analysis.failure_causes import Cause
from lemma.evaluation.report.episodes import Case, explanation, subtask_words
from lemma.evaluation.run.replay import Watcher, differences, play_again
from lemma.expert.expert import ExpertStep, solve
from lemma.expert.together import solve_together
from lemma.motion.outcome import Outcome
from lemma.scene.build import TICK_S
from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import Primitive, SubTask
from lemma.viz.recording import (
    FRAME_S,
    Line,
    Recorder,
    Recording,
    describe_step,
    describe_subtask,
    line_of,
    name_region,
    robot_titles,
)

EXPERT = "The expert"
BY_HAND = "By hand"


@dataclass(frozen=True)
class Replayed:
    """An episode of a result, played again from its line."""

    recording: Recording
    differs: str
    """Its first difference from the line, as a sentence; ``""`` if there is none."""
    turn: EpisodeSnapshot
    """The episode before its decisive sub-task, see :func:`turn_of`."""
    turn_s: float
    """Simulated time of :attr:`turn` [s]."""


def replay_attack(found: Found, instance: Instance, frame_s: float) -> Recording:
    """Play an attack again.

    Args:
        found: The attack's record; it must have succeeded.
        instance: The attacked instance.
        frame_s: Simulated time from one frame to the next [s].

    Raises:
        InvalidConfigError: The attack did not succeed, so its actions were not kept.
    """
    if not found.succeeded:
        raise InvalidConfigError(
            f"The attack {found.attack} on {instance.key} did not succeed, so there is "
            "nothing to replay."
        )
    episode = Episode(instance)
    recorder = Recorder(episode, frame_s)
    commands, names = found.commands, [str(step.primitive) for step in found.subtasks]
    steps: list[Step] = [*found.subtasks]
    if commands is not None:
        config, names = control_config(instance.task), ["motor commands"]
        steps = [MotorCommands(config.control, config.control_hz, list(commands))]
    times: list[float] = []
    play_steps(
        episode,
        steps,
        lambda number: times.append(episode.elapsed_s),
        lingers=commands is None,
    )
    if commands is None and not episode.is_over:
        episode.stop()
    title = robot_titles(instance)[found.robot]
    summary = ATTACKS[found.attack].summary
    for name, span_s in zip(names, pairwise(times), strict=True):
        words = f"{title} alone, {name}. {summary}"
        recorder.add(Line(words, *span_s, Outcome.SUCCESS))
    done = recorder.recording(found.attack)
    failure = None if done.success else "goal_not_reached"
    return replace(done, failure=failure, elapsed_s=episode.simulation.time_s)


def replay_record(record: EpisodeRecord) -> Recording:
    """Execute the sub-tasks of an episode of a recipe."""
    episode = Episode(Instance.from_dict(record.instance_data()))
    recorder = Recorder(episode)
    play_record(episode, record)
    # Robots that act together end in another order than they begin.
    executed = {(each.grounded.robot, each.start_s): each for each in episode.executed}
    for step in record.subtasks:
        if (done := executed.get((step.robot, step.start_s))) is None:
            continue
        names = step.robot, Primitive(step.primitive), step.pick, step.place
        line = line_of(step.instruction, step.start_s, done.result, SubTask(*names))
        recorder.add(line)
    episode.stop()
    return recorder.recording(EXPERT)


def replay_teleoperation(done: Teleoperation) -> tuple[Recording, bool]:
    """Repeat an episode that a policy and a visitor played.

    Returns:
        The episode, and whether it came to the same state, to the bit.

    Raises:
        LemmaError: It cannot be repeated.
    """
    episode = Episode(done.instance)
    recorder = Recorder(episode)
    perform(done, episode)
    ends_s = [*(part.start_s for part in done.parts[1:]), done.end_s]
    for part, end_s in zip(done.parts, ends_s, strict=True):
        line = Line(LED, part.start_s, end_s, "by hand")
        if not isinstance(part, Commanded):
            words = describe_subtask(part.subtask, done.instance)
            outcome = "" if part.until_s is None else "taken over"
            line = replace(line, words=words, outcome=outcome, subtask=part.subtask)
        recorder.add(line, end_s)
    for nudged in done.nudged:
        words = f"The {entity_named(nudged.name).phrase} was moved"
        recorder.add(Line(words, nudged.time_s, nudged.time_s, "by hand"))
    recorder.lines.sort(key=lambda line: line.start_s)
    return recorder.recording(BY_HAND), is_same(done, episode)


def turn_of(case: Case) -> int:
    """Return the index of the sub-task before which the expert takes over.

    This is the first mistake. Without a mistake it is the end of the episode if the
    policy stopped early, and 0 if time ran out.
    """
    if case.mistake is not None:
        return case.mistake
    late = case.cause in (None, Cause.OUT_OF_TIME)
    return 0 if late else len(case.row["subtasks"])


def replay_line(
    case: Case,
    watch: Watcher = lambda episode, number: None,
    frame_s: float = FRAME_S,
) -> Replayed:
    """Execute the sub-tasks of a line of a result.

    Args:
        case: An episode that can be repeated.
        watch: Called with the episode and the index of the sub-task before each
            sub-task, and once more at the end.
        frame_s: Simulated time from one frame to the next [s].
    """
    row, turn = case.row, turn_of(case)
    recorders: list[Recorder] = []
    turns: list[tuple[EpisodeSnapshot, float]] = []

    def look(episode: Episode, number: int) -> None:
        if not recorders:
            recorders.append(Recorder(episode, frame_s))
        # A replay that differs may end before the turn.
        if number <= turn or not turns:
            # The expert also continues after the policy's `stop`.
            now = replace(episode.snapshot(), stopped=False, ended_s=None, verdict=None)
            turns.append((now, episode.simulation.time_s))
        watch(episode, number)

    again = play_again(row, case.instance, case.about, look, strictly=True)
    for step in row["subtasks"]:
        line = Line(
            name_region(subtask_words(case, step), step["place"], case.instance),
            float(step["start_s"]),
            float(step["start_s"] + step["duration_s"]),
            step["outcome"],
            step["explanation"],
            step["outcome"] == Outcome.SUCCESS,
            SubTask.from_dict(dict(step)),
        )
        recorders[0].add(line, row["elapsed_s"])
    recording = replace(
        recorders[0].recording(case.policy),
        success=row["success"],
        failure=row["failure"],
        elapsed_s=row["elapsed_s"],
        because=explanation(case),
        stages=row["stages"],
    )
    differs = next(differences(row, again, strictly=True), "")
    return Replayed(recording, differs, *turns[-1])


def expert_instead(case: Case, again: Replayed) -> Recording:
    """Let the expert continue from an episode's decisive sub-task.

    If robots acted at the same time, running sub-tasks are finished first; then the
    expert acts with all robots.

    Args:
        case: The episode.
        again: Its replay.
    """
    episode = Episode(case.instance, horizon_s=case.about["horizon_s"])
    episode.restore(again.turn)
    before = [frame for frame in again.recording.frames if frame[0] <= again.turn_s]
    recorder, kept = Recorder(episode, FRAME_S, before), turn_of(case)
    lines = recorder.lines
    lines += again.recording.lines[:kept]
    steps: Iterable[ExpertStep]
    if case.row.get("together") is None:
        steps = solve(episode)
    else:
        begun = again.recording.lines[kept:]
        for line in _finish(episode, begun):
            recorder.add(line, again.turn_s)
        steps = solve_together(episode)
    for step in steps:
        recorder.add(describe_step(step, case.instance))
    title = f"{EXPERT}, from sub-task {kept + 1} on" if kept else EXPERT
    found = recorder.recording(title)
    if len(lines) == kept and not found.success:
        return replace(found, because="The expert finds no plan from there.")
    return found


def _finish(episode: Episode, begun: Sequence[Line]) -> Iterator[Line]:
    """Finish all running sub-tasks, and yield their lines.

    Args:
        episode: The episode; it advances until no sub-task runs.
        begun: Lines of the same sub-tasks in the original episode.
    """
    while episode.simulation.busy:
        for done in episode.advance():
            robot, start_s = done.grounded.robot, done.start_s
            for line in begun:
                mine = line.subtask is not None and line.subtask.robot == robot
                # Times in lines are rounded to milliseconds.
                if mine and abs(line.start_s - start_s) < TICK_S:
                    yield line_of(line.words, start_s, done.result, line.subtask)
