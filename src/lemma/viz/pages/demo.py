"""The page of `lemma demo`: one HTML file with videos and maps of its recordings."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lemma.core.engine import mujoco
from lemma.core.files import write_text
from lemma.core.version import VERSION as __version__
from lemma.core.workers.pool import ProcessPool, numbered
from lemma.scene.scene import Scene
from lemma.tasks.suite import TASKS
from lemma.viz.gantt import gantt_of
from lemma.viz.map_overlay import annotated_map, camera_images
from lemma.viz.pages.templates import fill, jpeg
from lemma.viz.recording import Recording, main_sentence, pose, robot_titles
from lemma.viz.video import VideoStyle, write_video

_MAP_PX = 728


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
        speed: Speed of the videos, as a multiple of real time.
        replays: File names of interactive replays in the same folder, by task.
    """
    solved = sum(recording.success for recording in recordings)
    simulated = sum(recording.elapsed_s for recording in recordings)
    wall = sum(recording.wall_s for recording in recordings)
    page = fill(
        "demo.html",
        title="LEMMA Bench: a demonstration",
        lead=f"{solved} of {len(recordings)} instances were solved: {simulated:.0f} "
        f"simulated seconds in {wall:.1f} s, {simulated / wall:.0f} times real time.",
        recordings=recordings,
        illustrations=illustrations,
        sentence_of=main_sentence,
        titles_of=robot_titles,
        gantt_of=gantt_of,
        tasks=TASKS,
        speed=speed,
        replays=replays or {},
        footer=f"Written by lemma {__version__} with MuJoCo {mujoco.__version__}.",
    )
    write_text(path, page)


def illustrate_all(
    recordings: Sequence[Recording],
    folder: Path,
    style: VideoStyle,
    on_video: Callable[[Path], None],
) -> list[Illustration]:
    """Render every recording, one process per core.

    Args:
        recordings: Recordings with frames.
        folder: Folder for the videos.
        style: Size and pace of the videos.
        on_video: Called with every video as soon as it is written.

    Returns:
        The pictures, in the order of the recordings.
    """
    # Begin with the longest, so that no core waits for it at the end.
    order = sorted(range(len(recordings)), key=lambda i: -recordings[i].elapsed_s)
    jobs = [(i, illustrate, (recordings[i], folder, style)) for i in order]
    done: dict[int, Illustration] = {}
    for number, illustration in ProcessPool().run(numbered, jobs):
        done[number] = illustration
        on_video(illustration.video)
    return [done[number] for number in range(len(recordings))]


def illustrate(recording: Recording, folder: Path, style: VideoStyle) -> Illustration:
    """Write the video of a recording; return it with poster and map.

    Args:
        recording: A recording with frames.
        folder: Folder for the video.
        style: Size and pace of the video.
    """
    video = folder / f"{recording.instance.task}.mp4"
    last = write_video(recording, video, style)
    scene = Scene(recording.instance.scene)
    pose(scene, recording.frames[0][1])
    top = annotated_map(recording.instance, scene, camera_images(scene), _MAP_PX)
    return Illustration(video, jpeg(last), jpeg(top))
