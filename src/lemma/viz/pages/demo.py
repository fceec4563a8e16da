"""The page of `lemma demo`: one HTML file with everything in it."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from PIL import Image

from lemma import __version__
from lemma.core.engine import mujoco
from lemma.tasks.suite import task_named
from lemma.viz.recording import RecordedStep, Recording, robot_titles


@dataclass(frozen=True, slots=True)
class Illustration:
    """What the page shows of one recording."""

    video: Path
    """The MP4 file."""
    poster: bytes
    """The last picture of the video, JPEG."""
    map: bytes
    """The annotated map of the first state, JPEG."""


def jpeg(picture: Image.Image) -> bytes:
    """Return a picture as the content of a JPEG file."""
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=86, optimize=True)
    return buffer.getvalue()


def write_page(
    path: Path,
    recordings: Sequence[Recording],
    illustrations: Sequence[Illustration],
    speed: int,
) -> None:
    """Write the page.

    Args:
        path: The HTML file.
        recordings: What the policy did.
        illustrations: Their pictures, in the same order.
        speed: How much faster than real time the videos are.
    """
    solved = sum(recording.success for recording in recordings)
    simulated = sum(recording.elapsed_s for recording in recordings)
    wall = sum(recording.wall_s for recording in recordings)
    lead = (
        f"{solved} of {len(recordings)} instances were solved: {simulated:.0f} "
        f"simulated seconds in {wall:.1f} s, {simulated / wall:.0f} times real time."
    )
    pairs = zip(recordings, illustrations, strict=True)
    page = _template("page.html").substitute(
        title="LEMMA Bench: a demonstration",
        lead=lead,
        rows="\n".join(_row(recording) for recording in recordings),
        cards="\n".join(_card(*pair, speed) for pair in pairs),
        footer=f"Written by lemma {__version__} with MuJoCo {mujoco.__version__}.",
    )
    path.write_text(page, encoding="utf-8")


def _template(name: str) -> Template:
    return Template((files("lemma.viz.pages") / name).read_text(encoding="utf-8"))


def data_uri(kind: str, content: bytes) -> str:
    """Return a file's content as an address, so that a page needs no other file."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _verdict(recording: Recording) -> str:
    if recording.success:
        return '<span class="good">solved</span>'
    return f'<span class="bad">failed: {escape(str(recording.failure))}</span>'


def _row(recording: Recording) -> str:
    instance = recording.instance
    numbers = (
        str(len(recording.steps)),
        f"{recording.elapsed_s:.1f} s",
        f"{recording.wall_s:.2f} s",
        f"{recording.realtime_factor:.0f}×",
    )
    cells = [
        f'<td><a href="#{instance.task}">{instance.task}</a></td>',
        f"<td>{escape(instance.instructions['high_level'])}</td>",
        f"<td>{escape(instance.team)}</td>",
        *(f'<td class="number">{number}</td>' for number in numbers),
        f"<td>{_verdict(recording)}</td>",
    ]
    return f"<tr>{''.join(cells)}</tr>"


def _card(recording: Recording, illustration: Illustration, speed: int) -> str:
    instance = recording.instance
    chips = [_verdict(recording)]
    for name, title, robot in zip(
        instance.scene.robot_names,
        robot_titles(instance),
        instance.scene.robots,
        strict=True,
    ):
        chips.append(f'<span class="dot {robot.color}"></span>{name}: {escape(title)}')
    count = len(instance.distractors)
    chips.append(f"{count} distractor{'' if count == 1 else 's'}")
    chips.append(f"{recording.elapsed_s:.1f} simulated seconds")
    return _template("card.html").substitute(
        task=instance.task,
        key=f"{instance.key}: {escape(task_named(instance.task).summary)}",
        instruction=escape(instance.instructions["high_level"]),
        human=escape(instance.instructions["human"]),
        unseen=escape(instance.instructions["unseen"]),
        chips="".join(f'<span class="chip">{chip}</span>' for chip in chips),
        poster=data_uri("image/jpeg", illustration.poster),
        video=data_uri("video/mp4", illustration.video.read_bytes()),
        map=data_uri("image/jpeg", illustration.map),
        speed=speed,
        lanes="".join(_lane(recording, name) for name in instance.scene.robot_names),
        steps="".join(_item(step) for step in recording.steps),
    )


def _lane(recording: Recording, robot: str) -> str:
    """Return a robot's line of the timeline."""
    instance = recording.instance
    number = instance.scene.robot_names.index(robot)
    color = instance.scene.robots[number].color
    bars = []
    for i, step in enumerate(recording.steps):
        if step.subtask.robot == robot:
            left = 100 * step.start_s / recording.elapsed_s
            width = 100 * step.duration_s / recording.elapsed_s
            style = color if step.ok else "failed"
            bars.append(
                f'<div class="bar {style}" title="{escape(step.words)}" '
                f'style="left:{left:.2f}%;width:{width:.2f}%">{i + 1}</div>'
            )
    title = escape(robot_titles(instance)[number])
    return (
        f'<div class="lane"><span>{title}</span>'
        f'<div class="track">{"".join(bars)}</div></div>'
    )


def _item(step: RecordedStep) -> str:
    outcome = "" if step.ok else f' <span class="bad">{escape(step.explanation)}</span>'
    return (
        f'<li><span class="number">{step.duration_s:.1f} s</span>'
        f"{escape(step.words)}{outcome}</li>"
    )
