"""A pool of instances in one compiled model; unused objects are parked."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray, Pose2
from lemma.motion.arm_motion import park_joints
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.objects.bodies import resting_quaternion
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, SceneSpec
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, TASKS

PARKED_M = 20.0
"""Height of parked objects, and the x of the first one [m]."""
_KINDS = ("cube", "pad")


@dataclass(frozen=True, eq=False)
class Pool:
    """Instances of one task and team, as arrays with one row for each."""

    instances: tuple[Instance, ...]
    scene: Scene
    """One compiled model with the objects of every instance."""
    slots: tuple[str, ...]
    """Kind of each object of the model."""
    goal: tuple[tuple[int, int], ...]
    """Top and bottom of each pair of the goal, as slots; -1 for the hand."""
    moved: tuple[int, ...]
    """Ids of fixed bodies whose pose depends on the instance: bases, pads."""
    geoms: tuple[int, ...]
    """Ids of the geoms of these bodies."""
    colors: tuple[tuple[str, ...], ...]
    """Color of each object of the model in each instance."""
    rows: dict[str, FloatArray]
    """``qpos``, ``base`` (n, robots, 3), ``present`` (n, slots), ``body_pos``,
    ``body_quat``, ``gravcomp`` of all bodies, ``geom_xpos``, ``geom_xmat``, ``fixed``:
    poses of pads (n, slots, 7)."""


def make_pool(task: str, team: Sequence[str] | None, count: int, seed: int) -> Pool:
    """Sample instances of the split ``free``.

    Args:
        task: Name of the task.
        team: Arm types; the task's first team if None.
        count: Number of instances.
        seed: Index of the first instance.

    Raises:
        UnknownNameError: There is no such task or arm.
        InvalidConfigError: The task has sticks, gaps, rules, or different hands.
    """
    if TASKS[task].rules or TASKS[task].hands:
        raise InvalidConfigError(
            f"Task {task!r} has rules or different hands, which are not on a GPU."
        )
    chosen = tuple(team or TASKS[task].teams[0])
    found = tuple(
        sample(TASKS[task], FREE_SPLIT, seed + i, team=chosen).instance
        for i in range(count)
    )
    kinds = {placed.kind for one in found for placed in one.scene.objects}
    if not kinds <= set(_KINDS) or any(one.scene.gap_m for one in found):
        raise InvalidConfigError(
            f"Task {task!r} has {', '.join(sorted(kinds))}. On a GPU there are only "
            "cubes and pads, and a table without a gap."
        )
    orders = [_order(one) for one in found]
    most = {k: max(len(order[k]) for order in orders) for k in _KINDS}
    slots = tuple(kind for kind in _KINDS for _ in range(most[kind]))
    colors = list(OBJECT_COLORS)
    objects = tuple(
        ObjectPlacement(kind, colors[i], Pose2(0.0, 0.0))
        for kind in _KINDS
        for i in range(most[kind])
    )
    scene = Scene(replace(found[0].scene, objects=objects))
    names = [*(f"{name}/base" for name in scene.spec.robot_names), *scene.object_names]
    movable = set(scene.movable_names)
    moved = tuple(
        int(scene.model.body(name).id) for name in names if name not in movable
    )
    owners = scene.model.geom_bodyid.tolist()
    geoms = tuple(g for g, body in enumerate(owners) if body in moved)
    first = {"cube": 0, "pad": most["cube"]}
    pairs = {
        _slots(one, order, first) for one, order in zip(found, orders, strict=True)
    }
    (goal,) = pairs
    rows: dict[str, list[Any]] = {}
    for one, order in zip(found, orders, strict=True):
        for key, value in _row(one, order, first, scene, moved, geoms).items():
            rows.setdefault(key, []).append(value)
    arrays = {key: np.array(value) for key, value in rows.items()}
    painted = tuple(
        _colors(one, order, objects) for one, order in zip(found, orders, strict=True)
    )
    return Pool(found, scene, slots, goal, moved, geoms, painted, arrays)


def _colors(
    instance: Instance,
    order: dict[str, list[str]],
    slots: Sequence[ObjectPlacement],
) -> tuple[str, ...]:
    """Return the color of each slot; that of parked objects is arbitrary."""
    found = {kind: iter(names) for kind, names in order.items()}
    names = [next(found[slot.kind], None) for slot in slots]
    return tuple(
        slot.color if name is None else instance.scene.placement(name).color
        for slot, name in zip(slots, names, strict=True)
    )


def _slots(
    instance: Instance, order: dict[str, list[str]], first: dict[str, int]
) -> tuple[tuple[int, int], ...]:
    """Return top and bottom of each pair of the goal as slots."""

    def slot(name: str) -> int:
        if name not in instance.scene.object_names:
            return -1
        kind = kind_of(name).name
        return first[kind] + order[kind].index(name)

    return tuple((slot(top), slot(bottom)) for top, bottom in instance.goal.pairs)


def _order(instance: Instance) -> dict[str, list[str]]:
    """Return the names of objects by kind, with those of the goal first."""
    names = dict.fromkeys((*instance.goal.entities, *instance.scene.object_names))
    return {kind: [n for n in names if kind_of(n).name == kind] for kind in _KINDS}


def _row(
    instance: Instance,
    order: dict[str, list[str]],
    first: dict[str, int],
    scene: Scene,
    moved: Sequence[int],
    geoms: Sequence[int],
) -> dict[str, Any]:
    spec: SceneSpec = instance.scene
    model, data = scene.model, scene.data
    qpos, present = np.zeros(model.nq), np.zeros(len(scene.object_names))
    fixed = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(present), 1))
    gravcomp = model.body_gravcomp.copy()
    for robot, placed in zip(scene.robots, spec.robots, strict=True):
        qpos[robot.qpos] = park_joints(robot.arm.name)
        qpos[list(robot.finger_qpos)] = FINGER_OPENING_M / 2
        body = int(model.body(f"{robot.name}/base").id)
        model.body_pos[body] = (*placed.base.xy, 0.0)
        model.body_quat[body] = resting_quaternion(placed.base.yaw)
    for slot, name in enumerate(scene.object_names):
        kind = kind_of(name)
        at = slot - first[kind.name]
        body, address = int(model.body(name).id), scene.qpos_of(name)
        pose = np.array([PARKED_M + slot, 0.0, PARKED_M, 1, 0, 0, 0])
        if at < len(order[kind.name]):
            there = spec.placement(order[kind.name][at]).pose
            pose[:] = (*there.xy, kind.origin_m, *resting_quaternion(there.yaw))
            present[slot] = 1.0
        elif address >= 0:
            gravcomp[body] = 1.0
        if address >= 0:
            qpos[address : address + 7] = pose
        else:
            fixed[slot] = pose
            model.body_pos[body], model.body_quat[body] = pose[:3], pose[3:]
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return {
        "qpos": qpos,
        "base": [(*placed.base.xy, placed.base.yaw) for placed in spec.robots],
        "present": present,
        "fixed": fixed,
        "gravcomp": gravcomp,
        "body_pos": model.body_pos[list(moved)].copy(),
        "body_quat": model.body_quat[list(moved)].copy(),
        "geom_xpos": data.geom_xpos[list(geoms)].copy(),
        "geom_xmat": data.geom_xmat[list(geoms)].copy(),
    }
