"""Pages with episodes to turn around: one HTML file, opened from the disk as it is.

Browsers let a page from the disk read no other files but scripts. Recordings therefore
lie in the page itself, and the player in it or, where many pages share it, in a script.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lemma.core.files import write_text
from lemma.core.version import VERSION as __version__
from lemma.viz.pages.templates import fill, script_text
from lemma.viz.recording import Line, Recording

PLAYER = "player.js"
"""Name of the script that pages of one folder share."""


@dataclass(frozen=True, slots=True)
class Replay:
    """One episode, or two side by side."""

    name: str
    """Of letters, digits, dashes and underscores; follows ``#`` in the address."""
    title: str
    sentence: str
    """The instruction."""
    content: bytes
    """Content of a ``.viser`` file."""
    sides: Sequence[Recording]
    """The episodes, from left to right."""
    opens_s: float = 0.0
    """Simulated time that is shown first [s]."""
    note: str = ""
    """A remark below the sentence; empty for none."""


def write_replays(
    path: Path, replays: Sequence[Replay], player: str, *, shared: bool = False
) -> None:
    """Write a page.

    Args:
        path: The HTML file.
        replays: The episodes.
        player: HTML of the player.
        shared: Whether the player goes into a script beside the page, for others of
            its folder.

    Raises:
        DatasetError: It cannot be written there.
    """
    if shared:
        beside, script = path.parent / PLAYER, player_script(player)
        if not beside.exists() or beside.read_text("utf-8") != script:
            write_text(beside, script)
    write_text(path, replays_page(replays, None if shared else player))


def player_script(player: str) -> str:
    """Return the script :data:`PLAYER` with the HTML of a player."""
    return f"const PLAYER = {script_text(player)};\n"


def replays_page(replays: Sequence[Replay], player: str | None) -> str:
    """Return a page.

    Args:
        replays: The episodes.
        player: HTML of the player; None if it is in the script beside the page.
    """
    return fill(
        "replays.html",
        title=replays[0].title if len(replays) == 1 else "LEMMA Bench: replays",
        replays=replays,
        told=[_data(replay) for replay in replays],
        player="" if player is None else script_text(player),
        beside=PLAYER,
        encode=lambda content: base64.b64encode(content).decode(),
        footer=f"Written by lemma {__version__}. It needs no network.",
    )


def _data(replay: Replay) -> dict[str, Any]:
    """Return the data of the page's script, ready for JSON."""
    return {
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
                "steps": [_step(line, side.end_s) for line in side.lines],
            }
            for side in replay.sides
        ],
    }


def _step(line: Line, end_s: float) -> dict[str, Any]:
    ends_s = end_s if line.end_s is None else line.end_s
    took = f"{ends_s - line.start_s:.1f} s"
    why = line.explanation or line.outcome.replace("_", " ")
    return {
        "words": line.words,
        "start": round(line.start_s, 3),
        "end": round(ends_s, 3),
        "outcome": took if line.ok else why,
        "ok": line.ok,
    }
