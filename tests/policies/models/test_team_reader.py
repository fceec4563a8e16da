"""The team's reader: rules as numbers, consistent goals, and places as in sentences."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from batches import drawn_batch
from hypothesis import given, settings
from hypothesis import strategies as st
from relational_reader import readings

import teach_a_reader
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.policies.batch import Batch
from lemma.policies.entities import BENCHMARK as ENTITIES
from lemma.policies.models.team_reachnet.model import TeamReachNet
from lemma.policies.models.team_reachnet.places import Places, places_in
from lemma.policies.models.team_reachnet.reader import (
    RULES,
    Reading,
    named_entities,
    rule_of_times,
    wanted_of,
)
from lemma.policies.models.team_reachnet.table import true_table
from lemma.policies.models.team_reachnet.teams import ROBOTS, distinct
from lemma.policies.text.places import relational_in
from lemma.policies.training.augmentation import move
from lemma.policies.training.config import Augmentation, TrainingConfig
from lemma.policies.training.loop import train
from lemma.policies.training.recoloring import permute_colors
from lemma.policies.weights import load_model
from lemma.scene.spec import ROBOT_COLORS, ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import ORDINALS, robot_phrases
from lemma.tasks.language.relational import describe, speaks_of_places, things_in
from lemma.tasks.suite import load_instance

CARGO, TARGETS = ENTITIES.cargo, ENTITIES.stick
TEAM = ("blue", "red", "green")
_NOUNS = [kind.name for kind in ENTITIES.kinds[:TARGETS]] + ["robot"] * ROBOTS
KINDS = torch.tensor([sorted(set(_NOUNS)).index(noun) for noun in _NOUNS])
_ONE = {"nearest to": 0, "farthest from": 1, "left of": 2, "right of": 3}


def frame_of(instance: Instance) -> Batch:
    """Return a batch whose labels are the table of an instance; its map is not."""
    batch, scene = drawn_batch(1), instance.scene
    objects = torch.full((1, len(ENTITIES), 7), math.nan)
    for placed in scene.objects:
        pose = (*placed.pose.xy, 0.0, 1.0, 0.0, 0.0, 0.0)
        objects[0, ENTITIES.number(placed.name)] = torch.tensor(pose)
    bases = [(r.base.x, r.base.y, r.base.yaw) for r in scene.robots]
    rule = instance.goal.rule
    assert batch.labels is not None
    labels = replace(
        batch.labels,
        objects=objects,
        bases=torch.tensor([bases]),
        robot_colors=[tuple(robot.color for robot in scene.robots)],
        goals=[instance.goal.pairs],
        rules=[() if rule is None else (rule.kind, *rule.names)],
    )
    return replace(batch, labels=labels)


def places_of(instance: Instance) -> Places:
    labels = frame_of(instance).labels
    assert labels is not None
    colors = distinct([robot.color for robot in instance.scene.robots])
    rows = [colors.index(c) if c in colors else 0 for c in ROBOT_COLORS]
    team = torch.tensor([[color in colors for color in ROBOT_COLORS]])
    by_color = replace(labels, bases=labels.bases[:, rows])
    radii = torch.ones(1, ROBOTS, 3)
    return places_in(true_table(by_color, radii, team, team, ENTITIES), KINDS)


def numbers_of(instance: Instance) -> dict[str, int]:
    """Return the numbers of all things by their plain names."""
    robots = instance.scene.robots
    own = distinct([robot.color for robot in robots])
    phrases = zip(robot_phrases(robots), own, strict=True)
    found = {text: TARGETS + ROBOT_COLORS.index(color) for text, color in phrases}
    names = ENTITIES.names[:TARGETS]
    return found | {name.replace("_", " "): k for k, name in enumerate(names)}


def share(places: Places, thing: int, phrase: str, numbers: dict[str, int]) -> float:
    """Return the share of a thing of a description such as "cube left of the pad"."""
    for words, relation in _ONE.items():
        if found := re.search(rf"{words} the (.*)", phrase):
            return float(places.by_one[0, relation, thing, numbers[found[1]]])
    if found := re.search("between the (.*) and the (.*)", phrase):
        one, two = numbers[found[1]], numbers[found[2]]
        return float(places.by_two[0, thing, one, two])
    first = {"leftmost": 0, "rightmost": len(ORDINALS)}
    word, *_, end = phrase.split()
    ends = {"left": 0, "right": len(ORDINALS)}
    place = first[word] if word in first else ORDINALS.index(word) + ends[end]
    return float(places.by_order[0, place, thing])


@pytest.mark.parametrize("task", ["sort", "exchange", "carousel", "stack2"])
def test_each_description_means_the_thing_that_it_is_about(task: str) -> None:
    relations = set()
    for index in range(5):
        instance = load_instance(task, "val", index)
        things, places = things_in(instance.scene), places_of(instance)
        numbers = numbers_of(instance)
        for name, thing in things.items():
            own = numbers[thing.phrase]
            for relation, phrases in describe(things, name).items():
                relations.add(relation)
                for phrase in phrases:
                    assert share(places, own, phrase, numbers) == 1.0, phrase
                    others = [
                        share(places, k, phrase, numbers)
                        for k in range(len(KINDS))
                        if KINDS[k] == KINDS[own] and k != own
                    ]
                    assert not any(others), phrase
    assert relations == {"nearest", "order", "side", "between"}


def scene_of(batch: Batch) -> SceneSpec:
    labels = batch.labels
    assert labels is not None
    poses = labels.objects[0, :, :2].tolist()
    return SceneSpec(
        robots=tuple(
            RobotPlacement("ur5", color, Pose2(*base))
            for color, base in zip(
                labels.robot_colors[0], labels.bases[0].tolist(), strict=True
            )
        ),
        objects=tuple(
            ObjectPlacement(name.split("_")[1], name.split("_")[0], Pose2(*xy))
            for name, xy in zip(ENTITIES.names, poses, strict=True)
            if not math.isnan(xy[0])
        ),
    )


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(["sort", "exchange", "tower", "unison", "stack2"]),
    st.integers(0, 39),
    st.booleans(),
    st.permutations(range(len(ENTITIES.colors))),
    st.integers(0, 999),
)
def test_sentences_of_changed_frames_ask_for_the_goal(
    task: str, index: int, turned: bool, colors: list[int], seed: int
) -> None:
    batch = frame_of(load_instance(task, "val", index))
    batch = permute_colors(batch, torch.tensor([colors]))
    batch = move(batch, torch.tensor([[3, -2]]), torch.tensor([turned]))
    (text,) = relational_in(batch, [0], np.random.default_rng(seed))
    labels = batch.labels
    assert labels is not None
    wanted = (frozenset(labels.goals[0]), labels.rules[0])
    assert readings(text, scene_of(batch)) == {wanted}
    assert speaks_of_places(text) or text.startswith("Put every")


def test_lessons_change_the_reader_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in (("TASKS", ("relay", "exchange")), ("TABLES", 3), ("BATCH", 4)):
        monkeypatch.setattr(teach_a_reader, name, value)
    teach_a_reader.main("team-reachnet", str(tmp_path), 1)
    before, after = load_model("team-reachnet"), load_model(str(tmp_path))
    assert isinstance(before, TeamReachNet)
    # Files of runs have 16 bits.
    changed = {
        name
        for name, weight in after.state_dict().items()
        if not torch.equal(weight.half(), before.state_dict()[name].half())
    }
    assert changed
    assert all(name.startswith("reader.") for name in changed)
    monkeypatch.setattr(teach_a_reader, "TEST_TABLES", 4)
    capsys.readouterr()
    teach_a_reader.measure(before)
    assert "high_level: goals 100.0%, rules 100.0%" in capsys.readouterr().out


def test_other_models_do_not_learn_from_places(tmp_path: Path) -> None:
    config = TrainingConfig(
        "cliport", tmp_path, tmp_path, augmentation=Augmentation(relational=0.5)
    )
    with pytest.raises(InvalidConfigError, match="cliport does not read"):
        train(config)


def test_rules_as_numbers() -> None:
    goals = [(("red_cube", "blue_pad"), ("white_cube", "red_cube"))] * 5
    rules = [
        (),
        ("after", "white_cube", "red_cube", "red_cube", "blue_pad"),
        ("without", "robot_1"),
        ("but", "green_cube"),
        ("together", "red_cube", "blue_pad", "white_cube", "red_cube"),
    ]
    device = torch.device("cpu")
    wanted = wanted_of(goals, rules, [TEAM] * 5, ENTITIES, device)
    number = ENTITIES.number
    assert [RULES[i] for i in wanted.rule] == ["", *(one[0] for one in rules[1:])]
    assert wanted.bottoms[0, number("red_cube")] == number("blue_pad")
    assert wanted.roles[1].tolist() == [number("white_cube"), number("red_cube"), -1]
    assert wanted.roles[3].tolist() == [-1, -1, number("green_cube")]
    assert wanted.excluded.tolist() == [-1, -1, ROBOT_COLORS.index("red"), -1, -1]
    shares = wanted.shares(TARGETS)
    assert torch.all(shares.bottoms.sum(-1) == 1)
    assert shares.roles.sum((1, 2)).tolist() == [0, 2, 0, 1, 0]
    read = [Reading(*(part[i : i + 1] for part in shares)) for i in range(5)]
    timed = [rule_of_times(one, ENTITIES) for one in read]
    assert [rule and rule.kind for rule in timed] == [
        *(None, "after", None, None, "together")
    ]
    assert timed[4] is not None
    assert {*timed[4].pairs} == {*goals[4]}


def decided(rows: dict[str, dict[str, float]]) -> dict[str, str]:
    """Return the bottom of each top that is decided, of shares of bottoms."""
    bottoms = torch.full((1, CARGO, TARGETS + 1), -20.0)
    bottoms[..., TARGETS] = 0.0
    for top, shares in rows.items():
        row = bottoms[0, ENTITIES.number(top)]
        row[TARGETS] = math.log(max(1e-9, 1.0 - sum(shares.values())))
        for bottom, share in shares.items():
            row[ENTITIES.number(bottom)] = math.log(share)
    zeros = torch.zeros(1, ROBOTS)
    read = Reading(
        bottoms, torch.zeros(1, len(RULES)), torch.zeros(1, 3, CARGO), zeros
    ).decided()
    assert torch.all(read.bottoms.sum(-1) == 1)
    chosen = read.bottoms[0, :, :TARGETS].nonzero().tolist()
    return {ENTITIES.names[top]: ENTITIES.names[bottom] for top, bottom in chosen}


def test_a_reading_is_decided_so_that_it_is_consistent() -> None:
    likely = {"red_pad": 0.6, "blue_pad": 0.4}
    assert decided({"red_cube": likely}) == {"red_cube": "red_pad"}
    # Two cubes do not lie on one pad.
    both = {"red_cube": {"red_pad": 0.7, "blue_pad": 0.3}, "white_cube": likely}
    assert decided(both) == {"red_cube": "red_pad", "white_cube": "blue_pad"}
    # Two do not lie on each other, be it with a third one in between.
    swapped = {
        "red_cube": {"white_cube": 0.6, "red_pad": 0.4},
        "white_cube": {"red_cube": 0.9, "red_pad": 0.05},
    }
    assert decided(swapped) == {"red_cube": "red_pad", "white_cube": "red_cube"}
    ring = {
        "red_cube": {"white_cube": 0.9, "red_pad": 0.1},
        "white_cube": {"blue_cube": 0.9, "red_pad": 0.1},
        "blue_cube": {"red_cube": 0.6, "red_pad": 0.4},
    }
    assert decided(ring)["blue_cube"] == "red_pad"
    assert decided({"red_cube": {"red_pad": 0.2}}) == {}


def test_named_things_are_those_of_the_goal() -> None:
    goal = (("red_cube", "red_pad"), ("white_cube", "red_cube"))
    wanted = wanted_of([goal], [()], [TEAM], ENTITIES, torch.device("cpu"))
    named = named_entities(wanted.shares(TARGETS), ENTITIES)
    names = {ENTITIES.names[k] for k in torch.nonzero(named[0]).flatten().tolist()}
    assert names == {"red_cube", "red_pad", "white_cube"}
