"""From a recording to an H.264 video that every browser plays."""

from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from PIL import Image, ImageDraw

from lemma.cli.drawing import BAD, GOOD, Colour, fitting_size, font
from lemma.cli.recording import RecordedStep, Recording
from lemma.cli.viewpoint import outline, overview
from lemma.scene.canvas import Tessellation
from lemma.scene.rendering import QUALITIES, Quality, Renderer
from lemma.scene.scene import Scene

_BAR_INK: Colour = (246, 247, 249)
_BAR_FAINT: Colour = (160, 170, 182)
_BAR: Colour = (24, 28, 34)
_VIEWED_FRAMES = 40
"""Frames that the viewpoint is fitted to; the arms move little in between."""


# As "video", but for small pictures: coarser shadows take a third off the time.
QUALITIES.add(
    "clip",
    Quality(
        Tessellation(slices=24, stacks=10, quads=2, shadow_map_px=1024),
        oversampling=2,
        scenery=True,
    ),
)


@dataclass(frozen=True, kw_only=True)
class VideoStyle:
    """Size and pace of a video."""

    width_px: int = 704
    """Width of the picture [px]; even, as H.264 wants it."""
    height_px: int = 396
    """Height of what is rendered; the caption comes below [px]."""
    caption_px: int = 72
    """Height of the caption [px]."""
    frames_per_s: int = 25
    """Frames per second of the video."""
    speed: int = 3
    """Simulated seconds per second of the video; the caption says it."""
    last_s: float = 1.2
    """How long the last picture stays [s]."""
    quality: str = "clip"
    """A name in :data:`lemma.scene.rendering.QUALITIES`."""

    @property
    def frame_s(self) -> float:
        """Simulated time from one frame to the next [s]."""
        return self.speed / self.frames_per_s


def write_video(recording: Recording, path: Path, style: VideoStyle) -> Image.Image:
    """Render a recording and encode it.

    Args:
        recording: What to show; recorded with ``style.frame_s``.
        path: The MP4 file.
        style: Size and pace.

    Returns:
        The last frame.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    scene = Scene(recording.instance.scene)
    renderer = Renderer(style.width_px, style.height_px, style.quality)
    states = [state for _, state in recording.frames]
    points = []
    for state in states[:: max(1, len(states) // _VIEWED_FRAMES)]:
        scene.restore(state)
        points.append(outline(scene))
    aspect = style.width_px / style.height_px
    camera = overview(np.concatenate(points), aspect)
    frame = Image.new("RGB", _size(style))
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=style.frames_per_s)
        stream.width, stream.height = frame.size
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": "veryfast", "crf": "22"}
        stream.codec_context.thread_count = 1
        for number, (time_s, state) in enumerate(recording.frames):
            scene.restore(state)
            picture = renderer.rgb(scene.model, scene.data, camera)
            ended = number == len(recording.frames) - 1
            frame.paste(Image.fromarray(picture), (0, 0))
            frame.paste(_caption(recording, time_s, style, ended), (0, style.height_px))
            copies = round(style.last_s * style.frames_per_s) if ended else 1
            for _ in range(copies):
                image = av.VideoFrame.from_ndarray(np.asarray(frame), format="rgb24")
                for packet in stream.encode(image):
                    container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return frame


def _size(style: VideoStyle) -> tuple[int, int]:
    return style.width_px, style.height_px + style.caption_px


def _caption(
    recording: Recording, time_s: float, style: VideoStyle, ended: bool
) -> Image.Image:
    """Draw the strip below the picture: instruction, running sub-task, time."""
    width, height = style.width_px, style.caption_px
    strip = Image.new("RGB", (width, height), _BAR[:3])
    draw = ImageDraw.Draw(strip)
    edge = round(0.22 * height)
    instruction = f"“{recording.instance.instructions['high_level']}”"
    size = fitting_size(instruction, 0.28 * height, width - 2 * edge)
    at = (edge, 0.31 * height)
    draw.text(at, instruction, fill=_BAR_INK[:3], font=font(size), anchor="lm")
    small = font(0.21 * height)
    clock = f"{time_s:.1f} s   {style.speed}x speed"
    low = 0.72 * height
    draw.text((width - edge, low), clock, fill=_BAR_FAINT[:3], font=small, anchor="rm")
    text, ink = _status(recording, time_s, ended)
    draw.text((edge, low), text, fill=ink[:3], font=small, anchor="lm")
    share = min(1.0, time_s / recording.elapsed_s)
    draw.rectangle((0, height - 4, share * width, height), fill=GOOD[:3])
    return strip


def _status(recording: Recording, time_s: float, ended: bool) -> tuple[str, Colour]:
    """Return what happens at a time, in words, and the colour to say it in."""
    if ended and recording.success:
        return "Solved.", GOOD
    if ended:
        return f"Not solved: {recording.failure}.", BAD
    number, step = _running(recording, time_s)
    return f"{number}/{len(recording.steps)}   {step.words}", _BAR_FAINT


def _running(recording: Recording, time_s: float) -> tuple[int, RecordedStep]:
    """Return the sub-task that runs at a time, and its number from 1."""
    found = 0
    for i, step in enumerate(recording.steps):
        if step.start_s <= time_s:
            found = i
    return found + 1, recording.steps[found]
