"""The page of `lemma demo`: one HTML file with everything in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lemma.core.engine import mujoco
from lemma.core.version import VERSION as __version__
from lemma.tasks.suite import task_named
from lemma.viz.pages.templates import fill
from lemma.viz.recording import Recording, main_sentence, robot_titles


@dataclass(frozen=True, slots=True)
class Illustration:
    """Pictures of one recording."""

    video: Path
    """The MP4 file."""
    poster: bytes
    """The last picture of the video, JPEG."""
    map: bytes
    """The annotated map of the first state, JPEG."""


def write_page(
    path: Path,
    recordings: Sequence[Recording],
    illustrations: Sequence[Illustration],
    speed: int,
    replays: Mapping[str, str] | None = None,
) -> None:
    """Write the page.

    Args:
        path: The HTML file.
        recordings: The episodes.
        illustrations: Their pictures, in the same order.
        speed: How much faster than real time the videos are.
        replays: Pages beside this one to turn episodes around, by task.
    """
    solved = sum(recording.success for recording in recordings)
    simulated = sum(recording.elapsed_s for recording in recordings)
    wall = sum(recording.wall_s for recording in recordings)
    page = fill(
        "demo.html",
        title="LEMMA Bench: a demonstration",
        lead=f"{solved} of {len(recordings)} instances were solved: {simulated:.0f} "
        f"simulated seconds in {wall:.1f} s, {simulated / wall:.0f} times real time.",
        cards=list(map(_card, recordings, illustrations)),
        speed=speed,
        replays=replays or {},
        footer=f"Written by lemma {__version__} with MuJoCo {mujoco.__version__}.",
    )
    path.write_text(page, encoding="utf-8")


def _card(recording: Recording, illustration: Illustration) -> dict[str, object]:
    """Return the texts and files of a recording for the page."""
    scene = recording.instance.scene
    titles = robot_titles(recording.instance)
    return {
        "recording": recording,
        "sentence": main_sentence(recording.instance),
        "summary": task_named(recording.instance.task).summary,
        "lanes": [
            {"robot": name, "title": title, "color": robot.color}
            for name, title, robot in zip(
                scene.robot_names, titles, scene.robots, strict=True
            )
        ],
        "video": illustration.video.read_bytes(),
        "poster": illustration.poster,
        "map": illustration.map,
    }
