"""The built-in tasks: the paper's eight, then those of the ladder.

Rungs of the ladder are *reach*: hold a gripper over the named cube; *lift*: pick it up;
*place*: put it on a pad that the same robot reaches; *hand_over*: the paper's *pass*
with one team and one sentence of each kind; then *pass*, *stack*, *poke* and *hook* of
the paper. In the first two, only robot 0 can solve the task; from *place* on, either
robot may be the one that can.

In every instance of ``lift_fixed`` the robots are the same and in the same places. In
``lift_varied`` they are drawn as for the paper's tasks, and ``lift`` also has
distractors.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from lemma.core.registry import calling_module
from lemma.tasks.goal import Goal, Lifted, On, Reached
from lemma.tasks.language.bank import bank_for
from lemma.tasks.names import RUNGS, rung_task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task

_Arrange = Callable[[ObjectPlacer], Goal]

# Tasks with equal sentences have equal ranges of objects, so that the number of objects
# carries no information about the plan.


def task(name: str, summary: str, **record: Any) -> Callable[[_Arrange], _Arrange]:
    """Return a decorator that registers a task with the decorated ``arrange``.

    Args:
        name: Name of the task.
        summary: One sentence for humans.
        record: Further fields of :class:`~lemma.tasks.task.Task`.

    Raises:
        InvalidConfigError: The name is taken, or a field is invalid.
    """
    module = calling_module()

    def add(arrange: _Arrange) -> _Arrange:
        made = Task(
            name=name,
            summary=summary,
            arrange=arrange,
            language=bank_for(name),
            **record,
        )
        TASKS.add(name, made, module=module)
        return arrange

    return add


@task(
    "pass",
    "One robot hands the cube over, the other puts it on its pad.",
    subtasks=2,
    distractors=(1, 4),
)
def arrange_pass(placer: ObjectPlacer) -> Goal:
    """Arrange a cube that must change sides."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.only(first))
    pad = placer.pad(placer.only(second))
    return Goal((On(cube, pad),))


@task(
    "pass2",
    "Two cubes change sides, in opposite directions.",
    subtasks=4,
    distractors=(0, 3),
)
def arrange_pass2(placer: ObjectPlacer) -> Goal:
    """Arrange two cubes that must change sides in opposite directions."""
    first, second = placer.order[:2]
    cube_1 = placer.cube(placer.only(first))
    pad_1 = placer.pad(placer.only(second))
    cube_2 = placer.cube(placer.only(second))
    pad_2 = placer.pad(placer.only(first))
    return Goal((On(cube_1, pad_1), On(cube_2, pad_2)))


@task(
    "stack",
    "One robot brings the lower cube, the other puts its own on top.",
    subtasks=2,
    distractors=(1, 4),
)
def arrange_stack(placer: ObjectPlacer) -> Goal:
    """Arrange two cubes that the robots stack in their shared region."""
    first, second = placer.order[:2]
    bottom = placer.cube(placer.only(first))
    top = placer.cube(placer.only(second))
    return Goal((On(top, bottom),))


@task(
    "stack2",
    "Two towers, each of one cube from either side.",
    subtasks=4,
    distractors=(0, 3),
)
def arrange_stack2(placer: ObjectPlacer) -> Goal:
    """Arrange cubes for two towers, each of which needs both robots."""
    first, second = placer.order[:2]
    bottom_1 = placer.cube(placer.only(first))
    top_1 = placer.cube(placer.only(second))
    bottom_2 = placer.cube(placer.only(second))
    top_2 = placer.cube(placer.only(first))
    return Goal((On(top_1, bottom_1), On(top_2, bottom_2)))


@task(
    "poke",
    "One robot pokes the cube over, the other puts it on its pad.",
    subtasks=3,
    distractors=(0, 3),
    apart=True,
)
def arrange_poke(placer: ObjectPlacer) -> Goal:
    """Arrange a cube that no robot reaches, to be pushed over with the stick."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    # Outside of the first robot's reach even with the stick, which could push a cube
    # onto the pad.
    pad = placer.pad(placer.only(second, tool=True))
    placer.stick(first)
    return Goal((On(cube, pad),))


@task(
    "poke_stack",
    "One robot pokes two cubes over, the other stacks them.",
    subtasks=5,
    distractors=(0, 3),
    apart=True,
)
def arrange_poke_stack(placer: ObjectPlacer) -> Goal:
    """Arrange two cubes to be pushed over and then stacked."""
    first, second = placer.order[:2]
    top = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    bottom = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    placer.stick(first)
    return Goal((On(top, bottom),))


@task(
    "hook",
    "One robot hooks the cube and hands it over, the other has its pad.",
    subtasks=4,
    distractors=(0, 3),
)
def arrange_hook(placer: ObjectPlacer) -> Goal:
    """Arrange a cube that no robot reaches, to be dragged closer with the stick."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.tool_only(Primitive.HOOK, first, second))
    # Outside of the first robot's reach even with the stick, which could carry a cube
    # there.
    pad = placer.pad(placer.only(second, tool=True))
    placer.stick(first)
    return Goal((On(cube, pad),))


@task(
    "hook_stack",
    "Each robot hooks a cube with the one stick; then they stack them.",
    subtasks=7,
    distractors=(0, 3),
)
def arrange_hook_stack(placer: ObjectPlacer) -> Goal:
    """Arrange one cube per robot to be hooked with the same stick."""
    first, second = placer.order[:2]
    top = placer.cube(placer.tool_only(Primitive.HOOK, first, second, alone=True))
    bottom = placer.cube(placer.tool_only(Primitive.HOOK, second, first, alone=True))
    placer.stick(first)
    return Goal((On(top, bottom),))


_TEAM = (("ur5", "ur5"),)
_alone = partial(task, subtasks=1, distractors=(1, 4), alone=True)
_WITHOUT = {
    "varied": "without distractors",
    "fixed": "without distractors, with robots that stand where they always do",
}


@_alone("reach", "One robot holds its hand over the cube.")
def arrange_reach(placer: ObjectPlacer) -> Goal:
    """Arrange a cube that only robot 0 reaches."""
    return Goal((Reached(placer.cube(placer.only(0))),))


@_alone("lift", "One robot picks the cube up and holds it.")
def arrange_lift(placer: ObjectPlacer) -> Goal:
    """Arrange a cube that only robot 0 reaches."""
    return Goal((Lifted(placer.cube(placer.only(0))),))


@_alone("place", "The robot that can puts the cube on the pad.")
def arrange_place(placer: ObjectPlacer) -> Goal:
    """Arrange a cube and a pad that the same robot reaches."""
    able = placer.order[0]
    cube = placer.cube(placer.only(able))
    return Goal((On(cube, placer.pad(placer.only(able))),))


task(
    "hand_over",
    "One robot hands the cube over, the other puts it on its pad; one team.",
    subtasks=2,
    distractors=(1, 4),
    teams=_TEAM,
)(arrange_pass)
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
