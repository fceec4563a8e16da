"""CLIPort learns, decides each frame for itself, and says what it cannot do."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from batches import (
    TINY_STREAMS,
    drawn_batch,
    gradients,
    inputs_of,
    labels_of,
    learn_by_heart,
    part_of,
    total,
)

from lemma.core.errors import InvalidConfigError
from lemma.policies.batch import PLACES, PRIMITIVES
from lemma.policies.interfaces import Grounder
from lemma.policies.models.cliport.clip_trunk import CLIPTrunk
from lemma.policies.models.cliport.model import CLIPort, CLIPortConfig
from lemma.policies.models.cliport.poses import Poses, score_poses
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.subtask import STOP, Primitive, SubTask

TINY = CLIPortConfig(**TINY_STREAMS)


def tiny(**changes: Any) -> CLIPort:
    torch.manual_seed(0)
    return CLIPort(replace(TINY, **changes))


def test_it_learns_an_episode_by_heart() -> None:
    batch = drawn_batch(3)
    model = tiny()
    learn_by_heart(model, batch, 90)
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


def test_every_weight_has_a_gradient() -> None:
    model = tiny()
    total(model.loss(drawn_batch(3))).backward()
    for name, gradient in gradients(model).items():
        assert gradient is not None, name
        assert gradient.isfinite().all(), name


def test_stop_costs_nothing_and_changes_nothing() -> None:
    batch = drawn_batch(3)
    model = tiny().eval()
    with_stop = model.loss(batch)
    without = model.loss(part_of(batch, [0, 1]))
    for name, value in with_stop.items():
        assert value.item() == pytest.approx(without[name].item(), rel=1e-3)
    assert all(v.item() == 0.0 for v in model.loss(part_of(batch, [2])).values())


def test_a_decision_does_not_depend_on_the_others() -> None:
    batch = drawn_batch(5, stop_last=False)
    model = tiny().eval()
    with torch.inference_mode():
        together = model.poses(batch)
        alone = model.poses(part_of(batch, [3]))
        again = model.poses(batch)
    assert torch.allclose(together.pick[3], alone.pick[0], atol=1e-4)
    assert torch.allclose(together.place[3], alone.place[0], atol=1e-4)
    assert torch.equal(together.place, again.place)


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


def test_a_second_look_learns_to_undo_what_was_done_to_a_place() -> None:
    # Each frame often, so that every step sees many places near the right one.
    batch = part_of(drawn_batch(2, stop_last=False), [0, 1] * 8)
    labels = labels_of(batch)
    model = tiny()
    zoom = model.zoom
    assert zoom is not None
    image, _, sentence = model.look(batch)
    seen = (image, sentence.detach())
    with torch.no_grad():
        fit = model.place(*seen, labels.pick_pose, batch.raster)
    optimizer = torch.optim.Adam(zoom.parameters(), 3e-3)
    given = (seen, fit, labels.pick_pose)
    for _ in range(150):
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
            STOP,
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


def test_grounding_leaves_training_as_it_was() -> None:
    model = tiny().train()
    model.ground(
        inputs_of(drawn_batch(1, stop_last=False)),
        [SubTask("robot_0", Primitive.MOVE, "red_cube", "shared")],
    )
    assert model.training
    assert model.pick_text.training


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
        ({"clip_weights": "nowhere.pt"}, "no CLIP weights"),
    ],
)
def test_bad_options_are_explained(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidConfigError, match=message):
        tiny(**changes)


def saved_clip(path: Path, **extra: torch.Tensor) -> CLIPTrunk:
    """Save a narrow CLIP with random weights as OpenAI's would be; return its trunk."""
    torch.manual_seed(1)
    trunk = CLIPTrunk(8, (2, 1, 1, 1))
    for name, value in trunk.named_buffers():
        if name.endswith("running_mean"):
            value.normal_(std=0.1)
    tensors = {f"visual.{n}": v.half() for n, v in trunk.state_dict().items()}
    others = {"visual.attnpool.positional_embedding": torch.zeros(50, 8)}
    torch.save({**tensors, **others, "logit_scale": torch.tensor(1.0), **extra}, path)
    return trunk


def test_clip_weights_are_read_and_stay(tmp_path: Path) -> None:
    path = tmp_path / "clip.pt"
    trunk = saved_clip(path)
    model = tiny(clip_weights=str(path)).train()
    read = model.trunk
    assert isinstance(read, CLIPTrunk)
    assert read.widths == (32, 64, 128, 256)
    assert not any(module.training for module in read.modules())
    color = torch.rand(1, 3, 64, 96) * 2 - 1
    expected = trunk(color)
    for one, other in zip(read(color), expected, strict=True):
        assert torch.allclose(one, other, atol=0.02, rtol=0.02)
    assert [tuple(x.shape[-2:]) for x in expected] == [
        (16, 24),
        (8, 12),
        (4, 6),
        (2, 3),
    ]
    before = {n: v.clone() for n, v in read.state_dict().items()}
    learned = [p for p in model.parameters() if p.requires_grad]
    optimizer = torch.optim.Adam(learned, 1e-2)
    total(model.loss(drawn_batch(2))).backward()
    assert all(p.grad is not None for p in learned)
    optimizer.step()
    for name, value in read.state_dict().items():
        assert torch.equal(value, before[name])


def test_the_trunk_is_that_of_the_published_network() -> None:
    names = {n: tuple(v.shape) for n, v in CLIPTrunk().state_dict().items()}
    assert names["conv1.weight"] == (32, 3, 3, 3)
    assert names["conv3.weight"] == (64, 32, 3, 3)
    assert names["layer1.0.downsample.0.weight"] == (256, 64, 1, 1)
    assert names["layer3.5.conv2.weight"] == (256, 256, 3, 3)
    assert names["layer4.2.bn3.running_var"] == (2048,)
    assert "layer1.1.downsample.0.weight" not in names
    weights = sum(p.numel() for p in CLIPTrunk().parameters())
    # RN50 without its last, fully connected layer, with the deeper stem.
    assert weights == 23_527_264


@pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
def test_a_scripted_archive_is_read(tmp_path: Path) -> None:
    class Whole(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.visual = CLIPTrunk(8, (1, 1, 1, 1))

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            features: torch.Tensor = self.visual(x)[0]
            return features

    torch.manual_seed(2)
    whole = Whole()
    path = tmp_path / "RN50.pt"
    traced = torch.jit.trace(whole, torch.zeros(1, 3, 32, 32))
    torch.jit.save(traced, str(path))
    found = CLIPTrunk.load(path).state_dict()
    for name, value in whole.visual.state_dict().items():
        assert torch.equal(found[name], value)


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"visual.conv1.weight": torch.zeros(768, 3, 32, 32)}, "no ResNet of CLIP"),
        ([1, 2, 3], "no tensors by name"),
    ],
)
def test_other_weights_are_refused(
    tmp_path: Path, tensors: object, message: str
) -> None:
    path = tmp_path / "vit.pt"
    torch.save(tensors, path)
    with pytest.raises(InvalidConfigError, match=message):
        CLIPTrunk.load(path)


def test_damaged_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "clip.pt"
    path.write_bytes(b"not weights at all")
    with pytest.raises(InvalidConfigError, match="torch can read"):
        CLIPTrunk.load(path)
    saved_clip(path, **{"visual.layer1.0.conv1.weight": torch.zeros(3, 3, 1, 1)})
    with pytest.raises(InvalidConfigError, match="another shape"):
        CLIPTrunk.load(path)
