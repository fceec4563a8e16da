"""The paper's eight tasks: how each sets its table."""

from collections.abc import Callable

from lemma.tasks.goal import Goal, On
from lemma.tasks.language.bank import bank_for
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.subtask import Primitive
from lemma.tasks.task import TASKS, Task

_Arrange = Callable[[ObjectPlacer], Goal]

# Tasks with the same sentence have as many objects: their number tells nothing about
# the way to the goal.


def _task(
    name: str,
    summary: str,
    *,
    subtasks: int,
    distractors: tuple[int, int],
    apart: bool = False,
) -> Callable[[_Arrange], _Arrange]:
    """Return a decorator that registers the task that a function sets the table of."""

    def add(arrange: _Arrange) -> _Arrange:
        TASKS.add(
            name,
            Task(
                name=name,
                summary=summary,
                subtasks=subtasks,
                distractors=distractors,
                arrange=arrange,
                language=bank_for(name),
                apart=apart,
            ),
        )
        return arrange

    return add


@_task(
    "pass",
    "One robot hands the cube over, the other puts it on its pad.",
    subtasks=2,
    distractors=(1, 4),
)
def arrange_pass(placer: ObjectPlacer) -> Goal:
    """A cube must change sides."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.only(first))
    pad = placer.pad(placer.only(second))
    return Goal((On(cube, pad),))


@_task(
    "pass2",
    "Two cubes change sides, in opposite directions.",
    subtasks=4,
    distractors=(0, 3),
)
def arrange_pass2(placer: ObjectPlacer) -> Goal:
    """Two cubes cross the table in opposite directions."""
    first, second = placer.order[:2]
    cube_1 = placer.cube(placer.only(first))
    pad_1 = placer.pad(placer.only(second))
    cube_2 = placer.cube(placer.only(second))
    pad_2 = placer.pad(placer.only(first))
    return Goal((On(cube_1, pad_1), On(cube_2, pad_2)))


@_task(
    "stack",
    "One robot brings the lower cube, the other puts its own on top.",
    subtasks=2,
    distractors=(1, 4),
)
def arrange_stack(placer: ObjectPlacer) -> Goal:
    """The robots meet in the middle to build a tower."""
    first, second = placer.order[:2]
    bottom = placer.cube(placer.only(first))
    top = placer.cube(placer.only(second))
    return Goal((On(top, bottom),))


@_task(
    "stack2",
    "Two towers, each of one cube from either side.",
    subtasks=4,
    distractors=(0, 3),
)
def arrange_stack2(placer: ObjectPlacer) -> Goal:
    """Two towers, each built by both robots."""
    first, second = placer.order[:2]
    bottom_1 = placer.cube(placer.only(first))
    top_1 = placer.cube(placer.only(second))
    bottom_2 = placer.cube(placer.only(second))
    top_2 = placer.cube(placer.only(first))
    return Goal((On(top_1, bottom_1), On(top_2, bottom_2)))


@_task(
    "poke",
    "One robot pokes the cube over, the other puts it on its pad.",
    subtasks=3,
    distractors=(0, 3),
    apart=True,
)
def arrange_poke(placer: ObjectPlacer) -> Goal:
    """A cube that nobody reaches is pushed over with the stick."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    # Out of the first robot's way even with the stick: a raised one can push a cube up.
    pad = placer.pad(placer.only(second, tool=True))
    placer.stick(first)
    return Goal((On(cube, pad),))


@_task(
    "poke_stack",
    "One robot pokes two cubes over, the other stacks them.",
    subtasks=5,
    distractors=(0, 3),
    apart=True,
)
def arrange_poke_stack(placer: ObjectPlacer) -> Goal:
    """Two cubes are pushed over, then stacked."""
    first, second = placer.order[:2]
    top = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    bottom = placer.cube(placer.tool_only(Primitive.POKE, first, second))
    placer.stick(first)
    return Goal((On(top, bottom),))


@_task(
    "hook",
    "One robot hooks the cube and hands it over, the other has its pad.",
    subtasks=4,
    distractors=(0, 3),
)
def arrange_hook(placer: ObjectPlacer) -> Goal:
    """A cube that nobody reaches is dragged closer with the stick."""
    first, second = placer.order[:2]
    cube = placer.cube(placer.tool_only(Primitive.HOOK, first, second))
    # Out of the first robot's way even with the stick: it cannot carry a cube there.
    pad = placer.pad(placer.only(second, tool=True))
    placer.stick(first)
    return Goal((On(cube, pad),))


@_task(
    "hook_stack",
    "Each robot hooks a cube with the one stick; then they stack them.",
    subtasks=7,
    distractors=(0, 3),
)
def arrange_hook_stack(placer: ObjectPlacer) -> Goal:
    """Both robots hook a cube, with one stick between them."""
    first, second = placer.order[:2]
    top = placer.cube(placer.tool_only(Primitive.HOOK, first, second, alone=True))
    bottom = placer.cube(placer.tool_only(Primitive.HOOK, second, first, alone=True))
    placer.stick(first)
    return Goal((On(top, bottom),))
