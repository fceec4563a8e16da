"""One known scene, asked of a served policy: does it speak of the world as we do?

A policy that mirrors yaw, counts in millimetres or mistakes one robot for the other
runs without an error and fails every episode. Its first decision in a scene whose
answer is known shows it; docs/serving.md prints the scene and the answer.
"""

import math
from dataclasses import dataclass
from typing import Any

from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.evaluation.run.rollout import Rollout
from lemma.expert.expert import Expert
from lemma.expert.grounding import GeometricGrounder
from lemma.expert.symbolic_state import SymbolicState
from lemma.policies.interfaces import TIMEOUT_S
from lemma.serve.client.conversation import ProtocolMode
from lemma.serve.client.websocket import connect
from lemma.tasks.subtask import GroundedSubTask, SubTask
from lemma.tasks.suite import load_instance

SCENE = ("stack", "val", 0)
"""Task, split and index. Each robot reaches one of the two cubes, whose sides are far
from parallel to the axes."""
NEAR_M = 0.03
NEAR_RAD = 0.2


@dataclass(frozen=True)
class ServerCheck:
    """What a served policy answers in the known scene."""

    instruction: str
    subtask: SubTask
    grounded: GroundedSubTask | None
    """None where it has no poses, or only plans."""
    mistakes: dict[str, str]
    """What is wrong, under ``pick``, ``robot`` and ``heading``."""

    @property
    def ok(self) -> bool:
        """Whether nothing is."""
        return not self.mistakes


def first_subtask() -> SubTask:
    """Return what the expert does first in the known scene."""
    instance = load_instance(*SCENE)
    subtask, _ = Expert(Episode(instance).simulation.scene, instance.goal).act()
    return subtask


def check_server(url: str, timeout_s: float = TIMEOUT_S) -> ServerCheck:
    """Ask a served policy for its first decision in the known scene.

    Args:
        url: Such as ``"http://127.0.0.1:8000"``.
        timeout_s: For the decision [s].

    Raises:
        InvalidConfigError: It is no address.
        PolicyUnreachableError: Nobody answers there.
        ProtocolError: Somebody answers who speaks something else.
        PolicyFailedError: It has no decision, or one that cannot be read.
        RenderingError: OpenGL does not work here.
    """
    part: Any = connect(url, ProtocolMode(timeout_s))
    try:
        play = Rollout(load_instance(*SCENE))
        given = play.given(CameraRig())
        subtask, grounded = first_subtask(), None
        if hasattr(part, "act"):
            [decision] = part.act([given])
            subtask, grounded = decision.subtask, decision.grounded
        else:
            if hasattr(part, "plan"):
                [subtask] = part.plan([given])
            if hasattr(part, "ground") and subtask.robot:
                [grounded] = part.ground([given], [subtask])
    finally:
        part.close()
    mistakes = _mistakes(play, subtask, grounded)
    return ServerCheck(given.instruction, subtask, grounded, mistakes)


def _mistakes(
    play: Rollout, subtask: SubTask, grounded: GroundedSubTask | None
) -> dict[str, str]:
    """Return what cannot be right of a first decision."""
    now = SymbolicState.observe(play.episode.simulation.scene)
    geometry = GeometricGrounder(now.spec)
    [pair] = play.instance.goal.pairs
    cubes = {name: now.poses[name] for name in pair}
    told = ", ".join(f"{n} at ({p.x:.3f}, {p.y:.3f}) m" for n, p in cubes.items())
    if grounded is None:
        picked = subtask.pick
        if picked not in cubes:
            return {"pick": f"It picks {picked or 'nothing'}; there are {told}."}
    else:
        at = grounded.pick
        picked = min(cubes, key=lambda name: cubes[name].distance(at))
        if cubes[picked].distance(at) > NEAR_M:
            return {"pick": f"It picks at ({at.x:g}, {at.y:g}); there are {told}."}
    found = {}
    [able] = [r for r in geometry.robots if geometry.reaches(r, cubes[picked])]
    if subtask.robot != able:
        found["robot"] = f"It sends {subtask.robot}; {able} alone reaches {picked}."
    if grounded is not None:
        # A cube looks the same after a quarter turn.
        off = math.remainder(grounded.pick.yaw - cubes[picked].yaw, 0.5 * math.pi)
        if abs(off) > NEAR_RAD:
            found["heading"] = (
                f"Its gripper is {abs(math.degrees(off)):.0f} degrees off the sides of "
                f"{picked}, whose yaw is {cubes[picked].yaw:.3f} rad."
            )
    return found
