"""Pictures and videos of failed episodes, played again from their lines."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from lemma.core.poses import FloatArray
from lemma.core.workers.pool import ProcessPool
from lemma.dataset.playback import FrameTaker
from lemma.env.episode import Episode
from lemma.evaluation.report.episodes import Case
from lemma.evaluation.run.replay import differences, play_again
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.camera_mounts import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX
from lemma.scene.raster import RASTER
from lemma.scene.rendering.renderer import Renderer
from lemma.scene.scene import Scene
from lemma.tasks.subtask import GroundedSubTask
from lemma.viz.annotate import LIGHT, Canvas, Color, Point, label_plate
from lemma.viz.camera_fit import outline, overview
from lemma.viz.map_overlay import annotated_map
from lemma.viz.pages.templates import jpeg
from lemma.viz.recording import Frames, Recording, lines_of_case, robot_titles
from lemma.viz.video import VideoStyle, write_video

MAP_PX = 640
VIEW_PX = (448, 288)
POLICY_INK: Color = (213, 94, 0)
EXPERT_INK: Color = (0, 114, 178)


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures of a failed episode."""

    map: bytes
    """The map at the decisive moment, with both choices; JPEG."""
    before: bytes
    """A view of the same state, JPEG."""
    after: bytes
    """The same view of the end, JPEG."""
    differs: str
    """Where the replay differs from the line; ``""`` if nowhere."""
    video: str = ""
    """File beside the page, if there is one."""

    @property
    def size(self) -> int:
        """Bytes of all pictures."""
        return len(self.map) + len(self.before) + len(self.after)


def picture_all(
    cases: Sequence[tuple[int, Case]],
    videos: Path | None,
    workers: int,
    advance: Callable[[int], None] = lambda count: None,
) -> dict[int, Pictures]:
    """Draw episodes, in some processes.

    Args:
        cases: Number and episode of each.
        videos: Folder for videos; None for none.
        workers: Processes.
        advance: Called with the number of episodes that were done.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    paths = {
        number: videos / f"{number}-{case.name.replace('/', '-')}.mp4"
        if videos
        else None
        for number, case in cases
    }
    jobs = [(number, case, paths[number]) for number, case in cases]
    done: dict[int, Pictures] = {}
    for number, pictures in ProcessPool(workers).run(_picture_one, jobs):
        done[number] = pictures
        advance(1)
    return done


def _picture_one(number: int, case: Case, video: Path | None) -> tuple[int, Pictures]:
    return number, picture(case, video)


def picture(case: Case, video: Path | None = None) -> Pictures:
    """Play an episode again and draw it.

    Args:
        case: A failed episode whose instance is known here.
        video: Where to write a video of it, if anywhere.
    """
    steps = case.row["subtasks"]
    moment = len(steps) if case.mistake is None else case.mistake
    style = VideoStyle()
    states: dict[int, FloatArray] = {}
    choices: list[GroundedSubTask | None] = [None]
    takers: list[FrameTaker] = []

    def before(episode: Episode, number: int) -> None:
        states[number] = episode.simulation.scene.snapshot()
        if number == moment:
            choices[0] = _expert_choice(episode)
        if number == 0 and video is not None:
            takers.append(FrameTaker(episode.simulation, style.frame_s))

    again = play_again(case.row, case.instance, case.about, before, strictly=True)
    differs = next(differences(case.row, again, strictly=True), "")
    last = max(states)
    at = min(moment, last)
    scene = Scene(case.instance.scene)
    views = _views(scene, [states[at], states[last]])
    scene.restore(states[at])
    own = steps[moment] if moment < len(steps) else None
    chosen = (
        GroundedSubTask.from_dict(own["grounded"]) if own and own["grounded"] else None
    )
    top = _map(case, scene, chosen, choices[0])
    if video is not None:
        video.parent.mkdir(parents=True, exist_ok=True)
        write_video(_recording(case, takers[0].frames), video, style)
    name = f"{video.parent.name}/{video.name}" if video else ""
    first, end = map(jpeg, views)
    return Pictures(jpeg(top), first, end, differs, name)


def _expert_choice(episode: Episode) -> GroundedSubTask | None:
    """Return the expert's next sub-task, with poses; None if there is none."""
    now = SymbolicState.observe(episode.simulation.scene)
    plan = find_plan(now, episode.instance.goal, GeometricGrounder(now.spec))
    return plan.steps[0].grounded if plan and plan.steps else None


def _views(scene: Scene, states: Sequence[FloatArray]) -> list[Image.Image]:
    """Draw states from one place, from which all of them can be seen."""
    points = []
    for state in states:
        scene.restore(state)
        points.append(outline(scene))
    width, height = VIEW_PX
    camera = overview(np.concatenate(points), width / height)
    renderer = Renderer(width, height, "clip")
    views = []
    for state in states:
        scene.restore(state)
        views.append(Image.fromarray(renderer.rgb(scene.model, scene.data, camera)))
    return views


def _map(
    case: Case,
    scene: Scene,
    own: GroundedSubTask | None,
    expert: GroundedSubTask | None,
) -> Image.Image:
    """Draw the map, with the pick and place of policy and expert."""
    renderer = Renderer(CAMERA_WIDTH_PX, CAMERA_HEIGHT_PX)
    scene.refresh()
    images = [
        renderer.rgbd(scene.model, scene.data, f"{name}/camera")
        for name in case.instance.scene.robot_names
    ]
    top = annotated_map(case.instance, scene, images, MAP_PX)
    canvas = Canvas(top)
    taken: list[tuple[Point, Point]] = []
    titles = dict(
        zip(case.instance.scene.robot_names, robot_titles(case.instance), strict=True)
    )
    # The policy's is drawn last, over the expert's.
    side = 0.25 if own and expert and _opposed(own, expert) else -0.25
    for who, grounded, ink, bend in (
        ("expert", expert, EXPERT_INK, 0.25),
        ("policy", own, POLICY_INK, side),
    ):
        if grounded is None:
            continue
        pick, place = (
            _pixel(pose.x, pose.y, top.size) for pose in (grounded.pick, grounded.place)
        )
        canvas.arrow(pick, place, ink, 3.4 if who == "policy" else 2.4, bend)
        for at in (pick, place):
            canvas.disc(at, 8.0, LIGHT)
            canvas.disc(at, 6.2, ink)
            if who == "expert":
                canvas.disc(at, 3.4, LIGHT)
        middle = (
            (pick[0] + place[0]) / 2 + 0.5 * bend * (place[1] - pick[1]),
            (pick[1] + place[1]) / 2 - 0.5 * bend * (place[0] - pick[0]),
        )
        text = f"{who}: {titles[grounded.robot]}"
        plate = label_plate(middle, text, 12.5, 16.0, taken)
        taken.append(plate)
        canvas.label(plate, text, 12.5, ink)
    return canvas.picture()


def _opposed(one: GroundedSubTask, other: GroundedSubTask) -> bool:
    """Whether two motions go in opposite directions: then they bend apart anyway."""
    (a, b), (c, d) = ((move.pick, move.place) for move in (one, other))
    return (b.x - a.x) * (d.x - c.x) + (b.y - a.y) * (d.y - c.y) < 0.0


def _pixel(x: float, y: float, size: tuple[int, int]) -> Point:
    """Return the point of a map for a position [m], at its edge if it is outside."""
    scale = size[0] / RASTER.columns / RASTER.cell_m
    across, down = size[0] / 2 + x * scale, size[1] / 2 - y * scale
    return min(max(across, 8.0), size[0] - 8.0), min(max(down, 8.0), size[1] - 8.0)


def _recording(case: Case, frames: Frames) -> Recording:
    """Return the episode of a video, whose caption says what the policy was told."""
    row, instance = case.row, case.instance
    said = {**instance.instructions, "high_level": row["instruction"]}
    return Recording(
        case.policy,
        replace(instance, instructions=said),
        lines_of_case(case),
        frames,
        row["success"],
        row["failure"],
        row["elapsed_s"],
    )
