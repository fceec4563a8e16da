"""Sort: each of three robots has a mat of its own color, and cubes lie mixed up."""

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task


def arrange_sort(placer: ObjectPlacer) -> Goal:
    """One robot has the cube of its color; two have each other's."""
    robots = placer.robots
    colors = [robots[robot].color for robot in placer.order]
    where = (placer.order[0], placer.order[2], placer.order[1])
    cubes, pads = [], []
    for color, owner, robot in zip(colors, where, placer.order, strict=True):
        cubes.append(placer.cube(placer.only(owner), color))
        pads.append(placer.pad(placer.only(robot), color))
    return Goal(tuple(map(On, cubes, pads)))


TASKS.add(
    "sort",
    Task(
        name="sort",
        summary="Each of three cubes goes to the robot of its color, onto its mat.",
        subtasks=5,
        distractors=(0, 2),
        arrange=arrange_sort,
        layout="triangle",
        teams=(
            ("ur5",) * 3,
            ("ur5", "ur5", "ur10"),
            ("ur5", "ur10", "ur10"),
            ("ur10",) * 3,
        ),
        language=bank_for("sort"),
    ),
)
