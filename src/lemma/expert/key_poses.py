"""The expert's next key poses: poses at which a gripper grasps, releases or hovers."""

from lemma.core.errors import InvalidConfigError
from lemma.core.robot_names import robot_number
from lemma.env.control.key_poses import NOWHERE, KeyPose, Kind
from lemma.env.episode import Episode
from lemma.expert.expert import Expert
from lemma.motion.outcome import SkillFailure
from lemma.motion.skills import DRAG_HEIGHT_M, SkillRunner
from lemma.scene.objects.entity import STICK, kind_of
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

_ABOVE_M = 0.05
_PRESS_M = 0.0005
_DRAGS = {Primitive.POKE: Kind.POKE, Primitive.HOOK: Kind.HOOK}


def next_key_poses(episode: Episode) -> tuple[SubTask, tuple[KeyPose, ...]]:
    """Return the expert's next sub-task and its key poses in temporal order.

    Args:
        episode: The episode in progress, with empty grippers.

    Returns:
        Sub-task and key poses; ``STOP`` and :data:`NOWHERE` if the goal holds or there
        is no plan.
    """
    subtask, grounded = Expert(episode.simulation.scene, episode.instance.goal).act()
    if grounded is None:
        return subtask, (NOWHERE,)
    return subtask, key_poses(SkillRunner(episode.simulation.arms), grounded)


def key_poses(runner: SkillRunner, subtask: GroundedSubTask) -> tuple[KeyPose, ...]:
    """Return the key poses of a grounded sub-task in temporal order.

    Args:
        runner: Skill runner of the scene.
        subtask: The sub-task.

    Returns:
        The key poses; :data:`NOWHERE` if there is no object at the pick pose.

    Raises:
        InvalidConfigError: No gripper can hold the object.
    """
    try:
        held, grip_m = runner.what_to_pick(subtask.pick)
    except SkillFailure:
        return (NOWHERE,)
    robot, pick, place = robot_number(subtask.robot), subtask.pick, subtask.place
    kind = kind_of(held)
    if kind.grasp is None:
        raise InvalidConfigError(f"No gripper can hold the {held}.")
    bottom_m = grip_m - kind.grasp.height_m

    def at_pick(what: Kind, z: float) -> KeyPose:
        return KeyPose(robot, what, pick.x, pick.y, z, pick.yaw)

    def at_place(what: Kind, z: float) -> KeyPose:
        return KeyPose(robot, what, place.x, place.y, z, place.yaw)

    if subtask.primitive is Primitive.REACH:
        return (at_pick(Kind.OVER, bottom_m + kind.height_m + _ABOVE_M),)
    if subtask.primitive is Primitive.LIFT:
        return (at_pick(Kind.PICK, grip_m),)
    if subtask.primitive in _DRAGS:
        drag = at_place(_DRAGS[subtask.primitive], DRAG_HEIGHT_M)
        return (at_pick(Kind.TAKE, grip_m), drag)
    body = runner.scene.model.body(held).id
    support_m = runner.surface(place, exclude=body)[0]
    picked = Kind.RAISE if held == STICK else Kind.PICK
    put_m = support_m + grip_m - bottom_m - _PRESS_M
    return (at_pick(picked, grip_m), at_place(Kind.PUT, put_m))
