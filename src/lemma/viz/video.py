"""H.264 videos of recordings, with a caption, for every browser."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from lemma.core.files import write_whole
from lemma.scene.rendering.gl_context import Tessellation
from lemma.scene.rendering.renderer import QUALITIES, Quality, Renderer
from lemma.scene.scene import Scene
from lemma.viz.annotate import BAD, GOOD, ROBOT_INK, Color, fitting_size, font, wrap
from lemma.viz.camera_fit import outline, overview
from lemma.viz.recording import Recording, main_sentence, pose

_INK: Color = (246, 247, 249)
_FAINT: Color = (160, 170, 182)
_WAITS: Color = (139, 79, 198)
"""Color of a robot that waits for a region, as in Gantt charts."""
_GROUND: Color = (24, 28, 34)
_VIEWED_FRAMES = 40
"""Number of frames for which the viewpoint is computed."""


# Like "video", but for small pictures: coarser shadows save a third of the time.
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
    """Width of the picture [px]; H.264 needs an even number."""
    height_px: int = 396
    """Height of the rendered picture, without the caption above it [px]."""
    caption_px: int = 72
    """Height of the caption [px]."""
    frames_per_s: int = 25
    """Frames per second of the video."""
    speed: int = 4
    """Simulated seconds per second of the video, shown in the caption."""
    last_s: float = 1.2
    """Duration of the last picture [s]."""
    quality: str = "clip"
    """A name in :data:`lemma.scene.rendering.renderer.QUALITIES`."""

    @property
    def frame_s(self) -> float:
        """Simulated time from one frame to the next [s]."""
        return self.speed / self.frames_per_s


def write_video(recording: Recording, path: Path, style: VideoStyle) -> Image.Image:
    """Render a recording and encode it.

    Args:
        recording: The episode, with a frame every ``style.frame_s``.
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
    # Import late: the encoder is optional.
    import av  # noqa: PLC0415

    scene = Scene(recording.instance.scene)
    renderer = Renderer(style.width_px, style.height_px, style.quality)
    frames, points = recording.frames, []
    for _, qpos in frames[:: max(1, len(frames) // _VIEWED_FRAMES)]:
        pose(scene, qpos)
        points.append(outline(scene))
    aspect = style.width_px / style.height_px
    camera = overview(np.concatenate(points), aspect)
    size = (style.width_px, style.height_px + style.caption_px)
    frame = Image.new("RGB", size)
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
            # The caption is above: controls of players cover the lower edge.
            frame.paste(Image.fromarray(picture), (0, style.caption_px))
            size, note = (style.width_px, style.caption_px), f"{style.speed}x speed"
            strip = caption(recording, time_s, size, note, ended=ended)
            frame.paste(strip, (0, 0))
            copies = round(style.last_s * style.frames_per_s) if ended else 1
            for _ in range(copies):
                image = av.VideoFrame.from_ndarray(np.asarray(frame), format="rgb24")
                for packet in stream.encode(image):
                    container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return frame


def caption(
    recording: Recording,
    time_s: float,
    size: tuple[int, int],
    note: str = "",
    *,
    ended: bool = False,
) -> Image.Image:
    """Return a strip with instruction, running sub-task and simulated time.

    Args:
        recording: The episode.
        time_s: Simulated time of the picture [s].
        size: Width and height of the strip [px].
        note: A remark beside the time.
        ended: Whether to show the result instead of the sub-task.
    """
    width, height = size
    strip = Image.new("RGB", size, _GROUND)
    draw = ImageDraw.Draw(strip)
    whole_s = max(recording.elapsed_s, time_s, 1e-9)
    if _at_work(recording, None) > 1:
        height -= _draw_rows(draw, recording, time_s, whole_s, size)
    else:
        bar = max(2, height // 18)
        draw.rectangle((0, height - bar, time_s / whole_s * width, height), fill=GOOD)
    edge = round(0.22 * height)
    instruction = f"“{main_sentence(recording.instance)}”"
    room, least = width - 2 * edge, 0.16 * height
    size_px = fitting_size(instruction, 0.28 * height, room)
    if size_px < least:
        # Two readable lines instead of a long one.
        size_px, instruction = least, "\n".join(wrap(instruction, least, room))
    at = (edge, 0.31 * height)
    draw.text(at, instruction, fill=_INK, font=font(size_px), anchor="lm", spacing=2)
    low = 0.70 * height
    clock = "   ".join(part for part in (f"{time_s:.1f} s", note) if part)
    small = font(0.21 * height)
    draw.text((width - edge, low), clock, fill=_FAINT, font=small, anchor="rm")
    text, ink = _status(recording, time_s, ended)
    beside = width - 3 * edge - small.getlength(clock)
    small = font(fitting_size(text, 0.21 * height, beside))
    draw.text((edge, low), text, fill=ink, font=small, anchor="lm")
    return strip


def _draw_rows(
    draw: ImageDraw.ImageDraw,
    recording: Recording,
    time_s: float,
    whole_s: float,
    size: tuple[int, int],
) -> int:
    """Draw a row for each robot with its work so far; return the rows' height [px]."""
    scene, (width, height) = recording.instance.scene, size
    row = max(2, height // 20)
    rows = len(scene.robots) * (row + 1)
    for number, (name, placed) in enumerate(
        zip(scene.robot_names, scene.robots, strict=True)
    ):
        top = height - rows + number * (row + 1)
        for line in recording.lines:
            if line.subtask is None or line.subtask.robot != name:
                continue
            end_s = min(time_s, whole_s if line.end_s is None else line.end_s)
            spans = [(line.start_s, end_s, ROBOT_INK[placed.color])]
            spans += [(a, min(b, end_s), _WAITS) for a, b in line.waits]
            for since_s, until_s, ink in spans:
                left, right = (width * s / whole_s for s in (since_s, until_s))
                if right > left + 2:
                    draw.rectangle((left, top, right - 2, top + row - 1), fill=ink)
    return rows


def _at_work(recording: Recording, time_s: float | None) -> int:
    """Return the number of robots in sub-tasks at a time; the maximum if None."""
    lines = [line for line in recording.lines if line.subtask is not None]
    if time_s is None:
        starts = (line.start_s for line in lines)
        return max((_at_work(recording, start_s) for start_s in starts), default=0)
    whole_s = recording.elapsed_s
    return sum(
        line.start_s <= time_s < (whole_s if line.end_s is None else line.end_s)
        for line in lines
    )


def _status(recording: Recording, time_s: float, ended: bool) -> tuple[str, Color]:
    """Return the text of the state at a time, and its color."""
    lines = recording.lines
    if ended and recording.success:
        return "Solved.", GOOD
    if ended:
        return f"Not solved: {recording.failure}.", BAD
    if not lines:
        return "", _FAINT
    if _at_work(recording, None) > 1:
        over = sum(line.end_s is not None and line.end_s <= time_s for line in lines)
        robots = _at_work(recording, time_s)
        many = "1 robot at work" if robots == 1 else f"{robots} robots at work"
        return f"{over} of {len(lines)} sub-tasks done   {many}", _FAINT
    # Show the sub-task that began last.
    number = max(sum(line.start_s <= time_s for line in lines), 1)
    return f"{number}/{len(lines)}   {lines[number - 1].words}", _FAINT
