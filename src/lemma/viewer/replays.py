"""Interactive 3D replays of episodes: pages that need no server.

Browsers let a page from the disk load scripts but no other files. A page therefore
contains its recordings. It also contains the player, or shares it with other pages as a
script.
"""

import base64
import contextlib
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import viser

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import write_text, write_whole
from lemma.core.version import VERSION as __version__
from lemma.core.workers.pool import Engine, numbered
from lemma.dataset.recipe.files import Recipe, load
from lemma.dataset.teleoperation import Teleoperation, is_teleoperated
from lemma.evaluation.report.episodes import Case, cases_of
from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.scene.scene import Scene
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.viewer.scene.bodies import Bodies, light_room, name_bodies
from lemma.viewer.scene.viewpoint import Viewpoint, half_height_for
from lemma.viewer.server import close_server, open_server
from lemma.viz.gantt import gantt_of
from lemma.viz.pages.templates import fill, macro, script_text
from lemma.viz.recording import (
    FRAME_S,
    Line,
    Recording,
    judged,
    main_sentence,
    reached_words,
    trained_words,
)
from lemma.viz.replay import (
    expert_instead,
    replay_line,
    replay_record,
    replay_teleoperation,
)

VISER = ".viser"
"""Ending of recordings for viser's player."""
PAGE = "index.html"
PLAYER = "player.js"
"""Name of the script with the player, which pages of a folder share."""
LAST_S = 1.5
"""Time for which the player shows the end before it begins again [s]."""
_ASPECTS = 1.6, 2.1
"""Aspect ratios of windows with one table and with two."""
_APART_M = 2.0 * TABLE_HALF_X_M + 0.2
_BESIDE_M = 0.9
_TITLE_M = (0.0, TABLE_HALF_Y_M, 0.0)
_HOST = "127.0.0.1"
_CLIENT = "client/build/index.html"


@dataclass(frozen=True, slots=True)
class Replay:
    """One episode, or two side by side."""

    name: str
    """Letters, digits, dashes and underscores; follows ``#`` in the address."""
    title: str
    sentence: str
    """The instruction."""
    sides: Sequence[Recording]
    """The episodes, from left to right."""
    content: bytes
    """Content of a ``.viser`` file, from :func:`serialize`."""
    opens_s: float = 0.0
    """Simulated time at which the player begins [s]."""
    note: str = ""
    """A remark below the sentence; empty without one."""


def replays_in(
    folder: Path, task: str | None, split: str | None, limit: int
) -> tuple[int, Iterator[Replay]]:
    """Find episodes, and play them again.

    Args:
        folder: A recipe, a result of ``lemma evaluate``, or the file of an episode
            with teleoperation.
        task: Only episodes of this task; None for all.
        split: Only episodes of this split; None for all.
        limit: Largest number of episodes.

    Returns:
        Number of episodes, and an iterator that plays each again when it is reached.

    Raises:
        InvalidConfigError: There are no such episodes.
        DatasetError: The folder has none of these contents, or they are damaged.
    """
    found: Sequence[Callable[[], Replay]]
    if is_teleoperated(folder):
        found = [partial(_of_teleoperation, Teleoperation.load(folder), folder.stem)]
    elif any(folder.glob("*/*.parquet")):
        recipe = load(folder).select(task=task, split=split)[:limit]
        found = [partial(_of_record, recipe, number) for number in range(len(recipe))]
    else:
        cases = [
            case
            for case in cases_in(folder)
            if case.is_repeatable
            and task in (None, case.row["task"])
            and split in (None, case.row["split"])
        ]
        found = [partial(replay_of_case, case) for case in cases[:limit]]
    if not found:
        raise InvalidConfigError(
            f"{folder} has no episodes of task {task or 'any'} and split "
            f"{split or 'any'} that can be played again."
        )
    return len(found), (make() for make in found)


def cases_in(folder: Path) -> list[Case]:
    """Return the episodes of results, failed ones first.

    Raises:
        DatasetError: There are no results, or they are damaged.
    """
    results = read_results([folder])
    if not results:
        raise DatasetError(
            f"There is neither a recipe nor a result in {folder}. Name the output of "
            "'lemma generate' or 'lemma evaluate'."
        )
    cases, _ = cases_of(entries_of(results, complete=False), [folder])
    return sorted(cases, key=lambda case: case.cause is None)


def replay_of_case(case: Case, other: Case | None = None) -> Replay:
    """Return an episode of a result beside another.

    Args:
        case: The episode.
        other: The other one; if None, the expert's continuation from the mistake.

    Raises:
        LemmaError: It cannot be played again.
    """
    again = replay_line(case)
    sides, differs = [again.recording], [again.differs]
    if other is not None:
        beside = replay_line(other)
        sides.append(beside.recording)
        differs.append(beside.differs)
    elif case.cause is not None:
        sides.append(expert_instead(case, again))
    row = case.row
    notes = [f"It went differently here. {text}" for text in differs if text]
    return Replay(
        f"{row['instruction_kind']}-{row['task']}-{row['index']}",
        f"{row['task']} {row['index']}, {case.policy}",
        row["instruction"],
        sides,
        serialize(sides),
        0.0 if case.cause is None else again.turn_s,
        " ".join([*notes, trained_words(case.about["weights"])]).strip(),
    )


def _of_teleoperation(done: Teleoperation, name: str) -> Replay:
    recording, same = replay_teleoperation(done)
    note = "" if same else "It went differently here."
    title = f"{done.instance.task} {done.instance.index}, by hand"
    content = serialize([recording])
    return Replay(name, title, done.instruction, [recording], content, note=note)


def _of_record(recipe: Recipe, number: int) -> Replay:
    record = recipe[number]
    name = f"{record.task}-{record.split}-{record.index}"
    title = f"{record.task} {record.index} ({record.split})"
    return _of_recording(name, title, replay_record(record))


def _of_recording(name: str, title: str, recording: Recording) -> Replay:
    sentence, content = main_sentence(recording.instance), serialize([recording])
    return Replay(name, title, sentence, [recording], content)


def write_folder(folder: Path, replays: Sequence[Replay]) -> Path:
    """Write a self-contained page, and its recordings as further files.

    Args:
        folder: The folder; made if it is missing.
        replays: The episodes.

    Returns:
        Path of the page.

    Raises:
        DatasetError: The files cannot be written.
    """
    for replay in replays:
        path, write = folder / f"{replay.name}{VISER}", partial(_write, replay.content)
        write_whole(path, write)
    write_text(folder / PAGE, replays_page(replays, client_page()))
    return folder / PAGE


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def write_cases(
    cases: Sequence[tuple[int, Case]],
    folder: Path,
    engine: Engine,
    advance: Callable[[int], None],
) -> dict[int, str]:
    """Write a page for each episode; all share one player.

    Args:
        cases: Number and episode of each.
        folder: The folder; made if it is missing.
        engine: Workers that run the jobs.
        advance: Called with the number of newly finished episodes.

    Returns:
        File names in the folder, by number of the episode.
    """
    jobs = [(number, replay_of_case, (case,)) for number, case in cases]
    written = {}
    for number, replay in engine.run(numbered, jobs):
        written[number] = f"{number}-{replay.name}.html"
        _write_shared(folder / written[number], replay)
        advance(1)
    return written


def write_recording(path: Path, recording: Recording) -> None:
    """Write a page that plays a recording, and the shared player in the same folder.

    Args:
        path: The HTML file.
        recording: A recording with frames.

    Raises:
        DatasetError: The files cannot be written.
    """
    instance = recording.instance
    _write_shared(path, _of_recording(instance.task, instance.key, recording))


def _write_shared(path: Path, replay: Replay) -> None:
    """Write a page that uses the shared player."""
    beside, script = path.parent / PLAYER, player_script()
    if not beside.exists() or beside.read_text("utf-8") != script:
        write_text(beside, script)
    write_text(path, replays_page([replay], None))


def player_script() -> str:
    """Return the content of the script :data:`PLAYER`."""
    return f"const PLAYER = {script_text(client_page())};\n"


def client_page() -> str:
    """Return the player, a self-contained HTML file."""
    page = (Path(viser.__file__).parent / _CLIENT).read_text("utf-8")
    return page.replace("</head>", f"{macro('panel.html', 'notice')}</head>", 1)


def replays_page(replays: Sequence[Replay], player: str | None) -> str:
    """Return the HTML of a page.

    Args:
        replays: The episodes.
        player: HTML of the player; None to load it from :data:`PLAYER`.
    """
    episodes = [
        {
            "name": replay.name,
            "title": replay.title,
            "sentence": replay.sentence,
            "opens": replay.opens_s,
            "note": replay.note,
            "sides": [
                {
                    "title": side.title,
                    "verdict": side.verdict,
                    "solved": side.success,
                    "reached": _reached(side),
                    "gantt": gantt_of(side),
                    "steps": [_step(line, side.frames[-1][0]) for line in side.lines],
                }
                for side in replay.sides
            ],
        }
        for replay in replays
    ]
    return fill(
        "replays.html",
        title=replays[0].title if len(replays) == 1 else "LEMMA Bench: replays",
        replays=replays,
        episodes=episodes,
        player="" if player is None else script_text(player),
        beside=PLAYER,
        encode=lambda content: base64.b64encode(content).decode(),
        footer=f"Written by lemma {__version__}. It needs no network.",
    )


def _reached(side: Recording) -> str:
    """Return progress and verdicts of an episode, as one line."""
    if not side.stages:
        return ""
    verdicts = (f"{name}: {found}" for name, found in judged(side.stages).items())
    return f"{reached_words(side.stages)}. {', '.join(verdicts).capitalize()}."


def _step(line: Line, last_s: float) -> dict[str, Any]:
    end_s = last_s if line.end_s is None else line.end_s
    why = line.explanation or line.outcome.replace("_", " ")
    return {
        "words": line.words,
        "start": round(line.start_s, 3),
        "end": round(end_s, 3),
        "outcome": f"{end_s - line.start_s:.1f} s" if line.ok else why,
        "ok": line.ok,
    }


def serialize(sides: Sequence[Recording]) -> bytes:
    """Return recordings side by side, as the content of a ``.viser`` file.

    Args:
        sides: The episode on each table, from left to right.
    """
    first_m, tables = -0.5 * _APART_M * (len(sides) - 1), []
    bases = [abs(r.base.x) for side in sides for r in side.instance.scene.robots]
    with _hidden_server() as server:
        server.scene.reset()
        light_room(server)
        for number, side in enumerate(sides):
            root, at_m = f"/table_{number}", (first_m + number * _APART_M, 0.0, 0.0)
            bodies = Bodies(server, Scene(side.instance.scene), root, at_m, number > 0)
            name_bodies(server, side.instance, root)
            if len(sides) > 1:
                server.scene.add_label(f"{root}/title", side.title, position=_TITLE_M)
            tables.append((bodies, side))

        def show(time_s: float) -> None:
            with server.atomic():
                for bodies, side in tables:
                    bodies.show(side.at(time_s))

        show(0.0)
        Viewpoint(
            server,
            max(bases) + _BESIDE_M - first_m,
            _ASPECTS[len(sides) > 1],
            half_height_for(*(side.instance for side in sides)),
        )
        serializer = server.get_scene_serializer()
        before_s = 0.0
        for time_s in sorted({time_s for side in sides for time_s, _ in side.frames}):
            # Times of two episodes may differ by an invisible amount.
            if time_s - before_s > 0.5 * FRAME_S:
                serializer.insert_sleep(time_s - before_s)
                before_s = time_s
                show(time_s)
        serializer.insert_sleep(LAST_S)
        return serializer.serialize()


@contextlib.contextmanager
def _hidden_server() -> Iterator[viser.ViserServer]:
    """Run a hidden server: only a server can serialize a scene."""
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        port = probe.getsockname()[1]
    server = open_server(_HOST, port)
    try:
        yield server
    finally:
        close_server(server)
