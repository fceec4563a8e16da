"""CLIPort, of two kinds, learns, decides each frame for itself, says what it cannot."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch
from batches import (
    drawn_batch,
    inputs_of,
    labels_of,
    learn_by_heart,
    part_of,
)
from tiny_models import tiny as tiny_model

from lemma.core.errors import InvalidConfigError
from lemma.policies.batch import PRIMITIVES, STOP
from lemma.policies.entities import BENCHMARK
from lemma.policies.interfaces import Grounder
from lemma.policies.models.cliport.model import (
    Poses,
    score_poses,
)
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import Primitive, SubTask

PLACES = BENCHMARK.places

tiny, tiny_whole = partial(tiny_model, "cliport"), partial(tiny_model, "m-cliport")


@pytest.mark.slow
def test_it_learns_an_episode_by_heart() -> None:
    batch = drawn_batch(3)
    model = tiny()
    learn_by_heart(model, batch, 150)
    scores = model.score(batch)
    assert scores["grounded"][:2].tolist() == [1.0, 1.0]
    assert all(math.isnan(values[2]) for values in scores.values())
    inputs = inputs_of(batch)[:2]
    subtasks = [
        SubTask(f"robot_{robot}", Primitive.MOVE, ENTITIES[pick], PLACES[place])
        for robot, _, pick, place in labels_of(batch).decision[:2].tolist()
    ]
    for found, pick, place in zip(
        model.ground(inputs, subtasks),
        labels_of(batch).pick_pose.tolist(),
        labels_of(batch).place_pose.tolist(),
        strict=False,
    ):
        assert found is not None
        assert math.dist(found.pick.xy, pick[:2]) < 0.02
        assert math.dist(found.place.xy, place[:2]) < 0.02
        assert abs(found.place.yaw - found.pick.yaw) <= math.pi + 1e-5


def test_stop_costs_nothing_and_changes_nothing() -> None:
    batch = drawn_batch(3)
    model = tiny().eval()
    with_stop = model.loss(batch)
    without = model.loss(part_of(batch, [0, 1]))
    for name, value in with_stop.items():
        assert value.item() == pytest.approx(without[name].item(), rel=1e-3)
    assert all(v.item() == 0.0 for v in model.loss(part_of(batch, [2])).values())


def test_the_words_matter() -> None:
    batch = part_of(drawn_batch(2), [0])
    model = tiny().eval()
    other = replace(batch, sub_instructions=["white robot: hook the green cube"])
    with torch.inference_mode():
        image, *here = model.look(batch)
        _, *there = model.look(other)
        for i in range(2):
            assert not torch.allclose(here[i], there[i], atol=1e-3)
        picks = [model.pick(image, words[0]).logits for words in (here, there)]
        pose = labels_of(batch).pick_pose
        places = [
            model.place(image, words[1], pose, batch.raster).logits
            for words in (here, there)
        ]
    for one, other_maps in (picks, places):
        assert not torch.allclose(one, other_maps, atol=1e-4)


def test_a_second_look_corrects_in_the_grippers_frame() -> None:
    zoom = tiny().zoom
    assert zoom is not None
    place = torch.tensor([[0.1, -0.2, math.pi / 2], [0.0, 0.0, -3.0]])
    correction = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = zoom.corrected(place, correction)
    # A quarter turn: ahead of the gripper lies +y.
    assert found[0, 0] == pytest.approx(0.1, abs=1e-6)
    assert found[0, 1] > -0.2 + 0.01
    assert found[0, 2] == place[0, 2]
    assert found[1, :2].tolist() == [0.0, 0.0]
    assert found[1, 2] > -3.0 + 0.1


@pytest.mark.slow
def test_a_second_look_learns_to_undo_what_was_done_to_a_place() -> None:
    # Each frame often, so that every step sees many places near the right one.
    batch = part_of(drawn_batch(2, stop_last=False), [0, 1] * 8)
    labels = labels_of(batch)
    model = tiny()
    zoom = model.zoom
    assert zoom is not None
    image, _, sentence = model.look(batch)
    sentence = sentence.detach()
    with torch.no_grad():
        fit = model.place(image, sentence, labels.pick_pose, batch.raster)
    optimizer = torch.optim.Adam(zoom.parameters(), 3e-3)
    given = ((image, sentence, fit), labels.pick_pose)
    steps = 300
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = 3e-3 * (1.0 - step / steps)
        optimizer.zero_grad()
        zoom.loss(*given, labels.place_pose, batch.raster).mean().backward()
        optimizer.step()
    wrong = labels.place_pose + torch.tensor([0.02, -0.02, 0.1])
    with torch.no_grad():
        found = zoom.corrected(wrong, zoom(*given, wrong, batch.raster))
    away = (found - labels.place_pose).abs()
    assert away[:, :2].max() < 0.012
    assert away[:, 2].max() < 0.06


def test_a_second_look_is_an_option() -> None:
    batch = drawn_batch(2)
    model = tiny(zoom=False)
    assert "place_zoom" not in model.loss(batch)
    assert "place_zoom" in tiny().loss(batch)
    assert model.score(batch)["grounded"].shape == (2,)


def test_what_has_no_words_is_not_grounded() -> None:
    model = tiny()
    inputs = inputs_of(drawn_batch(1, stop_last=False)) * 5
    move = SubTask("robot_1", Primitive.MOVE, "red_cube", "shared")
    found = model.ground(
        inputs,
        [
            STOP_SUBTASK,
            SubTask("robot_0", Primitive.HOOK, "stick", "blue_pad"),
            move,
            SubTask("robot_0", Primitive.MOVE, "", ""),
            SubTask("robot_7", Primitive.MOVE, "red_cube", "shared"),
        ],
    )
    assert [f is None for f in found] == [True, True, False, True, True]
    assert found[2] is not None
    assert (found[2].robot, found[2].primitive) == ("robot_1", Primitive.MOVE)
    assert isinstance(model, Grounder)


def scored(
    pick: str, place: str, primitive: str, moved: tuple[float, ...]
) -> dict[str, float]:
    """Score the expert's poses after a change of both yaws, the place's x and yaw."""
    batch = drawn_batch(1, stop_last=False)
    labels = labels_of(batch)
    numbers = (
        0,
        PRIMITIVES.index(primitive),
        ENTITIES.index(pick),
        PLACES.index(place),
    )
    labels = replace(labels, decision=torch.tensor([numbers]))
    both, x, turn = moved
    found = Poses(
        labels.pick_pose + torch.tensor([0.0, 0.0, both]),
        labels.place_pose + torch.tensor([x, 0.0, both + turn]),
    )
    return {n: v.item() for n, v in score_poses(found, labels).items()}


@pytest.mark.parametrize(
    ("pick", "place", "primitive", "moved", "right"),
    [
        ("red_cube", "blue_pad", "move", (0.0, 0.0, 0.0), 1.0),
        ("red_cube", "blue_pad", "move", (math.pi / 2, 0.015, 1.0), 1.0),
        ("red_cube", "blue_pad", "move", (0.3, 0.0, 0.0), 0.0),
        ("red_cube", "blue_pad", "move", (0.0, 0.03, 0.0), 0.0),
        ("red_cube", "shared", "move", (0.0, 0.05, 0.0), 1.0),
        ("stick", "red_cube", "prehook", (math.pi, 0.0, 0.1), 1.0),
        ("stick", "red_cube", "prehook", (math.pi / 2, 0.0, 0.0), 0.0),
        ("stick", "red_cube", "prehook", (0.0, 0.0, 0.2), 0.0),
        ("stick", "red_cube", "prehook", (0.0, 0.0, math.pi), 0.0),
        ("stick", "red_cube", "poke", (0.1, 0.0, 0.1), 0.0),
    ],
)
def test_scores_know_the_symmetries(
    pick: str, place: str, primitive: str, moved: tuple[float, ...], right: float
) -> None:
    assert scored(pick, place, primitive, moved)["grounded"] == right


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"widths": (8, 8)}, "four levels"),
        ({"crop": 30}, "multiple of 4"),
    ],
)
def test_bad_options_are_explained(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidConfigError, match=message):
        tiny(**changes)


@pytest.mark.slow
def test_the_whole_learns_an_episode_by_heart() -> None:
    batch = drawn_batch(4)
    decision = labels_of(batch).decision.clone()
    decision[1, 1] = PRIMITIVES.index("poke")
    batch = replace(batch, labels=replace(labels_of(batch), decision=decision))
    model = tiny_whole()
    learn_by_heart(model, batch, 180)
    scores = model.score(batch)
    assert scores["right_stop"].tolist() == [1.0] * 4
    assert scores["right_robot"][:3].tolist() == [1.0] * 3
    assert scores["right_primitive"][:3].tolist() == [1.0] * 3
    assert scores["decided"][3] == 1.0
    found = model.act(inputs_of(batch))
    assert [d.subtask.robot for d in found] == ["robot_0", "robot_1", "robot_0", ""]
    assert [d.subtask.primitive for d in found] == [
        Primitive.MOVE,
        Primitive.POKE,
        Primitive.MOVE,
        Primitive.STOP,
    ]
    assert found[3].grounded is None
    for decision_found, pick in zip(
        found[:3], labels_of(batch).pick_pose.tolist(), strict=False
    ):
        grounded = decision_found.grounded
        assert grounded is not None
        assert math.dist(grounded.pick.xy, pick[:2]) < 0.03
        assert grounded.primitive is decision_found.subtask.primitive


def test_a_batch_of_stops_alone_is_fine() -> None:
    batch = part_of(drawn_batch(2), [1])
    losses = tiny_whole().loss(batch)
    assert losses["stop"] > 0
    assert all(v == 0 for n, v in losses.items() if n != "stop")


def test_a_wrong_stop_is_no_decision() -> None:
    batch = drawn_batch(2)
    model = tiny_whole()
    last = model.stop[-1]
    assert isinstance(last, torch.nn.Linear)
    for value, expected in ((50.0, [0.0, 1.0]), (-50.0, [0.0, 0.0])):
        torch.nn.init.constant_(last.bias, value)
        scores = model.score(batch)
        assert scores["right_stop"].tolist() == (
            [0.0, 1.0] if value > 0 else [1.0, 0.0]
        )
        assert scores["decided"].tolist() == expected
    assert labels_of(batch).decision[1, 1] == STOP
