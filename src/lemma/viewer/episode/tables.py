"""Tables that visitors have changed before an episode."""

from dataclasses import replace

from lemma.core.poses import Pose2
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
