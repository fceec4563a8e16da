"""ReachNet's memory of things that are hidden now, and its reading of marks."""

import copy
import math
from collections.abc import Mapping
from typing import Any

import pytest
import torch
from batches import drawn_batch, inputs_of
from tiny_models import tiny
from torch import Tensor

from lemma.motion.outcome import Outcome
from lemma.policies.entities import BENCHMARK
from lemma.policies.interfaces import PastStep, PolicyInput
from lemma.policies.models.grid import Cells
from lemma.policies.models.reachnet.marks import STRIDE, Marks, read_points
from lemma.policies.models.reachnet.memory import Memory, Sighting
from lemma.policies.models.reachnet.scene_table import HEADING_M, SceneTable
from lemma.scene.objects.pad import PAD_THICKNESS_M
from lemma.scene.raster import RASTER
from lemma.tasks.subtask import Primitive, SubTask

Seen = Mapping[str, tuple[float, float, float]]
"""Probability and position [m] of each entity that is not just absent."""
RED, BLUE, PAD, STICK = "red_cube", "blue_cube", "green_pad", "stick"
AT, OFF, NOWHERE = (0.4, 0.2), (-0.9, 0.3), (1.7, -1.7)
CUBE_M = 0.05


def sighting(seen: Seen, tops: Mapping[str, float] | None = None) -> Sighting:
    """Return what a view shows, with a cube's height for all cubes."""
    count = len(BENCHMARK)
    shares, xy = (
        torch.full((1, count), 0.001),
        torch.tensor(NOWHERE).repeat(1, count, 1),
    )
    top = (torch.arange(count) < BENCHMARK.cargo)[None] * CUBE_M
    for name, (share, *at) in seen.items():
        number = BENCHMARK.number(name)
        shares[0, number], xy[0, number] = share, torch.tensor(at)
    for name, height_m in (tops or {}).items():
        top[0, BENCHMARK.number(name)] = height_m
    table = SceneTable(
        present=shares >= 0.5,
        xy=xy,
        yaw=torch.zeros(1, count),
        top=top,
        bases=torch.zeros(1, 2, 2),
        radii=torch.ones(1, 2, 3),
        ground=torch.ones(1, 128),
    )
    return Sighting(table, shares, shares)


def recalled(views: list[Sighting], steps: list[tuple[SubTask, Outcome]]) -> Sighting:
    """Return what is known at the last view, after sub-tasks between the views."""
    looks = [given.view for given in inputs_of(drawn_batch(len(views)))]
    memory = Memory()
    memory.update(zip(looks, views, strict=True))
    past = tuple(
        PastStep(view, subtask, outcome)
        for view, (subtask, outcome) in zip(looks, steps, strict=False)
    )
    return memory.recall(PolicyInput("", ("red robot", "white robot"), looks[-1], past))


def place(found: Sighting, name: str, named: tuple[str, ...] = ()) -> Any:
    """Return the position of an entity in the scene; None if it is not there."""
    numbers = torch.tensor([[BENCHMARK.number(one) for one in named] or [-1]])
    table, number = found.table_with(numbers), BENCHMARK.number(name)
    if not table.present[0, number]:
        return None
    return pytest.approx(tuple(table.xy[0, number].tolist()), abs=1e-6)


def move(pick: str, target: str) -> SubTask:
    return SubTask("robot_0", Primitive.MOVE, pick, target)


DONE, OTHER = Outcome.SUCCESS, move(BLUE, "shared")


def test_what_an_arm_hides_is_where_it_was_seen() -> None:
    views = [sighting({RED: (0.9, *AT)}), sighting({}), sighting({RED: (0.01, *OFF)})]
    found = recalled(views, [(OTHER, DONE)] * 2)
    assert place(found, RED) == AT
    assert place(found, BLUE) is None
    assert found.noticed[0, BENCHMARK.number(RED)]


def test_what_is_seen_now_is_where_it_is_seen() -> None:
    views = [sighting({RED: (1.0, *AT)}), sighting({RED: (0.6, *OFF)})]
    assert place(recalled(views, [(OTHER, DONE)]), RED) == OFF


@pytest.mark.parametrize(
    ("subtask", "outcome", "known"),
    [
        (move(RED, "shared"), Outcome.SUCCESS, False),
        (move(RED, PAD), Outcome.DROPPED, False),
        (move(RED, PAD), Outcome.UNREACHABLE, True),
        (move(RED, PAD), Outcome.NOTHING_TO_PICK, False),
        (SubTask("robot_0", Primitive.HOOK, STICK, RED), Outcome.SUCCESS, False),
        (SubTask("robot_0", Primitive.PREHOOK, STICK, RED), Outcome.SUCCESS, True),
        (SubTask("", Primitive.STOP, "", ""), Outcome.STOPPED, True),
    ],
)
def test_what_was_moved_is_not_where_it_was(
    subtask: SubTask, outcome: Outcome, known: bool
) -> None:
    views = [sighting({RED: (1.0, *AT), STICK: (1.0, *OFF)}), sighting({})]
    found = recalled(views, [(subtask, outcome)])
    assert (place(found, RED) is not None) is known
    held = subtask.pick != STICK
    assert (place(found, STICK) is not None) is held


def test_what_was_put_onto_something_is_there() -> None:
    first = sighting({RED: (1.0, *OFF), PAD: (1.0, *AT), BLUE: (1.0, 0.0, 0.0)})
    # The new view has a guess for the cube that is far off.
    second = sighting({RED: (0.04, 1.5, 1.5), BLUE: (1.0, 0.0, 0.0)})
    found = recalled([first, second], [(move(RED, PAD), DONE)])
    assert place(found, RED, (RED, PAD)) == AT
    # Things under others count as absent, as in training.
    assert place(found, PAD, (RED, PAD)) is None
    tower = recalled(
        [first, second, sighting({})],
        [(move(RED, PAD), DONE), (move(BLUE, RED), DONE)],
    )
    assert place(tower, BLUE) == AT
    assert place(tower, RED) is None
    tops = tower.table.top[0, [BENCHMARK.number(RED), BENCHMARK.number(BLUE)]]
    low_m = PAD_THICKNESS_M
    assert tops.tolist() == pytest.approx([low_m + CUBE_M, low_m + 2 * CUBE_M])


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize(("share", "used"), [(0.04, True), (0.02, False)])
def test_a_faint_thing_counts_if_it_is_named(
    share: float, used: bool, named: bool
) -> None:
    """The likeliest place of all views since it was moved counts."""
    views = [sighting({RED: (0.01, *OFF)}), sighting({RED: (share, *AT)}), sighting({})]
    found = recalled(views, [(OTHER, DONE)] * 2)
    at = place(found, RED, (RED,) if named else (BLUE,))
    assert at == (AT if used and named else None)


def test_a_thing_under_another_one_is_not_elsewhere() -> None:
    """Else a cube below would be looked for where its color is seen, too."""
    before = sighting({RED: (1.0, *AT), BLUE: (1.0, *OFF)})
    after = sighting({RED: (0.05, *OFF), BLUE: (1.0, *AT)}, {BLUE: 2 * CUBE_M})
    found = recalled([before, after], [(move(BLUE, RED), DONE)])
    assert place(found, RED, (RED, BLUE)) is None
    assert place(found, BLUE) == AT


def test_views_are_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    model, looked = tiny("reachnet").eval(), []
    see = model.eye.forward

    def counted(batch: Any) -> tuple[Marks, Tensor]:
        looked.append(len(batch))
        return see(batch)

    monkeypatch.setattr(model.eye, "forward", counted)
    inputs = inputs_of(drawn_batch(3))
    first = model.act(inputs)
    model.understand(inputs)
    assert looked == [3]
    later = inputs[0].with_past((PastStep(inputs[1].view, OTHER),))
    model.act([later, *inputs_of(drawn_batch(1, seed=5))])
    assert looked == [3, 1]
    # Decisions are functions of the input: a copy has seen nothing of it before.
    other = copy.deepcopy(model)
    assert len(other._memory) == 0
    ((kept,), (fresh,)) = model.act([later]), other.act([later])
    assert kept.subtask == fresh.subtask
    del looked[2:]
    with torch.no_grad():
        next(model.eye.parameters()).add_(0.0)
    assert model.act(inputs) == first
    assert looked == [3, 1, 3]


@pytest.mark.parametrize("hidden", [0, 1])
def test_the_stick_has_its_length(hidden: int) -> None:
    """The wrong end is a little likelier, where an arm hides the right one."""
    cells, stick = Cells.of(RASTER, STRIDE), BENCHMARK.stick
    yaw = 0.7
    ends = [AT, (AT[0] + HEADING_M * math.cos(yaw), AT[1] + HEADING_M * math.sin(yaw))]
    count = stick + 4
    points = torch.full((1, count, len(cells) + 1), -20.0)
    offsets = torch.zeros(1, count, 2, len(cells))
    for end, at in enumerate(ends):
        xy = torch.tensor(at)
        cell = int(cells.holding(xy))
        points[0, stick + end, cell] = -1.0
        offsets[0, stick + end, :, cell] = cells.continuous(xy) % 1.0 - 0.5
        if end == hidden:
            wrong = xy + torch.tensor([math.cos(yaw), math.sin(yaw)]) * 0.07
            points[0, stick + end, int(cells.holding(wrong))] = -0.5
    marks = Marks(
        points, offsets, torch.zeros(0), torch.zeros(0), (cells.rows, cells.columns)
    )
    found = read_points(marks, stick, HEADING_M, RASTER)[0, stick : stick + 2]
    assert found.tolist() == [pytest.approx(at, abs=1e-4) for at in ends]
