"""`lemma audit`: one robot alone attacks instances, in physics."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from lemma.cli.options import (
    Folder,
    JsonFlag,
    Number,
    messages,
    output,
    print_json,
    words,
)
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar

if TYPE_CHECKING:
    from lemma.audit.run import Found, Tally
    from lemma.viz.video import VideoStyle

_ALL = "all"
_AT_INTERRUPT = "{done} of {total} instances were done; nothing is kept."


@dataclass(frozen=True, slots=True)
class AuditOptions:
    """Instances and attacks."""

    tasks: Annotated[str, tyro.conf.arg(metavar="TASK,...")] = _ALL
    """Names of tasks, separated by commas."""
    split: str = "test"
    """Frozen list of instances; or free, which samples them and needs --episodes."""
    episodes: Number = None
    """Number of instances of every task; the whole list by default."""
    start: int = 0
    """Index of the first instance."""
    level: Literal["skill", "control", "both"] = "both"
    """Attacks with grounded sub-tasks, with motor commands, or both."""
    attacks: Annotated[str, tyro.conf.arg(metavar="ATTACK,...")] = _ALL
    """Names of attacks, separated by commas."""


_EVERYTHING = AuditOptions()


def audit(
    wanted: Annotated[AuditOptions, tyro.conf.arg(name="")] = _EVERYTHING,
    working: WorkerOptions = DEFAULT,
    videos: Folder = None,
    as_json: JsonFlag = False,
) -> int:
    """Attack instances with one robot alone, in physics.

    Exits with 1 if an attack succeeds.

    Args:
        wanted: Instances and attacks.
        working: Worker processes.
        videos: Folder for a video of every success.
        as_json: Print one JSON object instead of a table.
    """
    # Imported here so that help does not wait for it.
    from lemma.audit.run import audit as run
    from lemma.audit.run import tally, to_dict

    names = _attacks(wanted)
    keys = _keys(wanted)
    if videos is not None:
        # A folder that cannot be made is better refused before the work than after.
        videos.mkdir(parents=True, exist_ok=True)
    with progress_bar("audit", len(keys), _AT_INTERRUPT) as advance:
        found = run(keys, names, working.make_engine(), advance)
    won = [one for one in found if one.succeeded]
    if as_json:
        print_json(to_dict(tally(found)))
    else:
        output().print(table(tally(found)))
    for one in won:
        messages().print(
            f"{one.task}/{one.split}/{one.index}: {one.attack} by {one.robot}, "
            f"attempt {one.attempt + 1}"
        )
    for one in found:
        if one.unstable:
            messages().print(
                f"{one.task}/{one.split}/{one.index}: {one.attack} made the physics "
                f"unstable in {one.unstable} attempts, which count as failed"
            )
    if videos is not None:
        write_videos(won, videos)
    return 1 if won else 0


def _attacks(wanted: AuditOptions) -> tuple[str, ...]:
    from lemma.audit.attack import ATTACKS
    from lemma.audit.run import names_at
    from lemma.core.errors import InvalidConfigError

    at_level = names_at(wanted.level)
    if wanted.attacks == _ALL:
        return at_level
    names = words(wanted.attacks)
    for name in names:
        if ATTACKS[name].name not in at_level:
            raise InvalidConfigError(
                f"The attack {name} is at {ATTACKS[name].level} level. Leave out "
                f"--level {wanted.level}, or name others."
            )
    return names


def _keys(wanted: AuditOptions) -> list[tuple[str, str, int]]:
    """Return task, split and index of the wanted instances.

    Raises:
        UnknownNameError: No such task or split.
        InvalidConfigError: There are not so many.
    """
    from lemma.core.errors import InvalidConfigError
    from lemma.tasks.instance import SPLITS
    from lemma.tasks.suite import SUITE, check_split

    tasks = SUITE if wanted.tasks == _ALL else words(wanted.tasks)
    for task in tasks:
        check_split(task, wanted.split)
    size, first, count = SPLITS.get(wanted.split), wanted.start, wanted.episodes
    if count is None and size is None:
        raise InvalidConfigError(
            "The split free needs --episodes, because it has any number of instances."
        )
    end = first + count if count is not None else size or 0
    if not 0 <= first < end or (size is not None and end > size):
        has = "from 0 on" if size is None else f"0 to {size - 1}"
        raise InvalidConfigError(
            f"--start {first} and --episodes {_ALL if count is None else count} do not "
            f"fit the split {wanted.split}, which has instances {has}."
        )
    return [
        (task, wanted.split, index) for task in tasks for index in range(first, end)
    ]


def table(tallies: "dict[str, dict[str, Tally]]") -> Table:
    """Return sums as a table, by task and attack."""
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("task", "attack", "level"):
        shown.add_column(heading, no_wrap=True)
    for heading in ("tried", "executed", "succeeded", "best progress"):
        shown.add_column(heading, justify="right")
    tasks = dict.fromkeys(task for of_tasks in tallies.values() for task in of_tasks)
    for task in tasks:
        for attack, of_tasks in tallies.items():
            sums = of_tasks[task]
            style = "bold red" if sums.succeeded else None
            shown.add_row(
                *(task, attack, sums.level, str(sums.tried), str(sums.executed)),
                *(str(sums.succeeded), f"{sums.best_progress:.0%}"),
                style=style,
            )
        shown.add_section()
    return shown


def write_videos(
    won: "list[Found]", folder: Path, style: "VideoStyle | None" = None
) -> None:
    """Write a video of every success, ``TASK-SPLIT-INDEX-ATTACK.mp4``."""
    from lemma.tasks.suite import load_instance
    from lemma.viz.attack_video import replay_attack
    from lemma.viz.video import VideoStyle, write_video

    style = style or VideoStyle()
    for one in won:
        instance = load_instance(one.task, one.split, one.index)
        recording = replay_attack(one, instance, style.frame_s)
        path = folder / f"{one.task}-{one.split}-{one.index}-{one.attack}.mp4"
        write_video(recording, path, style)
        messages().print(f"wrote {path}")
