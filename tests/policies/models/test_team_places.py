"""The team's reader and the sentences have one meaning of places."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from batches import drawn_batch
from hypothesis import given, settings
from hypothesis import strategies as st
from relational_reader import readings

from lemma.core.poses import Pose2
from lemma.policies.batch import Batch
from lemma.policies.entities import BENCHMARK
from lemma.policies.models.team_reachnet.places import Places, places_in
from lemma.policies.models.team_reachnet.table import true_table
from lemma.policies.models.team_reachnet.teams import ROBOTS, distinct
from lemma.policies.text.places import relational_in
from lemma.policies.training.augmentation import move
from lemma.policies.training.recoloring import permute_colors
from lemma.scene.spec import ROBOT_COLORS, ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import ORDINALS, robot_phrases
from lemma.tasks.language.relational import describe, speaks_of_places, things_in
from lemma.tasks.suite import load_instance

TARGETS = BENCHMARK.stick
_NOUNS = [kind.name for kind in BENCHMARK.kinds[:TARGETS]] + ["robot"] * ROBOTS
KINDS = torch.tensor([sorted(set(_NOUNS)).index(noun) for noun in _NOUNS])
_ONE = {"nearest to": 0, "farthest from": 1, "left of": 2, "right of": 3}


def frame_of(instance: Instance) -> Batch:
    """Return a batch whose labels are the table of an instance; its map is not."""
    batch, scene = drawn_batch(1), instance.scene
    objects = torch.full((1, len(BENCHMARK), 7), math.nan)
    for placed in scene.objects:
        pose = (*placed.pose.xy, 0.0, 1.0, 0.0, 0.0, 0.0)
        objects[0, BENCHMARK.number(placed.name)] = torch.tensor(pose)
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
    return places_in(true_table(by_color, radii, team, team, BENCHMARK), KINDS)


def numbers_of(instance: Instance) -> dict[str, int]:
    """Return the numbers of all things by their plain names."""
    robots = instance.scene.robots
    own = distinct([robot.color for robot in robots])
    phrases = zip(robot_phrases(robots), own, strict=True)
    found = {text: TARGETS + ROBOT_COLORS.index(color) for text, color in phrases}
    names = BENCHMARK.names[:TARGETS]
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
            for name, xy in zip(BENCHMARK.names, poses, strict=True)
            if not math.isnan(xy[0])
        ),
    )


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(["sort", "exchange", "tower", "unison", "stack2"]),
    st.integers(0, 39),
    st.booleans(),
    st.permutations(range(len(BENCHMARK.colors))),
    st.integers(0, 999),
)
def test_sentences_of_changed_frames_ask_for_the_goal(
    task: str, index: int, turned: bool, colors: list[int], seed: int
) -> None:
    batch = frame_of(load_instance(task, "val", index))
    batch = permute_colors(batch, torch.tensor([colors]))
    batch = move(batch, torch.tensor([[3, -2]]), torch.tensor([turned]))
    text = relational_in(batch, 0, np.random.default_rng(seed))
    labels = batch.labels
    assert labels is not None
    wanted = (frozenset(labels.goals[0]), labels.rules[0])
    assert readings(text, scene_of(batch)) == {wanted}
    assert speaks_of_places(text) or text.startswith("Put every")
