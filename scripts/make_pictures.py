"""Make the pictures of the README and of the documentation, from the code itself.

    .venv/bin/python scripts/make_pictures.py docs/images

Each shows the expert in the middle of a frozen test instance.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.suite import load_instance
from lemma.viz.camera_fit import outline, overview
from lemma.viz.caption import caption
from lemma.viz.recording import record


@dataclass(frozen=True)
class Moment:
    """An instant in an episode of the expert, and how large to draw it."""

    task: str
    index: int
    """Instance of the test split."""
    step: int
    """Sub-task that runs, from 0."""
    share: float
    """How much of it is done, in [0, 1]."""
    azimuth_deg: float = 84.0
    elevation_deg: float = -30.0
    size: tuple[int, int] = (640, 340)
    """Of the picture without its caption [px]."""
    caption_px: int = 60


MOMENTS = {
    "hero": Moment(
        "hook_stack",
        index=42,
        step=4,
        share=0.62,
        elevation_deg=-27.0,
        size=(1600, 800),
        caption_px=130,
    ),
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


def main(folder: Path) -> None:
    """Write every picture into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, moment in MOMENTS.items():
        path = folder / f"{name}.png"
        draw(moment).save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def draw(moment: Moment) -> Image.Image:
    """Return the picture of a moment, with its caption."""
    recording = record(
        load_instance(moment.task, "test", moment.index), frame_s=FRAME_S
    )
    step = recording.steps[moment.step]
    wanted = step.start_s + moment.share * step.duration_s
    time_s, state = min(recording.frames, key=lambda frame: abs(frame[0] - wanted))
    scene = Scene(recording.instance.scene)
    scene.restore(state)
    width, height = moment.size
    camera = overview(
        outline(scene),
        width / height,
        azimuth_deg=moment.azimuth_deg,
        elevation_deg=moment.elevation_deg,
    )
    rgb = Renderer(width, height, "presentation").rgb(scene.model, scene.data, camera)
    strip = caption(recording, time_s, (width, moment.caption_px))
    picture = Image.new("RGB", (width, height + strip.height))
    picture.paste(Image.fromarray(rgb), (0, 0))
    picture.paste(strip, (0, height))
    return picture


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images"))
