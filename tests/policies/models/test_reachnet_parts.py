"""ReachNet's parts: sub-tasks as numbers, tables, drags, spots, and reading."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from lemma.core.poses import Pose2
from lemma.policies.batch import PRIMITIVES
from lemma.policies.entities import BENCHMARK
from lemma.policies.models.reachnet.drags import SIGNS, TRAVELS_M, TURNS_RAD
from lemma.policies.models.reachnet.goal_reader import (
    GoalReader,
    ReaderConfig,
)
from lemma.policies.models.reachnet.grounder import ReachNetGrounder
from lemma.policies.models.reachnet.planner import (
    PlannerConfig,
    ReachNetPlanner,
    decision_of,
    number_of,
)
from lemma.policies.models.reachnet.scene_table import (
    BAR_M,
    COLUMNS,
    FAR_M,
    GRASP_M,
    HEADING_M,
    SceneTable,
    folded,
    turned,
    turned_numbers,
)
from lemma.policies.models.reachnet.understanding import goal_numbers
from lemma.policies.models.reachnet.utility import DragUtility
from lemma.policies.text.refusals import REASON_NAMES
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.drags import stick_gap

CPU = torch.device("cpu")

# Small networks: several threads would only wait for each other.
torch.set_num_threads(1)

SHARED = BENCHMARK.shared
CUBE, OTHER, PAD = (ENTITIES.index(f"red_{kind}") for kind in ("cube", "cube", "pad"))
OTHER += 1
MOVE, PREHOOK, HOOK, PREPOKE, POKE, STOP = range(6)


def table(**places: tuple[float, float, float]) -> SceneTable:
    """Return one scene; entities by name, as x, y, yaw."""
    count = len(ENTITIES)
    present = torch.zeros(1, count, dtype=torch.bool)
    xy, yaw = torch.full((1, count, 2), FAR_M), torch.zeros(1, count)
    top = torch.zeros(1, count)
    for name, (x, y, turn) in places.items():
        i = ENTITIES.index(name)
        present[0, i], xy[0, i], yaw[0, i] = True, torch.tensor([x, y]), turn
        top[0, i] = 0.05 if name.endswith("cube") else 0.0
    return SceneTable(
        present=present,
        xy=xy,
        yaw=yaw,
        top=top,
        bases=torch.tensor([[[-0.7, 0.0], [0.7, 0.0]]]),
        radii=torch.tensor([[[0.17, 0.8, 0.85]] * 2]),
        ground=torch.ones(1, COLUMNS),
    )


def row(*numbers: int) -> Tensor:
    return torch.tensor([numbers])


def test_the_point_that_shows_the_yaw_of_a_stick_is_nearer_than_what_it_hooks() -> None:
    # A hooked cube touches the bar from inside; cubes are on the map, the bar may not.
    assert 0.5 < HEADING_M <= GRASP_M + BAR_M[0] - CUBE_EDGE_M


def test_every_sub_task_has_one_number() -> None:
    numbers = torch.arange(5 * 11 * 2 + 4 * 5 * 2 + 2 + 1)
    decisions = decision_of(numbers, 2)
    assert number_of(decisions, 2).tolist() == numbers.tolist()
    stick = BENCHMARK.stick
    assert {
        *((0, MOVE, CUBE, PAD), (1, MOVE, CUBE, SHARED), (1, MOVE, stick, SHARED)),
        *((0, PREHOOK, stick, CUBE), (1, POKE, stick, OTHER), (-1, STOP, -1, -1)),
    } <= {tuple(d) for d in decisions.tolist()}


def test_turning_twice_changes_nothing() -> None:
    one = table(red_cube=(0.1, 0.2, 0.3), stick=(-0.2, 0.1, 1.0))
    two = turned(turned(one))
    torch.testing.assert_close(two.xy, one.xy)
    torch.testing.assert_close(two.bases, one.bases)
    assert math.cos(float(two.yaw[0, BENCHMARK.stick]) - 1.0) == pytest.approx(1.0)
    decision = row(1, MOVE, CUBE, PAD)
    assert turned_numbers(decision, 2).tolist() == [[0, MOVE, CUBE, PAD]]
    assert turned_numbers(row(-1, STOP, -1, -1), 2).tolist() == [[-1, STOP, -1, -1]]


def test_a_square_looks_the_same_after_a_quarter_turn() -> None:
    yaws = torch.linspace(-7, 7, 50)
    torch.testing.assert_close(
        (4 * folded(yaws, math.pi / 2)).cos(), (4 * yaws).cos(), atol=1e-5, rtol=1e-5
    )
    assert folded(yaws, math.pi / 2).abs().max() <= math.pi / 4 + 1e-6


def test_margins_are_distances_to_the_edges_of_reach() -> None:
    scene = table()
    margins = scene.margins(torch.tensor([[[-0.6, 0.0], [-0.7, 0.5], [0.7, 0.75]]]))
    torch.testing.assert_close(margins[0, 0, :2], torch.tensor([-0.07, 0.3]))
    torch.testing.assert_close(margins[0, 1, 2], torch.tensor(0.05))


def test_drags_keep_the_cube_where_the_stick_has_it() -> None:
    scene = table(red_cube=(0.1, 0.2, 0.0), stick=(-0.2, -0.4, 0.0))
    utility = DragUtility()
    drags = utility.drags(scene, torch.tensor([[CUBE]]))
    shape = (1, 2, len(SIGNS), 1, len(TURNS_RAD))
    assert drags.bearings.shape == shape
    assert utility(drags).shape == (*shape, len(TRAVELS_M))
    straight = len(TURNS_RAD) // 2
    # A hook is pulled to the robot's own base, what is poked goes to the other's.
    for side, along in enumerate((math.atan2(0.2, 0.8), math.atan2(-0.2, 0.6))):
        bearing = float(drags.bearings[0, 0, side, 0, straight])
        assert bearing == pytest.approx(along)
        x, y = drags.prepared[0, 0, side, 0, straight].tolist()
        local = Pose2(x, y, bearing).inverse() @ Pose2(0.1, 0.2)
        ready = utility.ready(scene.traits.drag_m[CUBE])[side].tolist()
        assert (local.x, local.y) == pytest.approx(tuple(ready), abs=1e-5)


def test_room_is_measured_from_the_whole_way_of_the_stick() -> None:
    scene = table(red_cube=(0.0, 0.0, 0.0), white_cube=(0.05, 0.25, 0.0))
    utility = DragUtility()
    drags = utility.drags(scene, torch.tensor([[CUBE]]))
    turn, length, side = 4, 6, 1
    x, y = drags.prepared[0, 0, side, 0, turn].tolist()
    bearing = float(drags.bearings[0, 0, side, 0, turn])
    nearest = math.inf
    for i in range(101):
        along = TRAVELS_M[length] * i / 100
        grip = Pose2(x, y, bearing) @ Pose2(along, 0.0)
        nearest = min(nearest, stick_gap(grip @ Pose2(-0.05, 0.0), 0.05, 0.25))
    room = float(drags.constraints[0, 0, side, 0, turn, length, 4])
    assert room == pytest.approx(nearest - 0.036, abs=0.003)


def test_what_nobody_reaches_is_worth_less() -> None:
    utility = DragUtility()
    near = table(red_cube=(-0.1, 0.5, 0.0))
    far = table(red_cube=(0.0, 1.1, 0.0))
    cube = torch.tensor([[CUBE]])
    worth = [utility.values(utility.drags(t, cube))[..., 2].max() for t in (near, far)]
    assert worth[0] > worth[1]


def test_a_cube_is_grasped_by_its_faces_with_room_for_the_fingers() -> None:
    grounding = ReachNetGrounder(use_reach=True)
    move = row(0, MOVE, CUBE, SHARED)
    pick, _ = grounding(table(red_cube=(0.0, 0.0, 0.3)), move)
    assert pick[0].tolist() == pytest.approx([0.0, 0.0, 0.3], abs=1e-5)
    # The natural grasp would put a finger into the neighbour.
    tight = table(red_cube=(0.0, 0.0, 0.3), white_cube=(-0.018, 0.06, 0.3))
    pick, _ = grounding(tight, move)
    assert float(pick[0, 2]) == pytest.approx(0.3 + math.pi / 2, abs=1e-5)


def test_stacked_cubes_have_their_faces_aligned() -> None:
    scene = table(red_cube=(-0.3, 0.2, 0.4), white_cube=(0.0, -0.2, 0.1))
    _, place = ReachNetGrounder(use_reach=True)(scene, row(0, MOVE, CUBE, OTHER))
    assert place[0, :2].tolist() == pytest.approx([0.0, -0.2], abs=1e-5)
    off = folded(place[0, 2] - 0.1, math.pi / 2)
    assert float(off) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(("primitive", "sign"), [(HOOK, -1.0), (POKE, 1.0)])
def test_drags_go_along_the_stick(primitive: int, sign: float) -> None:
    scene = table(red_cube=(0.2, 0.1, 0.0), stick=(-0.3, 0.0, 0.2))
    pick, place = ReachNetGrounder(use_reach=True)(
        scene, row(0, primitive, BENCHMARK.stick, CUBE)
    )
    step = place[0, :2] - pick[0, :2]
    axis = torch.tensor([math.cos(0.2), math.sin(0.2)])
    length = sign * float(step @ axis)
    assert min(TRAVELS_M) - 1e-4 <= length <= max(TRAVELS_M) + 1e-4
    torch.testing.assert_close(step, sign * length * axis, atol=1e-5, rtol=1e-5)
    assert pick[0, 0] == pytest.approx(-0.3 + 0.05 * math.cos(0.2), abs=1e-5)


@pytest.mark.parametrize("primitive", [HOOK, POKE])
def test_no_drag_ends_where_the_robot_cannot_follow(primitive: int) -> None:
    grounding = ReachNetGrounder(use_reach=True)
    # Grasped 20 cm inside either edge of reach.
    x = -0.15 if primitive == POKE else -0.33
    scene = table(red_cube=(x + 0.5, 0.05, 0.0), stick=(x, 0.0, 0.0))
    _, place = grounding(scene, row(0, primitive, BENCHMARK.stick, CUBE))
    assert scene.margins(place[None, :, :2])[0, 0, 0] > 0.0


def test_what_is_not_seen_has_no_pose() -> None:
    grounding = ReachNetGrounder(use_reach=True)
    scene = table(red_cube=(0.0, 0.0, 0.0))
    for decision in ((0, MOVE, OTHER, SHARED), (0, MOVE, CUBE, PAD), (-1, 5, -1, -1)):
        pick, place = grounding(scene, row(*decision))
        assert pick.isnan().all()
        assert place.isnan().all()


def test_spots_move_out_of_the_way() -> None:
    grounding = ReachNetGrounder(use_reach=True)
    for obstacle in ((0.0, 0.0, 0.0), (0.02, 0.1, 0.0), (0.0, -0.1, 0.0)):
        scene = table(red_cube=(-0.4, 0.3, 0.0), white_cube=obstacle)
        _, place = grounding(scene, row(0, MOVE, CUBE, SHARED))
        apart = math.dist(place[0, :2].tolist(), obstacle[:2])
        assert apart > 0.05


def test_colors_are_all_the_same_to_the_planner() -> None:
    torch.manual_seed(0)
    planner = ReachNetPlanner(
        PlannerConfig(width=32, layers=1, heads=2), 2, True
    ).eval()
    drags = DragUtility()
    past = torch.full((1, 12, 4), -1)
    places = {"a": (0.1, 0.2, 0.3), "b": (-0.3, 0.1, 0.0), "c": (0.2, -0.3, 0.0)}
    best = []
    for one, two, pad in (("red", "white", "blue"), ("green", "pink", "white")):
        scene = table(
            **{
                f"{one}_cube": places["a"],
                f"{two}_cube": places["b"],
                f"{pad}_pad": places["c"],
            }
        )
        goal = goal_numbers([((f"{one}_cube", f"{pad}_pad"),)], CPU)
        scores = planner(scene, goal, past, drags)
        best.append(scores.topk(12).values)
    torch.testing.assert_close(best[0], best[1])


SMALL = ReaderConfig(width=32, layers=1, heads=2, dropout=0.0)


def practised(
    texts: list[str], goals: Tensor, reasons: Tensor | None = None, steps: int = 60
) -> GoalReader:
    torch.manual_seed(0)
    reader = GoalReader(SMALL)
    optimizer = torch.optim.Adam(reader.parameters(), lr=5e-3)
    for _ in range(steps):
        optimizer.zero_grad()
        reader.loss(texts, goals, reasons).backward()
        optimizer.step()
    return reader.eval()


def test_goals_are_read_after_some_practice_in_any_colors() -> None:
    texts = [
        "Put the red cube onto the blue pad",
        "Stack the pink cube on the white cube",
        "The white pad: red cube. The red pad: pink cube",
    ]
    goals = goal_numbers(
        [
            (("red_cube", "blue_pad"),),
            (("pink_cube", "white_cube"),),
            (("pink_cube", "red_pad"), ("red_cube", "white_pad")),
        ],
        CPU,
    )
    reader = practised(texts, goals)
    # Pairs come in the order in which they are named.
    want = [*goals[:2].tolist(), goals[2].flip(0).tolist()]
    assert reader.read(texts)[0].tolist() == want
    other = [text.replace("white", "green").upper() for text in texts]
    white, green = (ENTITIES.index(f"{color}_cube") for color in ("white", "green"))
    moved = torch.tensor(want)
    other_color = (moved >= 0) & (moved % 5 == white)
    moved = torch.where(other_color, moved - white + green, moved)
    assert reader.read(other)[0].tolist() == moved.tolist()
    for text, changed in zip(texts, other, strict=True):
        both = reader([text, changed]).sort(1).values
        torch.testing.assert_close(both[0], both[1])


@pytest.mark.slow
def test_what_is_on_the_table_tells_what_is_meant() -> None:
    texts = ["Red cube onto blue pad", "Red cube onto blue cube"] * 2
    goals = goal_numbers(
        [(("red_cube", f"blue_{kind}"),) for kind in ("pad", "cube")] * 2, CPU
    )
    reader = practised(texts, goals)
    present = torch.zeros(2, len(ENTITIES), dtype=torch.bool)
    present[:, ENTITIES.index("red_cube")] = True
    for row, kind in enumerate(("pad", "cube")):
        present[row, ENTITIES.index(f"blue_{kind}")] = True
    unclear = ["red cube onto blue"] * 2
    assert reader.read(unclear, present)[0].tolist() == goals[:2].tolist()


def test_goals_of_any_sentence_can_be() -> None:
    torch.manual_seed(1)
    config = ReaderConfig(width=16, layers=1, heads=2, refuses=False)
    reader = GoalReader(config).eval()
    texts = [f"word {i} red blue, pink <- red / white" for i in range(40)]
    goals, _ = reader.read([*texts, "?!", "xyzzy", "red " * 100])
    top, bottom = goals[..., 0], goals[..., 1]
    assert (top < 5).all()
    assert ((top == bottom) == (top == -1)).all()
    assert (goals[:, 0] >= 0).all()
    assert (top[:, 0] != top[:, 1]).all()


@pytest.mark.parametrize("silence", ["", " \n", "é"])
def test_who_says_nothing_asks_for_nothing(silence: str) -> None:
    torch.manual_seed(1)
    reader = GoalReader(SMALL).eval()
    found = reader.weigh([silence, "red cube onto blue pad"])
    assert (found.goals[0] == -1).all()
    assert found.reasons[0] == -1
    assert found.shares[0, 0] == 1.0
    assert (found.goals[1, 0, 0] >= 0).all()
    guessing = GoalReader(replace(SMALL, guesses=True, refuses=False)).eval()
    assert (guessing.read([silence])[0][0, 0] >= 0).all()


def test_a_sentence_is_refused_with_its_reason_after_some_practice() -> None:
    texts = ["put the red cube on the blue pad", "is the red cube on the blue pad ?"]
    goals = goal_numbers([(("red_cube", "blue_pad"),), ()], CPU)
    reasons = torch.tensor([-1, REASON_NAMES.index("question")])
    reader = practised(texts, goals, reasons)
    read, refused = reader.read(texts)
    assert refused.tolist() == reasons.tolist()
    assert read[0].tolist() == goals[0].tolist()
    assert (read[1] == -1).all()
    found = reader.weigh(texts)
    assert found.refused[1] > 0.5 > found.refused[0]
    # It is one distribution, of goals and of reasons.
    torch.testing.assert_close(reader(texts).exp().sum(1), torch.ones(2))
    reader.config = replace(reader.config, temperature=3.0)
    assert 0.0 < reader.weigh(texts).refused[1] < found.refused[1]


def test_every_weight_of_the_reader_is_trained() -> None:
    torch.manual_seed(0)
    reader = GoalReader(SMALL)
    goals = goal_numbers([(("red_cube", "blue_pad"),)], CPU)
    reader.loss(["put red on the blue mat"], goals).backward()
    for name, weight in reader.named_parameters():
        assert weight.grad is not None, name
        assert weight.grad.abs().sum() > 0, name


def test_primitives_are_numbered_as_these_tests_say() -> None:
    names = ("move", "prehook", "hook", "prepoke", "poke", "stop")
    assert names == PRIMITIVES
