"""Render the images of the README and of the documentation.

    .venv/bin/python scripts/make_pictures.py docs/images [NAME ...]

Each image shows the expert during a frozen test instance; the README's is an animation
of four arms.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.suite import load_instance
from lemma.viz.camera_fit import outline, overview
from lemma.viz.recording import pose, record, record_together
from lemma.viz.video import caption


@dataclass(frozen=True)
class Moment:
    """A time in an episode of the expert, with camera and size of its image."""

    task: str
    index: int
    """Instance of the test split."""
    step: int
    """Index of the running sub-task."""
    share: float
    """Completed share of it, in [0, 1]."""
    azimuth_deg: float = 84.0
    elevation_deg: float = -30.0
    size: tuple[int, int] = (640, 340)
    """Of the picture without its caption [px]."""
    caption_px: int = 60


@dataclass(frozen=True)
class Loop:
    """An episode of the expert as a looped animation."""

    task: str
    index: int
    """Instance of the test split."""
    speed: int = 8
    """Simulated seconds per second."""
    frames_per_s: float = 16.0
    last_s: float = 2.0
    """Duration of the last frame [s]."""
    azimuth_deg: float = 264.0
    """Azimuth of the camera, from which no arm occludes the objects."""
    elevation_deg: float = -32.0
    size: tuple[int, int] = (960, 480)
    """Of the picture without its caption [px]."""
    caption_px: int = 76
    quality: int = 70
    """Quality of the compression, up to 100."""
    together: bool = False
    """Whether all robots act at once."""


LOOPS = {
    "hero": Loop(
        "carousel",
        index=3,
        speed=4,
        azimuth_deg=90.0,
        elevation_deg=-38.0,
        size=(960, 456),
        caption_px=96,
        quality=52,
        together=True,
    )
}
MOMENTS = {
    "task_pass": Moment("pass", index=28, step=1, share=0.6),
    "task_pass2": Moment("pass2", index=27, step=2, share=0.55),
    "task_stack": Moment("stack", index=47, step=1, share=0.62),
    "task_stack2": Moment("stack2", index=8, step=3, share=0.58),
    "task_poke": Moment("poke", index=51, step=1, share=0.55),
    "task_poke_stack": Moment("poke_stack", index=1, step=3, share=0.55),
    "task_hook": Moment("hook", index=20, step=1, share=0.55),
    "task_hook_stack": Moment("hook_stack", index=30, step=4, share=0.62),
}
FRAME_S = 0.05


def main(folder: Path, names: Sequence[str] = ()) -> None:
    """Write images into a folder: all, or those with some names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or (*LOOPS, *MOMENTS):
        if name in LOOPS:
            path = folder / f"{name}.webp"
            film(LOOPS[name], path)
        else:
            path = folder / f"{name}.png"
            draw(MOMENTS[name]).save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def film(loop: Loop, path: Path) -> None:
    """Write an episode as an animated WebP."""
    frame_s = loop.speed / loop.frames_per_s
    instance = load_instance(loop.task, "test", loop.index)
    play = record_together if loop.together else record
    recording = play(instance, frame_s=frame_s)
    scene = Scene(recording.instance.scene)
    width, height = loop.size
    points = []
    for _, qpos in recording.frames[::4]:
        pose(scene, qpos)
        points.append(outline(scene))
    camera = overview(
        np.concatenate(points),
        width / height,
        azimuth_deg=loop.azimuth_deg,
        elevation_deg=loop.elevation_deg,
    )
    renderer = Renderer(width, height, "presentation")
    pictures = []
    for number, (time_s, qpos) in enumerate(recording.frames):
        pose(scene, qpos)
        rgb = renderer.rgb(scene.model, scene.data, camera)
        strip = caption(
            recording,
            time_s,
            (width, loop.caption_px),
            f"{loop.speed}x speed",
            ended=number == len(recording.frames) - 1,
        )
        pictures.append(_above(rgb, strip))
    lasts_ms = [round(1000 / loop.frames_per_s)] * len(pictures)
    lasts_ms[-1] = round(1000 * loop.last_s)
    first, *others = pictures
    first.save(
        path,
        save_all=True,
        append_images=others,
        duration=lasts_ms,
        loop=0,
        quality=loop.quality,
        method=6,
    )


def draw(moment: Moment) -> Image.Image:
    """Return the image of a moment, with its caption."""
    recording = record(
        load_instance(moment.task, "test", moment.index), frame_s=FRAME_S
    )
    step = recording.lines[moment.step]
    wanted = step.start_s + moment.share * step.duration_s
    time_s, qpos = min(recording.frames, key=lambda frame: abs(frame[0] - wanted))
    scene = Scene(recording.instance.scene)
    pose(scene, qpos)
    width, height = moment.size
    camera = overview(
        outline(scene),
        width / height,
        azimuth_deg=moment.azimuth_deg,
        elevation_deg=moment.elevation_deg,
    )
    rgb = Renderer(width, height, "presentation").rgb(scene.model, scene.data, camera)
    strip = caption(recording, time_s, (width, moment.caption_px))
    return _above(rgb, strip)


def _above(rgb: NDArray[np.uint8], strip: Image.Image) -> Image.Image:
    """Return an image with its caption below."""
    height, width = rgb.shape[:2]
    picture = Image.new("RGB", (width, height + strip.height))
    picture.paste(Image.fromarray(rgb), (0, 0))
    picture.paste(strip, (0, height))
    return picture


if __name__ == "__main__":
    _, *arguments = sys.argv
    main(Path(arguments[0] if arguments else "docs/images"), arguments[1:])
