"""What visitors do to a table by hand: before an episode, and while one waits."""

import math
from dataclasses import replace

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose, Pose2
from lemma.env.simulation import Simulation
from lemma.expert.symbolic_state import SymbolicState
from lemma.scene.objects.entity import entity_named
from lemma.scene.overlaps import check_place
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.scene.table import Gap
from lemma.tasks.instance import OWN_SPLIT, Instance
from lemma.tasks.sampling import gap_beyond


def moved(instance: Instance, name: str, pose: Pose2) -> Instance:
    """Return an instance in which a robot or an object begins elsewhere.

    Args:
        instance: Any.
        name: Of the robot or object.
        pose: Where it shall stand or lie.

    Raises:
        InvalidConfigError: That is nowhere in the room.
        UnknownNameError: There is no such thing.
    """
    scene, pose = instance.scene, pose.rounded()
    if name in scene.robot_names:
        number = scene.robot_names.index(name)
        robots = tuple(
            replace(robot, base=pose) if i == number else robot
            for i, robot in enumerate(scene.robots)
        )
        spec = replace(scene, robots=robots, gap_m=_gap_for(scene, robots))
    else:
        placed = scene.placement(name)
        objects = tuple(
            replace(placed, pose=pose) if other is placed else other
            for other in scene.objects
        )
        spec = replace(scene, objects=objects)
    return replace(instance, scene=spec, split=OWN_SPLIT)


def _gap_for(before: SceneSpec, robots: tuple[RobotPlacement, ...]) -> Gap | None:
    """Return the gap of a table, moved along with the robot that it keeps away."""
    gap = before.gap_m
    if gap is None or len(robots) != 2:
        return gap
    user = min(
        (0, 1), key=lambda robot: abs(gap_beyond(before.robots, robot)[0] - gap[0])
    )
    return gap_beyond(robots, user)


def nudge(simulation: Simulation, name: str, pose: Pose2) -> None:
    """Lay an object elsewhere on the table, at rest, between two steps of physics.

    Args:
        simulation: Nothing of it runs meanwhile.
        name: Of the object.
        pose: Where it shall lie.

    Raises:
        InvalidConfigError: It cannot be taken, or not be laid there; nothing has moved.
    """
    scene = simulation.scene
    _check_free(simulation, name)
    before, kind = scene.snapshot(), entity_named(name).kind
    half = pose.yaw / 2.0
    turned = (math.cos(half), 0.0, 0.0, math.sin(half))
    scene.set_pose(name, Pose((pose.x, pose.y, kind.origin_m), turned))
    try:
        check_place(scene, name)
    except InvalidConfigError:
        scene.restore(before)
        raise


def _check_free(simulation: Simulation, name: str) -> None:
    scene, phrase = simulation.scene, entity_named(name).phrase
    if name not in scene.movable_names:
        raise InvalidConfigError(
            f"The {phrase} is fixed. It is moved before an episode or after it."
        )
    if name in simulation.held().values():
        raise InvalidConfigError(f"The {phrase} is in a gripper. Wait until it is not.")
    above = SymbolicState.observe(scene).on_top_of(name)
    if above is not None:
        raise InvalidConfigError(
            f"The {entity_named(above).phrase} lies on the {phrase}. Move that first."
        )
