"""The protocol: frozen, quoted, on its page, and never mixed with another."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command import run
from made_up import result
from tiers import slow_but

from expert_times import is_alike, time_expert
from lemma.cli.reproduce import reproduce
from lemma.cli.workers import Workers
from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.poses import Pose2, wrap
from lemma.evaluation.protocol import rules as protocol
from lemma.evaluation.protocol.expert_times import (
    TIMED_SPLITS,
    expert_s,
    perturbed_start,
)
from lemma.evaluation.protocol.language_controls import (
    control_of,
)
from lemma.evaluation.protocol.perturbed_starts import SHIFT_M, TURN_RAD
from lemma.evaluation.protocol.rules import (
    check_protocol,
    deviations,
    frozen,
    in_force,
    quote,
)
from lemma.evaluation.protocol.suites import quote_suites, sha256_of
from lemma.scene.objects.entity import entity_named
from lemma.tasks.goal import Goal
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.language.blind import instruction
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE, load_instance
from protocol import PAGE, text


def test_what_is_in_force_is_what_is_frozen() -> None:
    assert deviations() == [], (
        "The protocol has changed. Name it anew, and: python scripts/protocol.py"
    )
    # As JSON reads it back.
    assert json.loads(json.dumps(in_force())) == frozen()
    assert sha256_of(frozen()) == quote()


def test_the_page_is_made_from_the_file() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert text(frozen()) == page, (
        "docs/protocol.md is out of date: python scripts/protocol.py"
    )
    assert quote() in page


def test_another_release_of_mujoco_is_another_protocol(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = quote()

    def another() -> dict[str, Any]:
        told = frozen()
        return {**told, "physics": {**told["physics"], "mujoco": "9.9.9"}}

    monkeypatch.setattr(protocol, "in_force", another)
    assert quote() != before
    (deviation,) = deviations()
    assert deviation.startswith("physics.mujoco 9.9.9 instead of ")


def test_nothing_is_played_beside_results_of_another_protocol(tmp_path: Path) -> None:
    made = result(3)
    made.write(tmp_path / "reachnet" / "seed-0.json")
    with pytest.raises(DatasetError, match="follows 555"):
        reproduce("oracle", tmp_path, working=Workers(workers=1))
    assert not (tmp_path / "oracle").exists()


@pytest.mark.parametrize("missing", [True, False])
def test_protocols_are_not_mixed(missing: bool) -> None:
    other = {} if missing else {"protocol": "6" * 64}
    with pytest.raises(DatasetError, match="here follows protocol 555"):
        check_protocol({"protocol": "5" * 64}, other, "here", "there")
    check_protocol(other, other, "here", "there")


def test_other_suites_have_hashes_beside_the_protocol() -> None:
    assert quote_suites(SUITE) == {}
    quoted = quote_suites(["pass", "lift_fixed", "carousel"])
    assert [*quoted] == ["ladder", "teams"]
    page = PAGE.read_text(encoding="utf-8")
    assert all(sha256 in page for sha256 in quoted.values())
    ours = {"protocol": quote(), "suites": quoted}
    check_protocol(ours, {"protocol": quote()}, "here", "there")
    theirs = {"protocol": quote(), "suites": {"teams": "6" * 64}}
    with pytest.raises(DatasetError, match="different lists of the suite 'teams'"):
        check_protocol(ours, theirs, "here", "there")


def moved(instance: Instance, name: str, dx: float) -> Instance:
    """Return an instance with one object shifted along x [m]."""
    objects = tuple(
        replace(o, pose=Pose2(o.pose.x + dx, o.pose.y, o.pose.yaw))
        if o.name == name
        else o
        for o in instance.scene.objects
    )
    return replace(instance, scene=replace(instance.scene, objects=objects))


@pytest.mark.parametrize("task", SUITE)
def test_everything_is_a_little_elsewhere(task: str) -> None:
    for index in range(5):
        instance = load_instance(task, "test", index)
        made = perturbed_start(instance)
        assert made == perturbed_start(instance)
        assert made.goal == instance.goal
        assert made.instructions == instance.instructions
        assert made.scene.robots == instance.scene.robots
        pairs = zip(made.scene.objects, instance.scene.objects, strict=True)
        for now, before in pairs:
            assert now.name == before.name
            assert 0.0 < now.pose.distance(before.pose) <= SHIFT_M + 1e-5
            assert abs(wrap(now.pose.yaw - before.pose.yaw)) <= TURN_RAD + 1e-5
        assert is_alike(made.scene, instance.scene)


def test_another_problem_is_not_alike() -> None:
    instance = load_instance("pass", "test", 1)
    cube = instance.goal.pairs[0][0]
    x = instance.scene.placement(cube).pose.x
    # To the other robot.
    assert not is_alike(moved(instance, cube, -2.0 * x).scene, instance.scene)
    assert not is_alike(moved(instance, cube, 5.0).scene, instance.scene)


def test_objects_do_not_touch() -> None:
    instance = load_instance("stack2", "test", 0)
    one, two, *rest = instance.scene.objects
    near = replace(one, pose=Pose2(two.pose.x + 0.06, two.pose.y, 0.0))
    scene = replace(instance.scene, objects=(near, two, *rest))
    assert not is_alike(scene, instance.scene)


def test_train_has_no_perturbed_starts() -> None:
    with pytest.raises(InvalidConfigError, match="train"):
        perturbed_start(load_instance("stack", "train", 0))
    assert expert_s("stack", "train", 0) is None


def test_the_table_is_whole() -> None:
    for split in TIMED_SPLITS:
        for task in SUITE:
            for index in range(SPLITS[split]):
                own = expert_s(task, split, index)
                other = expert_s(task, split, index, perturbed_start=True)
                assert own is not None
                assert other is not None
                assert 5.0 < own < 100.0
                assert abs(own - other) < 10.0


@pytest.mark.parametrize(
    ("task", "split", "index"),
    slow_but([("pass", "test", 7), ("stack2", "val", 4)], ("pass", "test", 7)),
)
def test_the_table_is_what_the_expert_takes(task: str, split: str, index: int) -> None:
    own, _, other = time_expert(task, split, index)
    assert own == expert_s(task, split, index)
    assert other == expert_s(task, split, index, perturbed_start=True), (
        "The expert's times are out of date: python scripts/expert_times.py"
    )


INSTANCES = [(task, index) for task in SUITE for index in range(6)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", slow_but(EVALUATION_KINDS, "human"))
def test_swapped_colors_ask_for_another_goal(kind: str) -> None:
    there = 0
    for task, index in INSTANCES:
        instance = load_instance(task, "test", index)
        control = control_of("swapped", instance, kind)
        assert control.sentence is not None
        assert control.sentence != instruction(instance, kind)
        if control.asks is None:
            continue
        there += 1
        assert set(Goal.from_pairs(control.asks).entities) <= set(
            instance.scene.object_names
        )
        # No conjunct of the goal is asked for, so who obeys cannot reach it.
        assert not set(control.asks) & set(instance.goal.pairs)
        tops = [top for top, _ in control.asks]
        assert len(set(tops)) == len(tops)
    assert there > 0.8 * len(INSTANCES)


def test_the_words_stay_and_the_colors_change() -> None:
    instance = load_instance("stack", "test", 0)
    control = control_of("swapped", instance, "unseen")
    assert control.asks is not None
    colors = {entity_named(name).color for name in instance.scene.object_names}

    def bare(sentence: str) -> list[str]:
        return [w for w in sentence.lower().split() if w.strip(".,!?") not in colors]

    own = instance.instructions["unseen"]
    assert bare(control.sentence or "") == bare(own)


def test_where_there_is_nothing_else_colors_are_of_nothing() -> None:
    alone = next(
        instance
        for index in range(60)
        for instance in [load_instance("poke", "test", index)]
        # A cube, its pad and the stick.
        if len(instance.scene.objects) == 3
    )
    control = control_of("swapped", alone, "high_level")
    assert control.asks is None
    assert control.sentence is not None
    cube, pad = alone.goal.pairs[0]
    assert f"{entity_named(cube).color} cube" not in control.sentence
    assert f"{entity_named(pad).color} pad" not in control.sentence


def test_shuffled_sentences_are_of_the_next_instance() -> None:
    last, first = load_instance("stack", "val", 39), load_instance("stack", "val", 0)
    control = control_of("shuffled", last, "human")
    assert control.sentence == first.instructions["human"]
    for index in range(40):
        instance = load_instance("stack", "val", index)
        asks = control_of("shuffled", instance, "human").asks
        if asks is not None:
            assert {name for pair in asks for name in pair} <= set(
                instance.scene.object_names
            )
            assert set(asks) != set(instance.goal.pairs)


def test_who_departs_is_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    told = {**frozen(), "name": "mine"}
    monkeypatch.setattr(protocol, "in_force", lambda: told)
    words = ("--policy", "oracle", "--tasks", "stack", "--episodes", 1)
    assert run("evaluate", *words, "--out", tmp_path) == 0
    assert "name mine instead of lemma-v3" in capsys.readouterr().err
    about = json.loads((tmp_path / "about.json").read_text())
    assert about["protocol"] == sha256_of(told)
