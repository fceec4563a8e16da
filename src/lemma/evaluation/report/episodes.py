"""Episodes of a report, with explanations of their failures."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

from lemma.evaluation.analysis.failure_causes import Cause, cause_of, mistake_of
from lemma.evaluation.analysis.result import counts, lines_of
from lemma.evaluation.lines import lines_in, read_lines
from lemma.evaluation.records import PROTECTIVE_STOP, Deviation, Row
from lemma.evaluation.report.policy_results import PolicyResults
from lemma.evaluation.run.evaluate import start_of
from lemma.motion.outcome import REFUSED, Outcome
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.bank import robot_phrases, sub_instruction
from lemma.tasks.subtask import Primitive


@dataclass(frozen=True)
class Case:
    """One episode of one policy."""

    policy: str
    """The policy's title in tables, and its training seed if there are several."""
    row: Row
    about: Mapping[str, Any]
    """Settings of its result."""
    lines: Path
    """The file of its line."""

    @property
    def name(self) -> str:
        """Kind, task and index of the episode: ``"high_level/stack/12"``."""
        row = self.row
        return f"{row['instruction_kind']}/{row['task']}/{row['index']}"

    @cached_property
    def cause(self) -> Cause | None:
        """Why it failed; None if it succeeded."""
        return cause_of(self.row)

    @cached_property
    def mistake(self) -> int | None:
        """Index of the first mistake among the sub-tasks; None without one."""
        failed = self.cause not in (None, Cause.POLICY_ERROR)
        return mistake_of(self.row) if failed else None

    @cached_property
    def instance(self) -> Instance:
        """The instance of this installation."""
        return start_of(self.row, self.about)

    @property
    def is_repeatable(self) -> bool:
        """Whether its line has all decisions, and its instance is known.

        Lines of episodes at control level lack the motor commands.
        """
        return self.is_known and "control" not in self.row

    @property
    def is_known(self) -> bool:
        """Whether this installation has the episode's instance."""
        return bool(self.about["benchmark"] == BENCHMARK_VERSION)


def cases_of(
    entries: Iterable[PolicyResults], paths: Iterable[Path]
) -> tuple[list[Case], list[Path]]:
    """Return the episodes of results whose lines are available.

    Lines belong to a result if they have its digest, in any folder.

    Args:
        entries: The results.
        paths: Files and folders of the report.

    Returns:
        The episodes, and the files of lines that belong to no result.
    """
    files = {file.resolve(): file for path in paths for file in lines_in(path)}
    found = {file: read_lines(file) for file in files.values()}
    cases: list[Case] = []
    for entry in entries:
        for result in entry.results:
            several = len(entry.results) > 1
            name = f"{entry.title}{f', seed {result.seed}' * several}"
            for file, lines in found.items():
                rows = lines_of(result, lines)
                if counts(result, rows):
                    cases += [Case(name, row, result.about, file) for row in rows]
                    break
    counted = {case.lines for case in cases}
    return cases, [file for file in found if file not in counted]


def spread(cases: Iterable[Case], most: int) -> list[Case]:
    """Return some failed episodes, of as many causes and tasks as possible.

    Args:
        cases: Episodes of one policy.
        most: Largest number of episodes.
    """
    groups: dict[tuple[Cause | None, str], list[Case]] = {}
    for case in cases:
        if case.cause is not None:
            groups.setdefault((case.cause, case.row["task"]), []).append(case)
    turns = chain.from_iterable(zip_longest(*groups.values()))
    return [case for case in turns if case is not None][:most]


def subtask_words(case: Case, subtask: Mapping[str, str]) -> str:
    """Return a sub-task as text: ``"red robot: move the blue cube ..."``."""
    if subtask["primitive"] == Primitive.STOP:
        return "stop"
    robot = subtask["robot"]
    if case.is_known:
        scene = case.instance.scene
        phrases = robot_phrases(scene.robots)
        robot = dict(zip(scene.robot_names, phrases, strict=True)).get(robot, robot)
    pick, place = subtask["pick"], subtask["place"]
    if not (pick and place):
        # Decisions of end-to-end models name no objects.
        return f"{robot}: {subtask['primitive']}"
    return sub_instruction(robot, subtask["primitive"], pick, place)


def explanation(case: Case) -> str:
    """Return an explanation of a failure, one or two sentences; ``""`` for success."""
    cause, row = case.cause, case.row
    if cause is None:
        return ""
    if cause is Cause.POLICY_ERROR:
        error = row.get("policy_error") or {}
        return f"The policy itself failed. {error.get('explanation', '')}".strip()
    if case.mistake is None:
        return _without_mistake(cause, row)
    step = row["subtasks"][case.mistake]
    number = case.mistake + 1
    return f"{_of_mistake(case, cause, step, number)} {_of_stop(row)}".strip()


def _of_stop(row: Row) -> str:
    """Return a sentence about the protective stop, if any, and the lenient success."""
    if row["failure"] != PROTECTIVE_STOP:
        return ""
    last, later = row["subtasks"][-1], row["lenient"]
    solved = later is not None and later["success"]
    note = " Told of it, the policy solved it all the same." if solved else ""
    return f"Protective stop: {last['explanation']}{note}"


def _of_mistake(case: Case, cause: Cause, step: Mapping[str, Any], number: int) -> str:
    if cause not in _MISTAKES:
        sentences = (f"Sub-task {number} is the expert's.", *_of_poses(cause, step))
        return " ".join(sentences)
    expected = step["expert"]["expected"]
    words = _MISTAKES[cause]
    if cause is Cause.WRONG_PRIMITIVE and expected["primitive"] == Primitive.STOP:
        words = "goes on where the goal held"
    return (
        f"Sub-task {number} {words}. The expert would go on with "
        f"“{subtask_words(case, expected)}”."
    )


_MISTAKES = {
    Cause.WRONG_ROBOT: "is given to the wrong robot",
    Cause.WRONG_ORDER: "comes too soon",
    Cause.WRONG_PRIMITIVE: "has the wrong primitive",
    Cause.WRONG_OBJECT: "is about the wrong object or place",
}


def _without_mistake(cause: Cause, row: Row) -> str:
    if cause is Cause.OUT_OF_TIME:
        return "No sub-task was a mistake; the time was over."
    if cause is Cause.STOPPED_EARLY:
        return "No sub-task was a mistake, but the policy stopped with work left."
    return "Nothing was left to do, but the goal did not hold at rest."


def _of_poses(cause: Cause, step: Mapping[str, Any]) -> Iterator[str]:
    """Yield sentences about the errors of poses and motion in the right sub-task."""
    for end, found in (("pick", Cause.MISSED_PICK), ("place", Cause.MISSED_PLACE)):
        if cause is found:
            error_mm = step["expert"][f"{end}_error_mm"]
            if step["grounded"] is None:
                yield "No pose was found for it."
            elif error_mm is not None:
                yield f"Its {end} is {error_mm:.0f} mm off the middle."
            else:
                yield f"Its {end} is not good enough."
    if cause is Cause.OUT_OF_TIME:
        yield "The time was over during it."
    if cause is Cause.FELL:
        yield f"In it the {' and the '.join(step['fell'])} fell off the table."
    if cause is Cause.EXECUTION:
        yield "Its poses are good, but the motion failed."
    if step["outcome"] not in (Outcome.SUCCESS, *REFUSED):
        yield step["explanation"]


DEVIATION_WORDS = {
    Deviation.ROBOT: "wrong robot",
    Deviation.ORDER: "too soon",
    Deviation.PRIMITIVE: "wrong primitive",
    Deviation.OBJECT: "wrong object",
}
"""Words for a sub-task that deviates from the expert's."""
