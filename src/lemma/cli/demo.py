"""`lemma demo`: the expert or another policy at work, one instance per task."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.text import Text

from lemma.cli.options import Flag, JsonFlag, TaskNames, messages, output, print_json
from lemma.cli.selection import DEFAULT, SelectionOptions, select_instance
from lemma.core.errors import InvalidConfigError
from lemma.core.tables import Table
from lemma.evaluation.run.rollout import Player
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.tasks.instance import Instance
from lemma.tasks.suite import SUITE
from lemma.viewer.episode.reading import hear
from lemma.viewer.episode.status import say_goal
from lemma.viz.pages.demo import illustrate_all, write_page
from lemma.viz.recording import (
    Line,
    Recording,
    main_sentence,
    record,
    record_together,
    robot_titles,
)
from lemma.viz.video import VideoStyle

_OUT = Path("out/demo")
_REPLAYS = "replays"
_FINER = 4
_WHO = "The policy at work"
_SUMMARY = (
    *("task", "instruction", "team", "success"),
    *("steps", "sim s", "wall s", "× real"),
)


def demo(
    tasks: TaskNames = (),
    which: SelectionOptions = DEFAULT,
    policy: Annotated[str, tyro.conf.arg(metavar="POLICY")] = ORACLE,
    say: Annotated[
        str | None, tyro.conf.arg(metavar="TEXT", help_behavior_hint="")
    ] = None,
    acting: Literal["turns", "together"] = "turns",
    out: Path = _OUT,
    no_video: Flag = False,
    as_json: JsonFlag = False,
) -> int:
    """Let a policy solve one instance of each task; write videos and a page.

    Args:
        tasks: Tasks to solve; all eight by default, unless a file is named.
        which: Selection of the instance.
        policy: oracle: the expert; a model; PLANNER+GROUNDER; or package.module:Class.
        say: Your own sentence, for one task.
        acting: turns: one robot at a time; together: all at once, only the expert.
        out: Folder for the videos and index.html.
        no_video: Only solve; write no files.
        as_json: Print a JSON list instead of a table.

    Returns:
        Exit code: 1 if the policy failed at any task.
    """
    names: tuple[str | None, ...] = tuple(dict.fromkeys(tasks)) or SUITE
    if which.instance is not None and not tasks:
        names = (None,)
    if say is not None and len(names) != 1:
        raise InvalidConfigError("--say needs exactly one task.")
    if acting == "together" and policy != ORACLE:
        raise InvalidConfigError(
            f"--acting together needs the expert, --policy {ORACLE}; other policies "
            "take turns here."
        )
    instances = [_choose(name, which, acting) for name in names]
    if not no_video:
        out.mkdir(parents=True, exist_ok=True)
    console = messages() if as_json else output()
    with console.status("Preparing (the first run compiles, for half a minute) ..."):
        record(instances[0], horizon_s=2.0)
        loaded = Player.load(PolicySpec(policy))
    player = None if acting == "together" else loaded
    if say is not None:
        instances = [_listen(console, say, instances[0], loaded, policy)]
    page = None if no_video else out / "index.html"
    if page is None:
        recordings = [_solve(console, instance, player, None) for instance in instances]
    else:
        recordings = _solve_and_film(console, instances, player, page)
    console.print()
    console.print(summary(recordings).terminal())
    if page:
        words = f"Videos and a page to look at them: {page}"
        console.print(words, markup=False, soft_wrap=True)
    if as_json:
        print_json([recording.to_dict() for recording in recordings])
    return 0 if all(recording.success for recording in recordings) else 1


def _choose(task: str | None, which: SelectionOptions, acting: str) -> Instance:
    """Return the instance of a task.

    Raises:
        InvalidConfigError: Its goal cannot be reached as robots shall act.
    """
    instance = select_instance(task, which)
    if acting == "turns":
        instance.goal.check_in_turns()
    return instance


def _listen(
    console: Console, say: str, instance: Instance, player: Player, policy: str
) -> Instance:
    """Return an instance with another sentence, and print the sentence's goal.

    Raises:
        InvalidConfigError: The policy did not understand the sentence.
    """
    said, reading = hear(say, instance, player, knows=policy == ORACLE)
    if not reading.pairs or not reading.acts:
        raise InvalidConfigError(f"“{say}”: {reading.note}")
    console.print(Text(f"Understood: {say_goal(reading.pairs)}"))
    return said


def _solve_and_film(
    console: Console, instances: list[Instance], player: Player | None, page: Path
) -> list[Recording]:
    """Solve all instances, then render, so that rendering does not distort times."""
    style = VideoStyle()
    # Replays can be played slowly, so they need more states than a video.
    frame_s = style.frame_s / _FINER
    recordings = [_solve(console, instance, player, frame_s) for instance in instances]
    words = f"\nRendering {len(recordings)} videos in {page.parent} ..."
    console.print(words, markup=False, soft_wrap=True)
    try:
        illustrations = illustrate_all(
            [recording.thinned(_FINER) for recording in recordings],
            page.parent,
            style,
            on_video=lambda path: console.print(f"  {path.name}", markup=False),
        )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"Interrupted: the listed videos are in {page.parent}; the page is not "
            "written."
        ) from None
    replays = _replay_all(console, recordings, page.parent)
    write_page(page, recordings, illustrations, style.speed, replays)
    return recordings


def _replay_all(
    console: Console, recordings: list[Recording], folder: Path
) -> dict[str, str]:
    """Write an interactive replay of each; return the file names, by task."""
    if not (find_spec("viser") and find_spec("trimesh")):
        console.print("No replays: they need the extra play.")
        return {}
    from lemma.viewer.replays import write_recording

    replays = {}
    for done in recordings:
        task = done.instance.task
        replays[task] = f"{_REPLAYS}/{task}.html"
        write_recording(folder / replays[task], done)
        console.print(f"  {replays[task]}", markup=False)
    return replays


def _solve(
    console: Console, instance: Instance, player: Player | None, frame_s: float | None
) -> Recording:
    """Play an instance with a policy, and report its sub-tasks.

    Without a policy, the expert acts with all robots at the same time.
    """
    instruction = main_sentence(instance)
    line = Text.assemble(
        (f"\n{instance.task}", "bold"), "  ", (f"“{instruction}”", "italic")
    )
    console.print(line)
    robots = robot_titles(instance)

    def report(line: Line) -> None:
        _report(console, line, robots)

    if player is None:
        return record_together(instance, frame_s=frame_s, on_step=report)
    return record(instance, player, title=_WHO, frame_s=frame_s, on_step=report)


def _report(console: Console, line: Line, robots: Mapping[str, str]) -> None:
    subtask = line.subtask
    assert subtask is not None
    what = f"{subtask.pick} → {subtask.place}"
    text = Text("  ")
    text.append(f"{robots[subtask.robot]:<17}", style="cyan")
    text.append(f"{subtask.primitive:<8}{what:<25}")
    text.append(f" {line.outcome:<10}", style="green" if line.ok else "bold red")
    text.append(f"{line.duration_s:6.1f} s")
    if not line.ok:
        text.append(f"  {line.explanation}", style="red")
    console.print(text, soft_wrap=True)


def summary(recordings: list[Recording]) -> Table:
    """Return the final table with the result of every task."""
    rows = tuple(
        (
            *(done.instance.task, main_sentence(done.instance), done.instance.team),
            "yes" if done.success else f"no: {done.failure}",
            *(f"{len(done.lines)}", f"{done.elapsed_s:.1f}", f"{done.wall_s:.2f}"),
            f"{done.realtime_factor:.0f}",
        )
        for done in recordings
    )
    return Table(_SUMMARY, rows, labels=4)
