"""Pictures for recordings, rendered by several processes at once."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from lemma.core.parallel import usable_cores
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.viz.map_overlay import annotated_map
from lemma.viz.pages.demo import Illustration, jpeg
from lemma.viz.recording import Recording
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
        recordings: What to show, with frames.
        folder: Where the videos go; made if need be.
        style: Size and pace of the videos.
        on_video: Told of every video as soon as it is there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The longest first, so that no core waits for it at the end.
    order = sorted(recordings, key=lambda recording: -recording.elapsed_s)
    with ProcessPoolExecutor(
        max(1, min(usable_cores(), len(order))),
        # OpenGL does not survive a fork.
        mp_context=get_context("spawn"),
        initializer=draw_in_one_thread,
    ) as pool:
        futures = {
            recording.instance.key: pool.submit(illustrate, recording, folder, style)
            for recording in order
        }
        try:
            for done in as_completed(futures.values()):
                on_video(done.result().video)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [futures[recording.instance.key].result() for recording in recordings]


def draw_in_one_thread() -> None:
    """Keep Mesa from starting as many threads as there are cores, in each process."""
    os.environ.setdefault("LP_NUM_THREADS", "0")


def illustrate(recording: Recording, folder: Path, style: VideoStyle) -> Illustration:
    """Write the video of a recording; return it with poster and map.

    Args:
        recording: What to show, with frames.
        folder: Where the video goes.
        style: Size and pace of the video.
    """
    video = folder / f"{recording.instance.task}.mp4"
    last = write_video(recording, video, style)
    scene = Scene(recording.instance.scene)
    scene.restore(recording.frames[0][1])
    renderer = Renderer()
    images = [
        renderer.rgbd(scene.model, scene.data, f"{name}/camera")
        for name in recording.instance.scene.robot_names
    ]
    top = annotated_map(recording.instance, scene, images, _MAP_PX)
    return Illustration(video, jpeg(last), jpeg(top))
