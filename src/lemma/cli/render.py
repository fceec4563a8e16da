"""`lemma render`: images or a LeRobotDataset from a recipe."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro

from lemma.cli.options import (
    ALL,
    Data,
    Flag,
    JsonFlag,
    Listed,
    output,
    print_json,
    words,
)
from lemma.cli.workers import AT_INTERRUPT, DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import InvalidConfigError
from lemma.core.workers.pool import Engine
from lemma.dataset.lerobot.export import LeRobotConfig, write_dataset
from lemma.dataset.lerobot.frames import EnvironmentState, Style
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.key_poses import KeyPoseForm
from lemma.dataset.rendered.render import RenderConfig, RenderSummary
from lemma.dataset.rendered.render import render as render_form
from lemma.dataset.teleoperation import files_in
from lemma.env.learning.motor_state import MotorControl
from lemma.scene.rendering.batch import choose_renderer
from lemma.tasks.language.template import KINDS

FormName = Literal["keyframes", "key-poses", "lerobot"]
Make = Callable[[Engine, Callable[[int], None]], RenderSummary]
"""Writes missing episodes; the arguments are an engine and a callback for progress."""
_SIZES = {"keyframes": "640x480", "key-poses": "640x480", "lerobot": "224x224"}
_ROWS = {"keyframes": "keyframes", "key-poses": "keyframes", "lerobot": "frames"}


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Selection of episodes, and options of the images."""

    tasks: Listed = ALL
    """Names of tasks, separated by commas."""
    splits: Annotated[Listed, tyro.conf.arg(aliases=["--split"])] = ALL
    """Names of splits, separated by commas."""
    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = ""
    """Size of camera images [px]: 640x480, for LeRobotDatasets 224x224, by default."""
    fps: int = 10
    """LeRobotDataset: frames per simulated second, such as 10 or 20."""
    no_depth: Flag = False
    """LeRobotDataset: leave out depth."""
    cameras: Annotated[str, tyro.conf.arg(metavar="CAMERA,...")] = ""
    """LeRobotDataset: cameras, such as robot_0,robot_1,robot_0_wrist or overview; by
    default those that environments observe at control level."""
    instructions: Listed = "high-level"
    """LeRobotDataset: kinds of instructions, high-level, human, unseen, or all; each
    kind adds a copy of the episode with that instruction as its task."""
    no_images: Flag = False
    """LeRobotDataset: leave out all images."""
    environment_state: EnvironmentState = "none"
    """LeRobotDataset: content of observation.environment_state, for policies without
    text input, such as ACT and Diffusion Policy. sentence: the instruction as numbers;
    privileged: the true poses and goal, for oracles."""
    control: MotorControl = "joint_position"
    """LeRobotDataset: control mode of actions and state: joint_position, or
    ee_waypoint_rot6d, the targets of the tool centre points."""
    missed: float = 0.0
    """Key poses: share of placements that are missed by some centimetres, which adds
    frames of recovery."""
    renderer: str = "auto"
    """LeRobotDataset: opengl or warp; auto chooses warp if MuJoCo Warp is installed and
    finds a GPU."""


EVERYTHING = RenderOptions()
"""All episodes with default options."""
_FILMED = (
    *("fps", "no_depth", "cameras", "instructions", "no_images"),
    *("environment_state", "control", "renderer"),
)
"""Options for LeRobotDatasets only."""


def render(
    data: Data,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    form: FormName = "keyframes",
    look: Annotated[RenderOptions, tyro.conf.arg(name="")] = EVERYTHING,
    working: WorkerOptions = DEFAULT,
    as_json: JsonFlag = False,
) -> int:
    """Make images or a LeRobotDataset from a recipe.

    Existing files are kept, so the same command continues an interrupted run.

    Args:
        data: The recipe that lemma generate wrote. With --form lerobot also an episode
            that was led by hand on the page of lemma play, or a folder of such files.
        out: Folder for the output.
        form: keyframes: images and labels before every sub-task, for planners;
            key-poses: frames at key poses; lerobot: LeRobotDataset v3.0 with states,
            commands and videos at a rate, which needs the package lerobot.
        look: Selection of episodes, and options of the images.
        working: Options of the workers.
        as_json: Print one JSON object instead of text.
    """
    tasks, splits = words(look.tasks, every=()), words(look.splits, every=())
    order = RenderConfig(recipe=data, out=out, tasks=tasks, splits=splits)
    make = choose_form(form, order, look)
    engine = working.make_engine()
    with progress_bar("render", order.episodes(), AT_INTERRUPT) as advance:
        summary = make(engine, advance)
    if as_json:
        print_json({"form": form, **asdict(summary)})
    else:
        _print(out, form, summary)
    return 0


def choose_form(name: FormName, order: RenderConfig, look: RenderOptions) -> Make:
    """Return the function that writes the form.

    Raises:
        InvalidConfigError: Size or rate is invalid, or an option is for another form.
        RenderingError: The chosen renderer is not installed.
        UnknownNameError: No such kind of instructions.
    """
    width, height = parse_size(look.size or _SIZES[name])
    if name != "lerobot" and files_in(order.recipe):
        raise InvalidConfigError(
            "Episodes led by hand have no keyframes, since keyframes are between "
            "sub-tasks. Use --form lerobot."
        )
    if look.missed and name != "key-poses":
        raise InvalidConfigError("--missed is only for --form key-poses. Leave it out.")
    if name != "lerobot":
        for field in _FILMED:
            if getattr(look, field) != getattr(EVERYTHING, field):
                raise InvalidConfigError(
                    f"--{field.replace('_', '-')} is for --form lerobot; keyframes "
                    "have no rate, are rendered with OpenGL, and always contain depth, "
                    "each robot's camera and every instruction. Leave it out."
                )
        if name == "key-poses":
            form = KeyPoseForm(width, height, missed=look.missed)
            return partial(render_form, order, form)
        return partial(render_form, order, KeyframeForm(width, height))
    style = Style(
        fps=look.fps,
        width_px=width,
        height_px=height,
        depth=not look.no_depth,
        cameras=words(look.cameras) if look.cameras else (),
        instructions=words(look.instructions.replace("-", "_"), every=KINDS),
        images=not look.no_images,
        environment_state=look.environment_state,
        control=look.control,
        renderer=choose_renderer(look.renderer),
    )
    return partial(write_dataset, LeRobotConfig(source=order, style=style))


def parse_size(text: str) -> tuple[int, int]:
    """Return width and height [px] from text such as ``"640x480"``.

    Raises:
        InvalidConfigError: The text is not a size.
    """
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InvalidConfigError(
            f"--size {text} is not a size. Write width and height in pixels with an x "
            "between them: 640x480."
        )
    return int(width), int(height)


def _print(out: Path, form: FormName, summary: RenderSummary) -> None:
    output().print(
        f"{out}: {summary.rows} {_ROWS[form]}, {summary.size_mb:.1f} MB. Of "
        f"{summary.episodes} episodes, {summary.made} were made by this run "
        f"({summary.seconds:.1f} s).",
        soft_wrap=True,
    )
