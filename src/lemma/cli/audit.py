"""`lemma audit`: one robot alone attacks instances, in physics."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lemma.cli.options import (
    ALL,
    Folder,
    JsonFlag,
    Listed,
    Number,
    SuiteName,
    messages,
    print_json,
    print_table,
    task_names,
    words,
)
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar

if TYPE_CHECKING:
    from lemma.audit.run import Found
    from lemma.viz.video import VideoStyle

_AT_INTERRUPT = "{done} of {total} instances were attacked; nothing is saved."


def audit(
    tasks: Listed = ALL,
    suite: SuiteName = "lemma",
    split: str = "test",
    episodes: Number = None,
    start: int = 0,
    level: Literal["skill", "control", "both"] = "both",
    attacks: Listed = ALL,
    working: WorkerOptions = DEFAULT,
    videos: Folder = None,
    as_json: JsonFlag = False,
) -> int:
    """Attack instances with one robot alone, in physics.

    Prints the outcome, time and limits of each attack. Exits with 1 if an attack
    succeeds.

    Args:
        tasks: Names of tasks, separated by commas.
        suite: Suite whose tasks are attacked unless --tasks names some.
        split: Frozen list; or free, which samples instances and needs --episodes.
        episodes: Number of instances of every task; the whole list by default.
        start: Index of the first instance.
        level: Attacks with grounded sub-tasks, with motor commands, or both.
        attacks: Names of attacks, separated by commas.
        working: Worker processes.
        videos: Folder for a video of every success.
        as_json: Print one JSON object instead of a table.
    """
    # Import late, so that help is fast.
    from lemma.audit.run import audit as run
    from lemma.audit.run import budgets, tally

    names = _attacks(attacks, level)
    keys = _keys(task_names(tasks, suite), split, start, episodes)
    if videos is not None:
        # Fail before the work if the folder cannot be made.
        videos.mkdir(parents=True, exist_ok=True)
    with progress_bar("audit", len(keys), _AT_INTERRUPT) as advance:
        found = run(keys, names, working.make_engine(), advance)
    won = [one for one in found if one.succeeded]
    if as_json:
        print_json({"attacks": tally(found), "budgets": budgets(names)})
    else:
        _print(tally(found))
        _print_budgets(budgets(names))
    _tell(keys, found)
    if videos is not None:
        write_videos(won, videos)
    return 1 if won else 0


def _tell(keys: Sequence[tuple[str, str, int]], found: Sequence["Found"]) -> None:
    """Report successes, unstable simulations, and tasks that were not attacked."""
    for one in (one for one in found if one.succeeded):
        messages().print(
            f"{one.task}/{one.split}/{one.index}: {one.attack} by {one.robot}, "
            f"attempt {one.attempt + 1}"
        )
    for one in found:
        if one.unstable:
            messages().print(
                f"{one.task}/{one.split}/{one.index}: {one.attack} made the physics "
                f"unstable in {one.unstable} attempts, which count as failures"
            )
    attacked = {one.task for one in found}
    for task in dict.fromkeys(task for task, _, _ in keys if task not in attacked):
        messages().print(f"{task}: not attacked, since one robot may do it alone")


def _attacks(listed: str, level: str) -> tuple[str, ...]:
    """Return the names of the wanted attacks.

    Raises:
        UnknownNameError: No such attack.
        InvalidConfigError: An attack is of the other level.
    """
    from lemma.audit.attack import ATTACKS
    from lemma.audit.run import names_at
    from lemma.core.errors import InvalidConfigError

    at_level = names_at(level)
    names = words(listed, every=at_level)
    for name in names:
        if ATTACKS[name].name not in at_level:
            raise InvalidConfigError(
                f"The attack {name} is at {ATTACKS[name].level} level. Leave out "
                f"--level {level}, or name others."
            )
    return names


def _keys(
    tasks: Sequence[str], split: str, first: int, count: int | None
) -> list[tuple[str, str, int]]:
    """Return task, split and index of the wanted instances.

    Raises:
        UnknownNameError: No such task or split.
        InvalidConfigError: The split has fewer instances.
    """
    from lemma.core.errors import InvalidConfigError
    from lemma.tasks.instance import splits_of
    from lemma.tasks.suite import check_split

    for task in tasks:
        check_split(task, split)
    size = min((splits_of(task).get(split, 0) for task in tasks), default=0) or None
    if count is None and size is None:
        raise InvalidConfigError(
            "The split free needs --episodes, because it has any number of instances."
        )
    end = first + count if count is not None else size or 0
    if not 0 <= first < end or (size is not None and end > size):
        has = "from 0 on" if size is None else f"0 to {size - 1}"
        raise InvalidConfigError(
            f"--start {first} and --episodes {ALL if count is None else count} do not "
            f"fit the split {split}, which has instances {has}."
        )
    return [(task, split, index) for task in tasks for index in range(first, end)]


def _print(tallies: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Print sums by task and attack; successful attacks are bold."""
    tasks = dict.fromkeys(task for of_tasks in tallies.values() for task in of_tasks)
    sums = [
        {"task": task, "attack": attack, **tallies[attack][task]}
        for task in tasks
        for attack in tallies
    ]
    # These columns fit into a terminal of 80 characters.
    forms = {
        **{"task": "{}", "attack": "{}", "tried": "{}", "executed": "{}"},
        **{"succeeded": "{}", "best_progress": "{:.0%}", "seconds": "{:.1f}"},
    }
    header = ("task", "attack", "tried", "executed", "succeeded", "progress", "seconds")
    rows = [tuple(form.format(of[name]) for name, form in forms.items()) for of in sums]
    won = [number for number, of in enumerate(sums) if of["succeeded"]]
    print_table(header, rows, labels=2, bold=won)


def _print_budgets(of_attacks: dict[str, dict[str, Any]]) -> None:
    """Print the limits of each attack on one instance."""
    header = ("attack", "level", "attempts", "candidates", "simulated s")
    rows = [(name, *budget.values()) for name, budget in of_attacks.items()]
    title = "Limits: attempts per robot; candidates and simulated time per attempt"
    print_table(header, rows, title=title, labels=2)


def write_videos(
    won: "list[Found]", folder: Path, style: "VideoStyle | None" = None
) -> None:
    """Write a video of every success, ``TASK-SPLIT-INDEX-ATTACK.mp4``."""
    from lemma.tasks.suite import load_instance
    from lemma.viz.replay import replay_attack
    from lemma.viz.video import VideoStyle, write_video

    style = style or VideoStyle()
    for one in won:
        instance = load_instance(one.task, one.split, one.index)
        recording = replay_attack(one, instance, style.frame_s)
        path = folder / f"{one.task}-{one.split}-{one.index}-{one.attack}.mp4"
        write_video(recording, path, style)
        messages().print(f"wrote {path}")
