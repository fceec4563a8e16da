"""What a policy does in real scenes, held against the usual mistakes.

A server that decodes everything rightly may still hold a policy that mirrors, swaps or
rescales. Its first decisions in a few scenes tell: they pick nothing where they say,
and cubes where one of the usual mistakes would put it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from lemma.core.poses import Pose2
from lemma.env.camera_rig import CameraRig
from lemma.evaluation.run.fault_isolation import Fault, IsolatedPolicy
from lemma.evaluation.run.rollout import Rollout
from lemma.expert.grounding import GeometricGrounder
from lemma.expert.symbolic_state import SymbolicState
from lemma.policies.interfaces import Decision, Policy
from lemma.scene.objects.entity import kind_of
from lemma.tasks.subtask import Primitive
from lemma.tasks.suite import load_instance

SCENES = (
    *(("pass", 0), ("pass", 1), ("stack", 0), ("stack", 2)),
    *(("pass2", 0), ("pass2", 1), ("stack2", 0), ("stack2", 1)),
)
"""Tasks and numbers of the split ``val``; in half of them the first robot begins."""
NEAR_M = 0.03
NEAR_RAD = 0.25

_FEWEST = 6
"""Decisions that a verdict needs."""
_CHANGES: dict[str, tuple[str, Callable[[Pose2], Pose2]]] = {
    "y is mirrored": ("axes", lambda p: Pose2(p.x, -p.y, -p.yaw)),
    "x is mirrored": ("axes", lambda p: Pose2(-p.x, p.y, -p.yaw)),
    "both axes are reversed": ("axes", lambda p: Pose2(-p.x, -p.y, p.yaw)),
    "x and y are swapped": ("axes", lambda p: Pose2(p.y, p.x, p.yaw)),
    "they are in millimetres": (
        "units of length",
        lambda p: Pose2(p.x / 1000.0, p.y / 1000.0, p.yaw),
    ),
    "they are in centimetres": (
        "units of length",
        lambda p: Pose2(p.x / 100.0, p.y / 100.0, p.yaw),
    ),
}


@dataclass(frozen=True)
class Probe:
    """What was found."""

    scenes: int
    picks: int
    """First decisions that move something, with poses."""
    hits: int
    """Those whose pick lies on a cube."""
    mistakes: dict[str, str] = field(default_factory=dict)
    """By name of the check."""

    def __str__(self) -> str:
        """Return one line."""
        return (
            f"In {self.scenes} scenes it picked {self.picks} times first, of that "
            f"{self.hits} times a cube."
        )


@dataclass(frozen=True)
class _Pick:
    """A first decision, and the truth of its scene."""

    robot: str
    pose: Pose2
    cubes: dict[str, Pose2]
    reaching: set[str]
    """Robots that reach the pose."""


def probe(policy: Policy, rig: CameraRig) -> Probe:
    """Ask for the first decisions in a few scenes, and see what they hit.

    Args:
        policy: Decides.
        rig: What it sees with.

    Raises:
        PolicyUnreachableError: Its server is gone.
        RenderingError: OpenGL does not work here.
    """
    plays = [Rollout(load_instance(task, "val", index)) for task, index in SCENES]
    answers = IsolatedPolicy(policy).decide([play.given(rig) for play in plays])
    faults = [answer for answer in answers if isinstance(answer, Fault)]
    if len(faults) == len(plays):
        why = f"It fails at every scene: {faults[0].kind}: {faults[0].explanation}"
        return Probe(len(plays), 0, 0, {"decision": why})
    picks = [
        _picked(play, answer)
        for play, answer in zip(plays, answers, strict=True)
        if isinstance(answer, Decision)
        and answer.grounded is not None
        and answer.grounded.primitive is Primitive.MOVE
    ]
    hits = [pick for pick in picks if _hit(pick, pick.pose)]
    return Probe(len(plays), len(picks), len(hits), _mistakes(picks, hits))


def _picked(play: Rollout, decision: Decision) -> _Pick:
    scene = play.episode.simulation.scene
    poses = SymbolicState.observe(scene).poses
    assert decision.grounded is not None
    pose = decision.grounded.pick
    geometry = GeometricGrounder(scene.spec)
    return _Pick(
        decision.grounded.robot,
        pose,
        {name: at for name, at in poses.items() if kind_of(name).cargo},
        {robot for robot in geometry.robots if geometry.reaches(robot, pose)},
    )


def _hit(pick: _Pick, pose: Pose2) -> Pose2 | None:
    """Return the cube at a pose."""
    near = [cube for cube in pick.cubes.values() if cube.distance(pose) <= NEAR_M]
    return near[0] if near else None


def _mistakes(picks: Sequence[_Pick], hits: Sequence[_Pick]) -> dict[str, str]:
    if len(picks) < _FEWEST:
        return {}
    if 2 * len(hits) < len(picks):
        for how, (name, change) in _CHANGES.items():
            found = sum(_hit(pick, change(pick.pose)) is not None for pick in picks)
            if 4 * found >= 3 * len(picks):
                return {
                    name: f"{len(hits)} of its {len(picks)} first picks lie on a cube, "
                    f"and {found} would if {how}."
                }
        return {}
    return {**_of_robots(hits), **_of_yaws(hits)}


def _of_robots(hits: Sequence[_Pick]) -> dict[str, str]:
    one_sided = [pick for pick in hits if len(pick.reaching) == 1]
    wrong = [pick for pick in one_sided if pick.robot not in pick.reaching]
    if len(wrong) < _FEWEST or len(wrong) < len(one_sided):
        return {}
    return {
        "robot order": f"All {len(wrong)} cubes that it picks first are out of reach "
        "of the robot that it names and within reach of the other one. robot_0 is the "
        "first of the list, at -x."
    }


def _of_yaws(hits: Sequence[_Pick]) -> dict[str, str]:
    """Return whether the yaws fit the cubes only when they are mirrored."""
    turned = [(pick.pose.yaw, _hit(pick, pick.pose)) for pick in hits]
    right = sum(cube is not None and _near(yaw, cube.yaw) for yaw, cube in turned)
    mirrored = sum(cube is not None and _near(-yaw, cube.yaw) for yaw, cube in turned)
    if len(hits) < _FEWEST or 4 * mirrored < 3 * len(hits) or 2 * right > len(hits):
        return {}
    return {
        "yaw sign": f"The gripper is aligned with {right} of the {len(hits)} cubes "
        f"that it picks first, and would be with {mirrored} if yaw had the other sign. "
        "Yaw is counter-clockwise seen from above."
    }


def _near(yaw: float, other: float) -> bool:
    """Whether two yaws are alike to a gripper on a cube, a quarter turn aside."""
    return abs(math.remainder(yaw - other, 0.5 * math.pi)) <= NEAR_RAD
