"""Tracks as a page that plays them, and as files of its player."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from lemma.core.files import write_whole
from lemma.viewer.episode.status import Line
from lemma.viewer.recording.serializer import client_page, serialize
from lemma.viewer.recording.track import EXPERT, Track, track_of
from lemma.viz.pages.replays import Replay, Side, Told, write_replays
from lemma.viz.recording import Recording, main_sentence

VISER = ".viser"
"""End of the names of files of the player."""
PAGE = "index.html"


def replay_of(
    name: str,
    title: str,
    tracks: Sequence[Track],
    *,
    sentence: str | None = None,
    opens_s: float = 0.0,
    note: str = "",
) -> Replay:
    """Return what a page needs of an episode, or of two side by side.

    Args:
        name: Its address within the page.
        title: What it is called.
        tracks: From left to right.
        sentence: What was said; that of the instance if None.
        opens_s: Simulated time that is looked at first [s].
        note: What else there is to say.
    """
    if sentence is None:
        sentence = main_sentence(tracks[0].instance)
    return Replay(
        name, title, sentence, serialize(tracks), [*map(_side, tracks)], opens_s, note
    )


def write_folder(folder: Path, replays: Sequence[Replay]) -> Path:
    """Write a page that needs nothing else, and its recordings as files beside it.

    Args:
        folder: Where; made if it is missing.
        replays: What can be looked at.

    Returns:
        The page.

    Raises:
        DatasetError: It cannot be written there.
    """
    for replay in replays:
        write = partial(_write, replay.recording)
        write_whole(folder / f"{replay.name}{VISER}", write)
    write_replays(folder / PAGE, replays, client_page())
    return folder / PAGE


def write_recording(path: Path, recording: Recording, who: str = EXPERT) -> None:
    """Write a page that plays a recording; its player lies beside it, for others too.

    Args:
        path: The HTML file.
        recording: With frames.
        who: Who acts, in words.

    Raises:
        DatasetError: It cannot be written there.
    """
    instance = recording.instance
    found = replay_of(instance.task, instance.key, [track_of(recording, who)])
    write_replays(path, [found], client_page(), shared=True)


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def _side(track: Track) -> Side:
    steps = [_told(line, track.end_s) for line in track.lines]
    return Side(track.title, steps, track.verdict, track.solved)


def _told(line: Line, end_s: float) -> Told:
    ends_s = end_s if line.end_s is None else line.end_s
    took = f"{ends_s - line.start_s:.1f} s"
    why = line.explanation or line.outcome.replace("_", " ")
    return Told(line.words, line.start_s, ends_s, took if line.ok else why, line.ok)
