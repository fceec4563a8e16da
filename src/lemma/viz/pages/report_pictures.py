"""Pictures and videos of failed episodes, played again from their lines."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image

from lemma.core.poses import FloatArray, Pose2
from lemma.core.workers.pool import ProcessPool, numbered
from lemma.env.episode import Episode
from lemma.evaluation.report.episodes import Case
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.scene import Scene
from lemma.tasks.subtask import GroundedSubTask
from lemma.viz.annotate import LIGHT, Box, Canvas, Color, Point
from lemma.viz.camera_fit import views
from lemma.viz.gantt import gantt_of
from lemma.viz.map_overlay import annotated_map, camera_images, pixel_of
from lemma.viz.pages.templates import jpeg
from lemma.viz.recording import robot_titles
from lemma.viz.replay import replay_line
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
    """First difference of the replay from the line; ``""`` if there is none."""
    video: str = ""
    """File name of the video in the page's folder; ``""`` if there is none."""
    gantt: str = ""
    """Gantt chart of the episode, SVG."""

    @property
    def size(self) -> int:
        """Size of all pictures [bytes]."""
        return len(self.map) + len(self.before) + len(self.after)


def picture_all(
    cases: Sequence[tuple[int, Case]],
    videos: Path | None,
    workers: int,
    advance: Callable[[int], None] = lambda count: None,
) -> dict[int, Pictures]:
    """Draw episodes in parallel processes.

    Args:
        cases: Number and episode of each.
        videos: Folder for videos; None for no videos.
        workers: Number of processes.
        advance: Called with the number of newly finished episodes.

    Returns:
        The pictures, by number of the episode.

    Raises:
        RenderingError: OpenGL does not work here.
    """
    jobs = []
    for number, case in cases:
        name = f"{number}-{case.name.replace('/', '-')}.mp4"
        jobs.append((number, picture, (case, videos and videos / name)))
    done: dict[int, Pictures] = {}
    for number, pictures in ProcessPool(workers).run(numbered, jobs):
        done[number] = pictures
        advance(1)
    return done


def picture(case: Case, video: Path | None = None) -> Pictures:
    """Play an episode again and draw it.

    Args:
        case: A failed episode that can be repeated.
        video: Path of the video to write; None for no video.
    """
    steps, instance, style = case.row["subtasks"], case.instance, VideoStyle()
    moment = len(steps) if case.mistake is None else case.mistake
    states: dict[int, FloatArray] = {}
    expert: GroundedSubTask | None = None

    def before(episode: Episode, number: int) -> None:
        nonlocal expert
        states[number] = episode.simulation.scene.snapshot()
        if number == moment:
            now = SymbolicState.observe(episode.simulation.scene)
            plan = find_plan(now, instance.goal, GeometricGrounder(now.spec))
            expert = plan.steps[0].grounded if plan and plan.steps else None

    again = replay_line(case, before, style.frame_s)
    scene, last = Scene(instance.scene), max(states)
    decisive = states[min(moment, last)]
    first, end = views(scene, [decisive, states[last]], VIEW_PX, "clip")
    scene.restore(decisive)
    poses = steps[moment]["grounded"] if moment < len(steps) else None
    own = GroundedSubTask.from_dict(poses) if poses else None
    top = _map(case, scene, own, expert)
    name = ""
    if video is not None:
        # The caption shows the policy's instruction.
        said = {**instance.instructions, "high_level": case.row["instruction"]}
        recording = replace(
            again.recording, instance=replace(instance, instructions=said)
        )
        write_video(recording, video, style)
        name = f"{video.parent.name}/{video.name}"
    chart = gantt_of(again.recording)
    return Pictures(jpeg(top), jpeg(first), jpeg(end), again.differs, name, chart)


def _map(
    case: Case,
    scene: Scene,
    own: GroundedSubTask | None,
    expert: GroundedSubTask | None,
) -> Image.Image:
    """Draw the map, with the pick and place of policy and expert."""
    instance = case.instance
    top = annotated_map(instance, scene, camera_images(scene), MAP_PX)
    canvas, occupied = Canvas(top), list[Box]()
    # The policy's arrow is drawn last, over the expert's.
    side = 0.25 if own and expert and _opposed(own, expert) else -0.25
    for who, grounded, ink, bend, width in (
        ("expert", expert, EXPERT_INK, 0.25, 2.4),
        ("policy", own, POLICY_INK, side, 3.4),
    ):
        if grounded is None:
            continue
        pick, place = (_at(pose, top) for pose in (grounded.pick, grounded.place))
        canvas.arrow(pick, place, ink, width, bend)
        for at in (pick, place):
            canvas.disc(at, 8.0, LIGHT)
            canvas.disc(at, 6.2, ink)
            if who == "expert":
                canvas.disc(at, 3.4, LIGHT)
        middle = (
            (pick[0] + place[0]) / 2 + 0.5 * bend * (place[1] - pick[1]),
            (pick[1] + place[1]) / 2 - 0.5 * bend * (place[0] - pick[0]),
        )
        text = f"{who}: {robot_titles(instance)[grounded.robot]}"
        canvas.label(middle, text, 12.5, ink, 16.0, occupied)
    return canvas.picture()


def _opposed(one: GroundedSubTask, other: GroundedSubTask) -> bool:
    """Whether two motions have opposite directions; their arrows then bend apart."""
    (a, b), (c, d) = ((move.pick, move.place) for move in (one, other))
    return (b.x - a.x) * (d.x - c.x) + (b.y - a.y) * (d.y - c.y) < 0.0


def _at(pose: Pose2, top: Image.Image) -> Point:
    """Return the point of a map for a pose, at its edge if it is outside."""
    x, y = pixel_of(pose.x, pose.y, top.width)
    return min(max(x, 8.0), top.width - 8.0), min(max(y, 8.0), top.height - 8.0)
