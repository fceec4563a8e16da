"""Videos that can be read from anywhere: encoding an episode, joining many.

Every second of a video has several frames that need no other (a short group of
pictures), and no frame refers to a later one, so that a frame is found and decoded at
little cost. The same frames give the same bytes, on every processor: encoders run in
one thread, and without what depends on the processor's instructions.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.video.stream import VideoStream
from numpy.typing import NDArray

from lemma.core.errors import DatasetError
from lemma.scene.cameras import DepthImage

DEPTH_LEVEL_M = 0.001
"""Depth from one level to the next [m]."""
DEPTH_LEVELS = 4096
"""Levels of a 12-bit picture."""
DEPTH_LARGEST_M = (DEPTH_LEVELS - 1) * DEPTH_LEVEL_M
"""Whatever is further is stored as this [m]; cameras of the benchmark see 3.5 m."""


@dataclass(frozen=True, kw_only=True)
class Encoding:
    """How the pictures of one kind become a video."""

    encoder: str
    """Name of the encoder in FFmpeg."""
    codec: str
    """Name of what it writes."""
    pixels: str
    """Format of pixels in the video."""
    given: str
    """Format of pixels that the encoder is given."""
    channels: int
    """Channels of a picture."""
    group: int
    """Frames from one that needs no other to the next."""
    crf: int | None
    """Quality, less is better; None where nothing is lost."""
    preset: str
    """How hard the encoder tries."""
    options: dict[str, str] = field(default_factory=dict)
    """Further options of the encoder."""
    notes: dict[str, Any] = field(default_factory=dict)
    """What readers must know besides."""

    def check(self) -> None:
        """Check that this installation can write it.

        Raises:
            DatasetError: It cannot.
        """
        try:
            formats = av.codec.Codec(self.encoder, "w").video_formats or []
        except ValueError:
            formats = []
        if self.pixels not in [each.name for each in formats]:
            raise DatasetError(
                f"This PyAV ({av.__version__}) cannot write {self.codec} with pixels "
                f"{self.pixels} by {self.encoder}. The wheels of PyPI can: pip install "
                "--force-reinstall av. Or leave depth out."
            )

    def settings(self) -> dict[str, str]:
        """Return the options of the encoder."""
        chosen = {"preset": self.preset, "g": str(self.group), "bf": "0"}
        if self.crf is not None:
            chosen["crf"] = str(self.crf)
        return {**chosen, **self.options}

    def info(self, width_px: int, height_px: int, fps: int) -> dict[str, Any]:
        """Return the ``info`` of a feature that is such a video."""
        return {
            "video.height": height_px,
            "video.width": width_px,
            "video.codec": self.codec,
            "video.pix_fmt": self.pixels,
            "video.fps": fps,
            "video.channels": self.channels,
            "has_audio": False,
            "video.g": self.group,
            "video.crf": self.crf,
            "video.preset": self.preset,
            "video.fast_decode": 0,
            "video.video_backend": "pyav",
            "video.extra_options": {"bf": "0", **self.options},
            **self.notes,
        }


RGB = Encoding(
    encoder="libx264",
    codec="h264",
    pixels="yuv420p",
    given="rgb24",
    channels=3,
    group=5,
    crf=27,
    preset="veryfast",
    options={
        # With AVX-512 and some widths, macroblock trees read memory that nobody wrote.
        # Without them 27 looks like 23 with them, at the same size.
        "x264-params": "mbtree=0:cpu-independent=1"
    },
    notes={"is_depth_map": False},
)
DEPTH = Encoding(
    encoder="libx265",
    codec="hevc",
    pixels="gray12le",
    given="gray12le",
    channels=1,
    group=5,
    crf=None,
    preset="superfast",
    options={
        # Twelve bits, nothing lost; one thread, silence, and no word on the processor.
        # Looking ahead and weighing blocks take memory, and gain nothing here.
        "x265-params": "lossless=1:open-gop=0:pools=none:frame-threads=1"
        ":rc-lookahead=0:scenecut=0:aq-mode=0:cutree=0:weightp=0"
        ":log-level=error:info=0"
    },
    notes={
        "is_depth_map": True,
        "depth_unit": "m",
        "video.depth_min": 0.0,
        "video.depth_max": DEPTH_LARGEST_M,
        "video.shift": 0.0,
        "video.use_log": False,
    },
)


def levels_from_depth(depth_m: DepthImage) -> NDArray[np.uint16]:
    """Return depth [m] as levels of a 12-bit picture; 0 where nothing is seen."""
    rounded = np.rint(depth_m / np.float32(DEPTH_LEVEL_M))
    levels: NDArray[np.uint16] = np.clip(rounded, 0, DEPTH_LEVELS - 1).astype(np.uint16)
    return levels


class Film:
    """A video that is being encoded, in memory."""

    def __init__(
        self, encoding: Encoding, width_px: int, height_px: int, fps: int
    ) -> None:
        """Start the encoder.

        Args:
            encoding: How.
            width_px: Width of every picture [px].
            height_px: Height of every picture [px].
            fps: Frames per second.
        """
        self._encoding = encoding
        self._buffer = io.BytesIO()
        self._container = av.open(self._buffer, "w", format="mp4")
        stream = self._container.add_stream(encoding.encoder, rate=fps)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height = width_px, height_px
        stream.pix_fmt = encoding.pixels
        stream.options = dict(encoding.settings())
        stream.codec_context.thread_count = 1
        self._stream = stream

    def add(self, picture: NDArray[Any]) -> None:
        """Add a picture: (height, width, 3) uint8 for color, or levels of depth."""
        frame = av.VideoFrame.from_ndarray(picture, format=self._encoding.given)
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> bytes:
        """Return the whole video as an MP4 file."""
        self._container.mux(self._stream.encode())
        self._container.close()
        return self._buffer.getvalue()


def join(parts: Sequence[Path], fps: int, path: Path) -> None:
    """Put videos one after the other, without encoding anything anew.

    Args:
        parts: Videos of one encoding and size, as :class:`Film` wrote them.
        fps: Frames per second of all of them.
        path: The MP4 file to write.

    Raises:
        DatasetError: A part is missing or damaged.
    """
    options = {"movflags": "faststart"}
    with av.open(str(path), "w", format="mp4", options=options) as out:
        stream: VideoStream | None = None
        number = 0
        for part in parts:
            try:
                with av.open(str(part)) as source:
                    given = source.streams.video[0]
                    if stream is None:
                        stream = out.add_stream_from_template(given)
                    for packet in source.demux(given):
                        if packet.dts is None:
                            continue
                        packet.time_base = Fraction(1, fps)
                        packet.pts = packet.dts = number
                        packet.duration = 1
                        packet.stream = stream
                        out.mux(packet)
                        number += 1
            except (OSError, av.FFmpegError) as error:
                raise DatasetError(
                    f"{part} cannot be read: {error}. Delete the folder that you "
                    "export to, and export again."
                ) from error
