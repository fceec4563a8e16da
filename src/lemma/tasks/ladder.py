"""The ladder: rungs below the paper's tasks, each with three degrees of variation.

*reach*: hold a hand over the named cube. *lift*: pick it up. *place*: put it on a pad
that the same robot reaches. *hand_over*: the paper's *pass*, with one team and one
sentence of each kind. Then come *pass*, *stack*, *poke* and *hook* as they are. On the
first two, robot 0 alone can do it; from *place* on, it is open which of two robots can.

``lift_fixed`` has the same robots in the same places in every instance, ``lift_varied``
has them drawn as for the paper's tasks, and ``lift`` has objects besides that the goal
does not need.
"""

from collections.abc import Callable
from dataclasses import replace

from lemma.tasks.goal import Goal, Lifted, On, Reached
from lemma.tasks.language.bank import bank_for
from lemma.tasks.library import arrange_pass
from lemma.tasks.names import RUNGS, rung_task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TASKS, Task

_TEAM = (("ur5", "ur5"),)
_WITHOUT = {
    "varied": "without distractors",
    "fixed": "without distractors, with robots that stand where they always do",
}


def arrange_reach(placer: ObjectPlacer) -> Goal:
    """A cube that robot 0 reaches."""
    return Goal((Reached(placer.cube(placer.only(0))),))


def arrange_lift(placer: ObjectPlacer) -> Goal:
    """A cube that robot 0 reaches."""
    return Goal((Lifted(placer.cube(placer.only(0))),))


def arrange_place(placer: ObjectPlacer) -> Goal:
    """A cube and a pad that the same one of two robots reaches."""
    able = placer.order[0]
    cube = placer.cube(placer.only(able))
    return Goal((On(cube, placer.pad(placer.only(able))),))


def _add(
    name: str,
    summary: str,
    arrange: Callable[[ObjectPlacer], Goal],
    *,
    subtasks: int = 1,
    alone: bool = False,
) -> None:
    """Register a rung of the ladder alone in full."""
    task = Task(
        name=name,
        summary=summary,
        subtasks=subtasks,
        distractors=(1, 4),
        arrange=arrange,
        language=bank_for(name),
        alone=alone,
    )
    TASKS.add(name, task if alone else replace(task, teams=_TEAM))


_add("reach", "One robot holds its hand over the cube.", arrange_reach, alone=True)
_add("lift", "One robot picks the cube up and holds it.", arrange_lift, alone=True)
_add(
    "place",
    "The robot that can puts the cube on the pad.",
    arrange_place,
    alone=True,
)
_add(
    "hand_over",
    "One robot hands the cube over, the other puts it on its pad; one team.",
    arrange_pass,
    subtasks=2,
)
for _rung in RUNGS:
    _full = TASKS[_rung]
    for _degree in ("varied", "fixed"):
        _fixed = _degree == "fixed"
        _name = rung_task(_rung, _degree)
        TASKS.add(
            _name,
            replace(
                _full,
                name=_name,
                summary=f"{_full.summary[:-1]}; {_WITHOUT[_degree]}.",
                distractors=(0, 0),
                fixed=_fixed,
                teams=_TEAM if _fixed else _full.teams,
            ),
        )
