"""Relay: a cube passes over two strips along a line of three robots."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange_relay(placer: ObjectPlacer) -> Goal:
    """The cube is at one end, its pad at the other; the ends share nothing."""
    first, *_, last = placer.order
    cube = placer.cube(placer.only(first))
    pad = placer.pad(placer.only(last))
    return Goal((On(cube, pad),))


TASKS.add(
    "relay",
    Task(
        name="relay",
        summary="A cube goes from hand to hand along three robots, onto its pad.",
        subtasks=3,
        distractors=(1, 4),
        arrange=arrange_relay,
        layout="chain",
        teams=(("ur5", "ur5", "ur5"), ("ur5", "ur10", "ur5"), ("ur5", "ur5", "ur10")),
        language=bank_for("relay"),
    ),
)
