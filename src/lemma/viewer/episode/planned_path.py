"""Where a hand is to go in a sub-task: the waypoints of its skill."""

from lemma.env.simulation import Simulation
from lemma.motion.skills import DRAG_HEIGHT_M, stand_at
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.tasks.subtask import GroundedSubTask, Primitive

Waypoints = tuple[tuple[float, float, float], ...]
"""Points of the hand, oldest first [m]."""

_DRAGS = (Primitive.HOOK, Primitive.POKE)


def planned_path(simulation: Simulation, grounded: GroundedSubTask) -> Waypoints:
    """Return where a hand goes from where it is now: over, down, and on.

    An arm keeps away from what is around, so it goes beside these lines where it must.

    Args:
        simulation: As it is before the sub-task.
        grounded: The sub-task; a robot that is not there goes nowhere.
    """
    arm = simulation.arms.get(grounded.robot)
    if arm is None:
        return ()
    x, y, z = arm.tcp_pose()[:3, 3].tolist()
    pick, place = grounded.pick, grounded.place
    drags = grounded.primitive in _DRAGS
    low = DRAG_HEIGHT_M
    stands = [
        stand_at(pick, TRAVEL_HEIGHT_M),
        stand_at(pick, low),
        *([] if drags else [stand_at(pick, TRAVEL_HEIGHT_M)]),
        *([] if drags else [stand_at(place, TRAVEL_HEIGHT_M)]),
        stand_at(place, low),
    ]
    return ((x, y, z), *((stand[0], stand[1], stand[2]) for stand in stands))
