"""An object moved by hand during an episode."""

import math

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose, Pose2
from lemma.env.simulation import Simulation
from lemma.expert.symbolic_state import SymbolicState
from lemma.scene.objects.entity import entity_named
from lemma.scene.overlaps import check_place


def nudge(simulation: Simulation, name: str, pose: Pose2) -> None:
    """Move an object on the table, at rest, between two steps of physics.

    Args:
        simulation: Between two ticks.
        name: Of the object.
        pose: Where to put it.

    Raises:
        InvalidConfigError: It cannot be moved, or not there; nothing has moved.
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
