"""Measure the speed of rendering episodes, with each renderer and at three sizes.

    python scripts/measure_filming.py --workers 16

Worker processes run the stages of an export at the same time: execute an episode again,
render its states, and encode a video of each camera. Each stage is timed separately.
"""

import argparse
import io
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import av
import numpy as np
from numpy.typing import NDArray

from lemma.bench.machine import describe_machine
from lemma.core.workers.pool import ProcessPool
from lemma.core.workers.resources import usable_cores
from lemma.dataset.lerobot.frames import Style, robots_of
from lemma.dataset.recipe.record import record_episode
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.steps import iterate_steps
from lemma.scene.rendering.batch import choose_renderer, states_at_once
from lemma.tasks.instance import Instance
from lemma.tasks.suite import SUITE, load_instance

SIZES = ((128, 128), (224, 224), (640, 480))
"""Width and height of the images [px]."""
ALL_IMAGES = 3_000_000
"""Approximate number of images of all 6,400 episodes at 10 Hz, of two cameras."""
_LEAST_S = 3.0


@dataclass(frozen=True, slots=True)
class FilmingFigures:
    """Speed of one renderer at one size."""

    renderer: str
    drawn_by: str
    """The software and the device of the rendering."""
    width: int
    height: int
    workers: int
    replay_ms: float
    """Time to execute an episode again, per state; a state has two images [ms]."""
    render_ms: float
    """Time to render color without depth, per image [ms]."""
    encode_ms: float
    """Time to encode H.264, per image [ms]."""
    images_per_s: float
    """Rendered and encoded images of all workers per second [1/s]."""
    all_minutes: float
    """Time for :data:`ALL_IMAGES` at this rate [min]."""

    def to_dict(self) -> dict[str, object]:
        """Return plain data, ready for JSON."""
        return {
            name: round(value, 3) if isinstance(value, float) else value
            for name, value in asdict(self).items()
        }


@dataclass(slots=True)
class _Times:
    """Times of one worker for each stage [s]."""

    drawn_by: str = ""
    states: int = 0
    images: int = 0
    replay_s: float = 0.0
    render_s: float = 0.0
    encode_s: float = 0.0

    @property
    def total_s(self) -> float:
        return self.replay_s + self.render_s + self.encode_s


def measure_filming(
    instances: Sequence[Instance],
    workers: int,
    sizes: Sequence[tuple[int, int]] = SIZES,
    least_s: float = _LEAST_S,
) -> list[FilmingFigures]:
    """Measure OpenGL and the chosen renderer.

    Args:
        instances: Instances, which the expert solves first.
        workers: Number of processes.
        sizes: Width and height of the images [px].
        least_s: Shortest duration of each worker's measurement [s].

    Raises:
        RenderingError: No renderer works here.
    """
    records = [record_episode(instance) for instance in instances]
    found = []
    for renderer in dict.fromkeys(("opengl", choose_renderer("auto"))):
        for width, height in sizes:
            how = Style(
                width_px=width,
                height_px=height,
                depth=False,
                cameras=robots_of(records[0]),
                renderer=renderer,
            )
            jobs = [(records[n % len(records) :], how, least_s) for n in range(workers)]
            times = list(ProcessPool(workers).run(time_filming, jobs))
            found.append(_figures(how, times))
    return found


def _figures(how: Style, times: Sequence[_Times]) -> FilmingFigures:
    images = sum(one.images for one in times)
    rate = sum(one.images / one.total_s for one in times)
    states = sum(one.states for one in times)
    return FilmingFigures(
        renderer=how.renderer,
        drawn_by=times[0].drawn_by,
        width=how.width_px,
        height=how.height_px,
        workers=len(times),
        replay_ms=1000.0 * sum(one.replay_s for one in times) / states,
        render_ms=1000.0 * sum(one.render_s for one in times) / images,
        encode_ms=1000.0 * sum(one.encode_s for one in times) / images,
        images_per_s=rate,
        all_minutes=ALL_IMAGES / rate / 60.0,
    )


def time_filming(
    records: Sequence[EpisodeRecord], how: Style, least_s: float
) -> _Times:
    """Render episodes in a loop for some time.

    Args:
        records: The episodes.
        how: Options of the rendering.
        least_s: Shortest duration [s].
    """
    rig = how.rig()
    times = _Times(drawn_by=rig.describe())
    # A warm-up, to exclude compilation and start-up.
    _film_once(records[0], how, _Times())
    number = 0
    while times.total_s < least_s:
        _film_once(records[number % len(records)], how, times)
        number += 1
    return times


def _film_once(record: EpisodeRecord, how: Style, times: _Times) -> None:
    """Render an episode, and add the time of each stage."""
    cameras = how.cameras_of(robots_of(record))
    rig = how.rig()
    start = time.perf_counter()
    states, scene = [], None
    for step in iterate_steps(record, how.fps):
        scene = step.scene
        states.append(scene.data.qpos.copy())
    assert scene is not None
    times.replay_s += time.perf_counter() - start
    times.states += len(states)
    together = states_at_once(how.width_px, how.height_px, len(cameras))
    for first in range(0, len(states), together):
        start = time.perf_counter()
        chunk = np.array(states[first : first + together])
        rgb = rig.film(scene, chunk, cameras, depth=how.depth).rgb
        middle = time.perf_counter()
        for camera in range(len(cameras)):
            encode(rgb[:, camera], how.fps)
        times.encode_s += time.perf_counter() - middle
        times.render_s += middle - start
        times.images += rgb.shape[0] * rgb.shape[1]


def encode(frames: NDArray[np.uint8], hz: int) -> bytes:
    """Return a video, encoded by one thread, as in exports.

    Args:
        frames: Color, (frames, height, width, 3) uint8, with even height and width.
        hz: Frames per second.
    """
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=hz)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": "veryfast", "crf": "27", "bf": "0", "g": "5"}
        stream.codec_context.thread_count = 1
        for frame in frames:
            image = av.VideoFrame.from_ndarray(frame, format="rgb24")
            container.mux(stream.encode(image))
        container.mux(stream.encode())
    return file.getvalue()


def main() -> None:
    """Print the figures, one JSON object per line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=usable_cores())
    workers = parser.parse_args().workers
    print(json.dumps(describe_machine()))
    instances = [load_instance(task, "test", 0) for task in SUITE]
    for figures in measure_filming(instances, workers):
        print(json.dumps(figures.to_dict()))


if __name__ == "__main__":
    main()
