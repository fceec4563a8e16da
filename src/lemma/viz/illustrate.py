"""Pictures for recordings, rendered by several processes at once."""

from collections.abc import Callable, Sequence
from pathlib import Path

from lemma.core.workers.pool import ProcessPool
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.viz.map_overlay import annotated_map
from lemma.viz.pages.demo import Illustration
from lemma.viz.pages.templates import jpeg
from lemma.viz.recording import Recording, pose
from lemma.viz.video import VideoStyle, write_video

_MAP_PX = 728


def illustrate_all(
    recordings: Sequence[Recording],
    folder: Path,
    style: VideoStyle,
    on_video: Callable[[Path], None],
) -> list[Illustration]:
    """Render every recording, one process per core.

    Args:
        recordings: With frames.
        folder: Where the videos go; made if need be.
        style: Size and pace of the videos.
        on_video: Called with every video as soon as it is written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The longest first, so that no core waits for it at the end.
    order = sorted(recordings, key=lambda recording: -recording.elapsed_s)
    jobs = [(recording, folder, style) for recording in order]
    done: dict[str, Illustration] = {}
    for key, illustration in ProcessPool().run(_illustrate_one, jobs):
        done[key] = illustration
        on_video(illustration.video)
    return [done[recording.instance.key] for recording in recordings]


def _illustrate_one(
    recording: Recording, folder: Path, style: VideoStyle
) -> tuple[str, Illustration]:
    return recording.instance.key, illustrate(recording, folder, style)


def illustrate(recording: Recording, folder: Path, style: VideoStyle) -> Illustration:
    """Write the video of a recording; return it with poster and map.

    Args:
        recording: With frames.
        folder: Where the video goes.
        style: Size and pace of the video.
    """
    video = folder / f"{recording.instance.task}.mp4"
    last = write_video(recording, video, style)
    scene = Scene(recording.instance.scene)
    pose(scene, recording.frames[0][1])
    renderer = Renderer()
    images = [
        renderer.rgbd(scene.model, scene.data, f"{name}/camera")
        for name in recording.instance.scene.robot_names
    ]
    top = annotated_map(recording.instance, scene, images, _MAP_PX)
    return Illustration(video, jpeg(last), jpeg(top))
