"""The strip beside a picture: what was asked for, what happens, and when."""

from PIL import Image, ImageDraw

from lemma.viz.annotate import BAD, GOOD, Color, fitting_size, font
from lemma.viz.recording import Line, Recording, main_sentence

_INK: Color = (246, 247, 249)
_FAINT: Color = (160, 170, 182)
_GROUND: Color = (24, 28, 34)


def caption(
    recording: Recording,
    time_s: float,
    size: tuple[int, int],
    note: str = "",
    *,
    ended: bool = False,
) -> Image.Image:
    """Draw instruction, running sub-task and simulated time.

    Args:
        recording: The episode.
        time_s: Simulated time of the picture [s].
        size: Width and height of the strip [px].
        note: A remark beside the time.
        ended: Whether to say how it ended instead of the sub-task.
    """
    width, height = size
    strip = Image.new("RGB", size, _GROUND[:3])
    draw = ImageDraw.Draw(strip)
    edge = round(0.22 * height)
    instruction = f"“{main_sentence(recording.instance)}”"
    large = font(fitting_size(instruction, 0.28 * height, width - 2 * edge))
    at = (edge, 0.31 * height)
    draw.text(at, instruction, fill=_INK[:3], font=large, anchor="lm")
    low = 0.70 * height
    clock = "   ".join(part for part in (f"{time_s:.1f} s", note) if part)
    small = font(0.21 * height)
    draw.text((width - edge, low), clock, fill=_FAINT[:3], font=small, anchor="rm")
    text, ink = _status(recording, time_s, ended)
    room = width - 3 * edge - small.getlength(clock)
    small = font(fitting_size(text, 0.21 * height, room))
    draw.text((edge, low), text, fill=ink[:3], font=small, anchor="lm")
    share = time_s / max(recording.elapsed_s, time_s, 1e-9)
    bar = max(2, height // 18)
    draw.rectangle((0, height - bar, share * width, height), fill=GOOD[:3])
    return strip


def _status(recording: Recording, time_s: float, ended: bool) -> tuple[str, Color]:
    """Return what happens at a time, in words, and the color to say it in."""
    if ended and recording.success:
        return "Solved.", GOOD
    if ended:
        return f"Not solved: {recording.failure}.", BAD
    if not recording.lines:
        return "", _FAINT
    number, step = _running(recording, time_s)
    return f"{number}/{len(recording.lines)}   {step.words}", _FAINT


def _running(recording: Recording, time_s: float) -> tuple[int, Line]:
    """Return the sub-task that runs at a time, and its number from 1."""
    found = 0
    for i, step in enumerate(recording.lines):
        if step.start_s <= time_s:
            found = i
    return found + 1, recording.lines[found]
