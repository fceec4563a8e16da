"""Set a cube down at the edge of reach, held by its edge, and let fingers shove it on.

Fingers that open beside a thing push it aside, by some centimetres each time.
"""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2, wrap
from lemma.robots.gripper import FINGER_CENTER_M, FINGER_THICKNESS_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_OFF_M = 0.0225
"""How far beside its middle a cube can be held."""
_EDGE_M = 0.0015
_FINGER_M = FINGER_CENTER_M + FINGER_THICKNESS_M / 2
_SHOVES = 7


def shove(trial: SkillTrial) -> None:
    """Play an attempt."""
    # What opening fingers can move is as far out as they and all cubes in a row.
    row_m = _FINGER_M + CUBE_EDGE_M * len(_cubes(trial))
    for on in trial.goal.conjuncts:
        support_m = kind_of(on.bottom).support_m or 0.0
        farthest = trial.reach.travel_m + row_m + support_m
        if trial.radius(trial.pose(on.bottom)) > farthest:
            raise GiveUp
    for on in trial.goal.conjuncts:
        _shove_on(trial, on)


def _cubes(trial: SkillTrial) -> list[str]:
    return [name for name in trial.state().poses if kind_of(name).cargo]


def _shove_on(trial: SkillTrial, on: On) -> None:
    if not _set_down_at_the_edge(trial, on):
        return
    for _ in range(_SHOVES):
        target = trial.pose(on.top)
        spare = [
            name
            for name in _cubes(trial)
            if name not in trial.goal.entities and trial.margin(trial.pose(name)) > 0.02
        ]
        if on.holds(trial.scene) or not spare:
            return
        out = trial.outward(target)
        behind = _FINGER_M + CUBE_EDGE_M / 2 + 0.003
        radius = min(
            trial.radius(target) - behind + CUBE_EDGE_M / 2,
            trial.reach.travel_m - _EDGE_M,
        )
        cube = trial.pose(spare[0])
        yaw = _face(cube, trial.outward(cube) + math.pi / 2)
        place = Pose2(*trial.at(radius, out), out + math.pi / 2)
        trial.move(Pose2(cube.x, cube.y, yaw), place)


def _set_down_at_the_edge(trial: SkillTrial, on: On) -> bool:
    """Carry a cube towards its goal as far as the arm goes; False if it cannot."""
    cube, bottom = trial.pose(on.top), trial.pose(on.bottom)
    if trial.margin(cube) <= _OFF_M:
        return False
    yaw = _face(cube, trial.outward(cube))
    pick = Pose2(cube.x, cube.y, yaw) @ Pose2(-_OFF_M, 0.0)
    radius = min(trial.radius(bottom) - _OFF_M, trial.reach.travel_m - _EDGE_M)
    out = trial.outward(bottom)
    return trial.move(pick, Pose2(*trial.at(radius, out), out)).ok


def _face(cube: Pose2, wanted: float) -> float:
    """Return the heading across a cube's faces that is nearest to one."""
    turns = (cube.yaw + 0.5 * math.pi * k for k in range(4))
    return min(turns, key=lambda yaw: abs(wrap(yaw - wanted)))


ATTACKS.add(
    "shove",
    Attack(
        name="shove",
        summary="Sets a cube down at the edge of reach; opening fingers shove it on.",
        level="skill",
        play=shove,
        cheap=True,
    ),
)
