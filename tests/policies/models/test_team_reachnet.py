"""The team's ReachNet: robots by color, scenes after moves, and orders from a plan."""

import math
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch
from batches import RASTER, drawn_batch
from hypothesis import given
from hypothesis import strategies as st

from lemma.env.view import View
from lemma.policies.interfaces import PastStep
from lemma.policies.models.team_reachnet.model import (
    TeamReachNet,
    TeamReachNetConfig,
)
from lemma.policies.models.team_reachnet.orders import next_orders
from lemma.policies.models.team_reachnet.planner import move_of, number_of
from lemma.policies.models.team_reachnet.reader import (
    wanted_of,
)
from lemma.policies.models.team_reachnet.table import (
    TeamTable,
    recalled,
    remembered,
    true_table,
)
from lemma.policies.models.team_reachnet.teams import (
    REGIONS,
    ROBOTS,
    distinct,
    members,
    move_named,
    region_name,
    region_number,
    regions_there,
)
from lemma.policies.together.interfaces import Doing, TeamInput
from lemma.scene.objects.pad import PAD
from lemma.scene.spec import ROBOT_COLORS
from lemma.tasks.subtask import STOP, Primitive, SubTask
from lemma.tasks.teams.rule import After, Together

NETWORK = TeamReachNet(TeamReachNetConfig(cell_m=RASTER.cell_m)).eval()
ENTITIES = NETWORK.entities
CARGO, TARGETS = ENTITIES.cargo, ENTITIES.stick
TEAM = ("blue", "red", "green")


def view(seed: int = 0, robots: int = 3) -> View:
    rng = np.random.default_rng(seed)
    shape = (RASTER.rows, RASTER.columns)
    return View(
        rng.integers(0, 255, (*shape, 3), np.uint8),
        rng.uniform(0.0, 0.1, shape).astype(np.float32),
        np.ones(shape, np.bool_),
        rng.normal(size=(robots, 6)),
        np.full(robots, 0.1),
    )


def asked(
    *doing: SubTask,
    past: tuple[PastStep, ...] = (),
    team: tuple[str, ...] = TEAM,
    seen: View | None = None,
) -> TeamInput:
    robots = tuple(f"{color} robot" for color in team)
    names = [f"robot_{i}" for i in range(len(team))]
    busy = {one.robot: Doing(one, 1.0) for one in doing}
    free = tuple(name for name in names if name not in busy)
    text = "Put the red cube onto the blue pad."
    return TeamInput(
        text, robots, seen or view(), past, time_s=2.0, free=free, doing=busy
    )


def move(robot: int, pick: str, place: str) -> SubTask:
    return SubTask(f"robot_{robot}", Primitive.MOVE, pick, place)


RELAY = [
    move(0, "red_cube", "shared_01"),
    move(1, "red_cube", "blue_pad"),
    move(2, "green_cube", "white_pad"),
    move(0, "white_cube", "red_pad"),
    STOP,
]


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> TeamReachNet:
    """The network with a plan that is given."""
    monkeypatch.setattr(
        NETWORK, "_planned", lambda given, view, most: (RELAY[:most], None)
    )
    return NETWORK


def ordered(network: TeamReachNet, given: TeamInput) -> list[SubTask]:
    (orders,) = network.act_together([given])
    return [decision.subtask for decision in orders.decisions]


def scene() -> TeamTable:
    """A red cube on the table, a white one on the blue pad, and three robots."""
    objects = torch.full((1, len(ENTITIES), 7), math.nan)
    for name, x, z in (
        ("red_cube", -0.3, 0.0),
        ("white_cube", 0.3, PAD.height_m),
        ("blue_pad", 0.3, 0.0),
        ("red_pad", 0.0, 0.0),
    ):
        kind = ENTITIES.kinds[ENTITIES.number(name)]
        height = z + kind.height_m - kind.top_m
        pose = (x, 0.1, height, 1.0, 0.0, 0.0, 0.0)
        objects[0, ENTITIES.number(name)] = torch.tensor(pose)
    team = torch.tensor([[color in TEAM for color in ROBOT_COLORS]])
    bases = torch.tensor([[[-0.8, 0.0, 0.0], [0, 0, 0], [0.8, 0, 0], [0, 0.9, 0]]])
    radii = torch.tensor([0.2, 0.9, 0.95]).expand(1, ROBOTS, 3)
    labels = drawn_batch(1).labels
    assert labels is not None
    labels = replace(labels, objects=objects, bases=bases)
    return true_table(labels, radii, team, torch.zeros_like(team), ENTITIES)


@given(st.integers(0, ROBOTS * CARGO * (TARGETS + len(REGIONS))))
def test_numbers_of_moves_can_be_inverted(number: int) -> None:
    one = torch.tensor([number])
    assert int(number_of(move_of(one, CARGO, TARGETS), CARGO, TARGETS)) == number


@given(st.permutations(ROBOT_COLORS), st.integers(2, ROBOTS))
def test_regions_are_named_by_the_robots_of_any_team(
    colors: list[str], size: int
) -> None:
    team = colors[:size]
    there = torch.tensor([[color in team for color in ROBOT_COLORS]])
    names = [
        region_name(int(number), team)
        for number in torch.nonzero(regions_there(there)[0])
    ]
    assert len(names) == 1 + (size * (size - 1) // 2 if size > 2 else 0)
    for name in names:
        number = region_number(name, team)
        belongs = members(there)[0, number].tolist()
        inside = {c for c, x in zip(ROBOT_COLORS, belongs, strict=True) if x}
        digits = name.removeprefix("shared").removeprefix("_")
        assert inside == ({team[int(d)] for d in digits} or set(team))


@given(st.lists(st.sampled_from(ROBOT_COLORS), min_size=2, max_size=ROBOTS))
def test_every_robot_has_a_color_of_its_own(colors: list[str]) -> None:
    found = distinct(colors)
    assert len(set(found)) == len(colors)
    for color in colors:
        assert found[colors.index(color)] == color


def test_a_plan_does_not_depend_on_the_order_of_the_team() -> None:
    # Untrained, it would see nothing and stop.
    network = deepcopy(NETWORK)
    with torch.no_grad():
        network.eye.nowhere.fill_(-50.0)
        network.planner.stop[2].bias.fill_(-50.0)  # type: ignore[operator]
    first, order = view(), (2, 0, 1)
    turned = replace(first, joints=first.joints[list(order)])
    team = tuple(TEAM[i] for i in order)
    (one,) = network.plan([asked(seen=first)])
    (two,) = network.plan([asked(seen=turned, team=team)])
    assert one.pick == two.pick != ""
    assert order[int(two.robot[-1])] == int(one.robot[-1])
    if not one.place.startswith("shared"):
        assert one.place == two.place


def test_scenes_after_moves() -> None:
    before = scene()
    red, white, blue_pad, red_pad = map(
        ENTITIES.number, ("red_cube", "white_cube", "blue_pad", "red_pad")
    )
    assert before.on()[0, white, blue_pad]
    assert not before.clear[0, blue_pad]
    after = before.moved(torch.tensor([white]), torch.tensor([red_pad]))
    assert after.on()[0, white, red_pad]
    assert after.clear[0, blue_pad]
    assert not after.clear[0, red_pad]
    tower = after.moved(torch.tensor([red]), torch.tensor([white]))
    assert tower.on()[0, red, white]
    assert tower.rise[0, red] > tower.rise[0, white] > 0
    region = len(ENTITIES) + region_number("shared_01", TEAM)
    down = tower.moved(torch.tensor([red]), torch.tensor([region]))
    assert down.rise[0, red] == 0
    assert down.clear[0, white]
    colors = [ROBOT_COLORS.index(color) for color in ("blue", "red")]
    margins = down.margins(down.xy)[0, colors, red].tolist()
    assert margins[0] == pytest.approx(margins[1], abs=1e-4)
    stopped = down.moved(torch.tensor([-1]), torch.tensor([-1]))
    assert torch.equal(stopped.xy, down.xy)
    assert torch.equal(stopped.clear, down.clear)


def test_hidden_pads_are_remembered() -> None:
    first = scene()
    pad = ENTITIES.number("blue_pad")
    hidden = first.there.clone()
    hidden[0, pad] = False
    found = remembered(replace(first, there=hidden), first)
    assert found.there[0, pad]
    assert not found.clear[0, pad]


def test_each_robot_gets_its_part_as_soon_as_what_it_needs_is_ordered(
    planned: TeamReachNet,
) -> None:
    assert ordered(planned, asked()) == RELAY[:3]
    # The first order has ended: its robot goes on.
    past = (PastStep(view(), RELAY[0]),)
    assert ordered(planned, asked(*RELAY[1:3], past=past)) == [RELAY[3]]
    # Nothing is left for the robots that are free.
    done = tuple(PastStep(view(), step) for step in RELAY[:2])
    assert ordered(planned, asked(RELAY[2], RELAY[3], past=done)) == []
    every = tuple(PastStep(view(), step) for step in RELAY[:4])
    assert ordered(planned, asked(past=every)) == [STOP]


def test_it_looks_again_after_a_failure_when_all_arms_rest(
    planned: TeamReachNet,
) -> None:
    past = (PastStep(view(), RELAY[0], "missed"),)
    assert ordered(planned, asked(RELAY[2], past=past)) == []
    assert ordered(planned, asked(past=past)) == RELAY[:1]


def test_it_stops_after_many_failures_in_a_row() -> None:
    past = tuple(PastStep(view(), RELAY[0], "missed") for _ in range(6))
    assert ordered(NETWORK, asked(past=past)) == [STOP]


def test_a_part_of_the_goal_waits_until_the_first_part_has_ended() -> None:
    steps = [
        move(0, "red_cube", "shared"),
        move(1, "red_cube", "red_pad"),
        move(2, "white_cube", "blue_pad"),
    ]
    after = After("white_cube", "blue_pad", "red_cube", "red_pad")
    robots = ("robot_0", "robot_1", "robot_2")
    assert next_orders(steps, [0, 1, 2], robots, [], None) == [0, 1, 2]
    assert next_orders(steps, [0, 1, 2], robots, [], after) == [0, 1]
    assert next_orders(steps, [2], robots, steps[:1], after) == []
    assert next_orders(steps, [2], robots, steps[:2], after) == [2]


def test_two_parts_at_the_same_time_are_ordered_at_once() -> None:
    steps = [
        move(0, "red_cube", "shared"),
        move(1, "red_cube", "red_pad"),
        move(2, "white_cube", "blue_pad"),
    ]
    rule = Together("white_cube", "blue_pad", "red_cube", "red_pad")
    robots = ("robot_0", "robot_1", "robot_2")
    assert next_orders(steps, [0, 1, 2], robots, [], rule) == [0]
    # The first one is under way, then it has ended, then its robot alone is busy.
    assert next_orders(steps, [1, 2], robots[1:], [], rule) == []
    assert next_orders(steps, [1, 2], robots, steps[:1], rule) == [1, 2]
    assert next_orders(steps, [1, 2], robots[:2], steps[:1], rule) == []
    # A plan that has one robot do both cannot keep the rule.
    alone = [move(1, "red_cube", "red_pad"), move(1, "white_cube", "blue_pad")]
    assert next_orders(alone, [0, 1], robots, [], rule) == [0]


def test_a_robot_takes_what_is_ready_before_what_waits() -> None:
    steps = [
        move(0, "red_cube", "shared_01"),
        move(1, "red_cube", "red_pad"),
        move(1, "white_cube", "blue_pad"),
    ]
    robots = ("robot_0", "robot_1")
    assert next_orders(steps, [0, 1, 2], robots, [], None) == [0, 2]
    assert next_orders(steps, [1, 2], ("robot_1",), [], None) == [2]
    assert next_orders(steps, [1, 2], ("robot_1",), steps[:1], None) == [1]


def scores(table: TeamTable, rule: tuple[str, ...] = ()) -> torch.Tensor:
    """Return the untrained network's scores for red on red and white on blue."""
    goal = (("red_cube", "red_pad"), ("white_cube", "blue_pad"))
    wanted = wanted_of([goal], [rule], [TEAM], ENTITIES, torch.device("cpu"))
    with torch.inference_mode():
        return NETWORK.planner(table, wanted.shares(TARGETS))


def best(table: TeamTable, rule: tuple[str, ...] = ()) -> SubTask:
    (chosen,) = move_of(scores(table, rule).argmax(1), CARGO, TARGETS).tolist()
    return move_named(chosen, TEAM, ENTITIES)


def test_no_move_is_planned_that_neither_goal_nor_rule_asks_for() -> None:
    table = scene()
    # White lies on blue already; red is left.
    first = best(table)
    assert first.pick == "red_cube"
    assert first.place == "red_pad" or first.place.startswith("shared")
    without = best(table, ("without", first.robot))
    assert without.robot != first.robot
    assert without.pick == "red_cube"
    red, pad = ENTITIES.number("red_cube"), ENTITIES.number("red_pad")
    move = torch.tensor([[ROBOT_COLORS.index("blue"), red, pad]])
    number = number_of(move, CARGO, TARGETS)
    kept = scores(table, ("but", "red_cube"))[0, number]
    assert kept < scores(table)[0, number] - 10.0
    done = table.moved(torch.tensor([red]), torch.tensor([pad]))
    assert best(done) == STOP


def test_a_weak_hand_is_not_given_what_is_heavy() -> None:
    table, red = scene(), ENTITIES.number("red_cube")
    weak = torch.zeros_like(table.team)
    first = best(table)
    weak[0, ROBOT_COLORS.index(TEAM[int(first.robot[-1])])] = True
    heavy = table.heavy.clone()
    heavy[0, red] = 1.0
    found = best(replace(table, weak=weak, heavy=heavy))
    assert found.pick == first.pick == "red_cube"
    assert found.robot != first.robot


def test_hidden_cubes_are_remembered_where_they_were_put() -> None:
    red, white = map(ENTITIES.number, ("red_cube", "white_cube"))
    memory = scene().moved(torch.tensor([red]), torch.tensor([white]))
    hidden = memory.there.clone()
    hidden[0, white] = False
    found = recalled(replace(memory, there=hidden), memory)
    assert found.there[0, white]
    assert found.on()[0, red, white]
    assert not found.clear[0, white]
