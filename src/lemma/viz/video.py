"""From a recording to an H.264 video that every browser plays."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from lemma.core.files import write_whole
from lemma.scene.rendering.gl_context import Tessellation
from lemma.scene.rendering.renderer import QUALITIES, Quality, Renderer
from lemma.scene.scene import Scene
from lemma.viz.camera_fit import outline, overview
from lemma.viz.caption import caption
from lemma.viz.recording import Recording, pose

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
    """Height of what is rendered; the caption comes above [px]."""
    caption_px: int = 72
    """Height of the caption [px]."""
    frames_per_s: int = 25
    """Frames per second of the video."""
    speed: int = 4
    """Simulated seconds per second of the video; the caption says it."""
    last_s: float = 1.2
    """How long the last picture stays [s]."""
    quality: str = "clip"
    """A name in :data:`lemma.scene.rendering.renderer.QUALITIES`."""

    @property
    def frame_s(self) -> float:
        """Simulated time from one frame to the next [s]."""
        return self.speed / self.frames_per_s


def write_video(recording: Recording, path: Path, style: VideoStyle) -> Image.Image:
    """Render a recording and encode it.

    Args:
        recording: The episode, with frames every ``style.frame_s``.
        path: The MP4 file.
        style: Size and pace.

    Returns:
        The last frame.

    Raises:
        RenderingError: OpenGL does not work here.
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    last: list[Image.Image] = []
    write_whole(path, lambda draft: last.append(_encode(recording, draft, style)))
    return last[0]


def _encode(recording: Recording, path: Path, style: VideoStyle) -> Image.Image:
    """Render a recording and encode it as MP4; return the last frame."""
    # The encoder is optional, and only videos need it.
    import av  # noqa: PLC0415

    scene = Scene(recording.instance.scene)
    renderer = Renderer(style.width_px, style.height_px, style.quality)
    frames, points = recording.frames, []
    for _, qpos in frames[:: max(1, len(frames) // _VIEWED_FRAMES)]:
        pose(scene, qpos)
        points.append(outline(scene))
    aspect = style.width_px / style.height_px
    camera = overview(np.concatenate(points), aspect)
    frame = Image.new("RGB", _size(style))
    options = {"movflags": "faststart"}
    with av.open(str(path), "w", format="mp4", options=options) as container:
        stream = container.add_stream("libx264", rate=style.frames_per_s)
        stream.width, stream.height = frame.size
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": "veryfast", "crf": "22"}
        stream.codec_context.thread_count = 1
        for number, (time_s, qpos) in enumerate(frames):
            pose(scene, qpos)
            picture = renderer.rgb(scene.model, scene.data, camera)
            ended = number == len(frames) - 1
            # Below, players' controls would cover the words.
            frame.paste(Image.fromarray(picture), (0, style.caption_px))
            note = f"{style.speed}x speed"
            strip = caption(recording, time_s, _caption_size(style), note, ended=ended)
            frame.paste(strip, (0, 0))
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


def _caption_size(style: VideoStyle) -> tuple[int, int]:
    return style.width_px, style.caption_px
