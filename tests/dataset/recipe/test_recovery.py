"""Recovery states: what went wrong, and what the expert says of it."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest
from command import run as lemma
from perturbed_recipes import (
    EPISODES,
    PERTURBATION,
    TASKS,
    perturbed_order,
    perturbed_recipe,
    perturbed_records,
)
from recipes import bytes_of, small_order, small_recipe

from lemma.cli.generate import order_of
from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.files import read_json, write_json
from lemma.core.workers.pool import ProcessPool, Serial
from lemma.dataset.files import MANIFEST, shorten
from lemma.dataset.lerobot.export import LeRobotConfig, write_dataset
from lemma.dataset.recipe.files import load, open_table
from lemma.dataset.recipe.generate import generate, generate_part, recipe_file
from lemma.dataset.recipe.record import record_perturbed
from lemma.dataset.recipe.replay import expected_digests, replay_all
from lemma.dataset.recipe.schema import (
    PERTURBED_SCHEMA,
    SCHEMA,
    ExpertRecord,
    PerturbedRecord,
    describe,
    from_table,
    to_table,
)
from lemma.dataset.recipe.summary import recovery_figures
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.dataset import KeyframeDataset
from lemma.dataset.rendered.render import RenderConfig, render
from lemma.env.episode import Episode
from lemma.expert.disturbances import KINDS, NONE, Perturbation
from lemma.expert.expert import Expert
from lemma.motion.outcome import Outcome, SkillResult
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import STOP
from lemma.tasks.suite import load_instance
from make_recipe import export

DECISION = ("robot", "primitive", "pick", "place")


def decision(row: Any) -> tuple[str, ...]:
    return tuple(str(getattr(row, name)) for name in DECISION)


@pytest.mark.slow
def test_labels_are_what_an_expert_decides_that_sees_the_state_for_the_first_time() -> (
    None
):
    for record in perturbed_records():
        instance = Instance.from_dict(record.instance_data())
        scene = Scene(instance.scene)
        for keyframe in range(record.labelled):
            scene.restore(record.state(keyframe))
            subtask, grounded = Expert(scene, instance.goal).act()
            known = record.expert[keyframe]
            assert known is not None
            assert decision(known) == decision(subtask)
            if grounded is None:
                assert known.pick_pose is known.place_pose is None
                assert instance.goal.progress(scene) == 1.0
                continue
            for pose, exact in (
                (known.pick_pose, grounded.pick),
                (known.place_pose, grounded.place),
            ):
                assert pose == (exact.x, exact.y, exact.yaw)


def test_what_was_executed_differs_from_the_labels_where_it_was_perturbed() -> None:
    kinds = set()
    for record in perturbed_records():
        assert len(record.expert) == record.keyframes == len(record.perturbation) + 1
        for row, known, kind in zip(
            record.subtasks, record.expert, record.perturbation, strict=False
        ):
            if known is None:
                continue
            kinds.add(kind)
            same_poses = (row.pick_pose, row.place_pose) == (
                known.pick_pose,
                known.place_pose,
            )
            if kind == NONE:
                assert decision(row) == decision(known)
                assert same_poses
            elif kind in ("robot", "choice"):
                assert decision(row) != decision(known)
            else:
                assert decision(row) == decision(known)
                assert not same_poses
    assert len(kinds) > 2
    assert kinds <= {NONE, *KINDS}


@pytest.mark.slow
def test_every_state_is_reproduced_to_the_bit() -> None:
    assert replay_all(load(perturbed_recipe()), Serial()) == []


@pytest.mark.slow
def test_processes_and_interrupted_runs_write_the_same_bytes(tmp_path: Path) -> None:
    order = perturbed_order(tmp_path)
    about = open_table(recipe_file(perturbed_recipe(), "train", "stack"))[1]
    parts = tmp_path / ".parts"
    write_json(parts / "about.json", dict(about))
    path = parts / "train-hook" / "00001.parquet"
    generate_part("hook", "train", 1, path, about)
    counts: list[int] = []
    assert generate(order, ProcessPool(2), counts.append).made == 3
    assert counts[0] == 1
    assert bytes_of(tmp_path) == bytes_of(perturbed_recipe())
    assert generate(order, Serial()).made == 0


@pytest.mark.slow
def test_other_seeds_make_other_mistakes_in_the_same_instance() -> None:
    instance = load_instance("stack", "train", 0)
    one, again, other = (
        record_perturbed(instance, Perturbation(0.9, seed)) for seed in (3, 3, 4)
    )
    assert one == again
    assert one.instance == other.instance
    assert one.keyframe_sha256[0] == other.keyframe_sha256[0]
    assert one.keyframe_sha256[1] != other.keyframe_sha256[1]
    assert one.key != other.key != instance.key


def test_a_folder_says_that_it_is_no_part_of_the_benchmark() -> None:
    folder = perturbed_recipe()
    file, about = open_table(recipe_file(folder, "train", "hook"))
    assert file.schema_arrow.names == PERTURBED_SCHEMA.names
    assert (about["perturb"], about["perturb_seed"]) == ("0.6", "1")
    assert read_json(folder / MANIFEST)["versions"] == about
    assert "not part of the benchmark" in (folder / "README.md").read_text()
    assert all(r.key.endswith("/perturbed-1") for r in perturbed_records())
    known = {*expected_digests("hook", "train"), *expected_digests("stack", "train")}
    assert not {shorten(r.digest()) for r in perturbed_records()} & known


def test_the_two_are_never_mixed(tmp_path: Path) -> None:
    folder = copytree(perturbed_recipe(), tmp_path / "perturbed")
    before = bytes_of(folder)
    order = perturbed_order(folder)
    for other in (
        replace(order, perturb=None),
        # Of which nothing is there yet.
        replace(order, perturb=None, tasks=("pass",)),
        replace(order, perturb=Perturbation(0.5, seed=1)),
        replace(order, perturb=Perturbation(0.6)),
    ):
        with pytest.raises(DatasetError, match=r"perturb(_seed)? was .* and is now"):
            generate(other, Serial())
    assert bytes_of(folder) == before
    folder = copytree(small_recipe(), tmp_path / "demonstrations")
    with pytest.raises(DatasetError, match="perturb was not given and is now"):
        generate(replace(small_order(folder), perturb=PERTURBATION), Serial())
    with pytest.raises(DatasetError, match="no part of the benchmark"):
        export(perturbed_recipe(), tmp_path / "digests")


def test_forms_that_show_what_was_done_are_refused(tmp_path: Path) -> None:
    order = RenderConfig(recipe=perturbed_recipe(), out=tmp_path / "out")
    with pytest.raises(DatasetError, match="perturbed executions"):
        write_dataset(LeRobotConfig(source=order), Serial())


@pytest.mark.slow
def test_keyframes_hold_labels_and_what_was_executed(tmp_path: Path) -> None:
    order = RenderConfig(recipe=perturbed_recipe(), out=tmp_path)
    render(order, KeyframeForm(), Serial())
    records = {record.key: record for record in perturbed_records()}
    executed = tuple(f"executed_{name}" for name in DECISION)
    columns = (*DECISION, *executed, "key", "keyframe", "outcome", "perturbation")
    dataset = KeyframeDataset(tmp_path, columns=(*columns, "pick_pose", "place_pose"))
    assert len(dataset) == sum(record.labelled for record in records.values())
    for sample in (dataset[i] for i in range(len(dataset))):
        record, keyframe = records[sample["key"]], sample["keyframe"]
        known = record.expert[keyframe]
        assert known is not None
        assert tuple(sample[name] for name in DECISION) == decision(known)
        for name in ("pick_pose", "place_pose"):
            pose = getattr(known, name) or (math.nan,) * 3
            assert sample[name].tolist() == pytest.approx(pose, abs=0, nan_ok=True)
        done = tuple(sample[name] for name in executed)
        if keyframe == len(record.subtasks):
            assert done == ("", "stop", "", "")
            assert (sample["outcome"], sample["perturbation"]) == ("stopped", NONE)
            continue
        row = record.subtasks[keyframe]
        assert done == decision(row)
        assert sample["outcome"] == row.outcome
        assert sample["perturbation"] == record.perturbation[keyframe]
    assert "executed_*" in (tmp_path / "README.md").read_text()


def test_what_has_no_label_is_not_rendered() -> None:
    record = max(perturbed_records(), key=lambda r: r.keyframes)
    cut = replace(record, expert=(*record.expert[:2], None, *record.expert[3:]))
    assert cut.labelled == 2
    rows = list(KeyframeForm(64, 48).rows(cut))
    assert [row["keyframe"] for row in rows] == [0, 1]
    assert {row["keyframes"] for row in rows} == {2}


def test_an_expert_without_a_plan_gives_no_label(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Expert, "act", lambda expert: (STOP, None))
    record = record_perturbed(load_instance("stack", "train", 0), PERTURBATION)
    assert record.expert == (None,)
    assert (record.subtasks, record.labelled, record.success) == ((), 0, False)


def test_what_the_expert_fails_at_is_no_label(monkeypatch: pytest.MonkeyPatch) -> None:
    failure = SkillResult(Outcome.MISSED_GRASP, "", 0.0)
    monkeypatch.setattr(Episode, "execute", lambda episode, grounded: failure)
    record = record_perturbed(load_instance("stack", "train", 0), Perturbation(1e-9))
    assert record.perturbation == (NONE,)
    assert record.expert == (None, None)


def test_what_goes_in_comes_out() -> None:
    records = perturbed_records()
    table = to_table(records)
    assert table.schema.equals(PERTURBED_SCHEMA)
    assert from_table(table) == records
    assert [f.name for f in fields(PerturbedRecord)] == PERTURBED_SCHEMA.names
    struct = PERTURBED_SCHEMA.field("expert").type.value_type
    assert [f.name for f in fields(ExpertRecord)] == [f.name for f in struct]
    described = [
        line.split("`")[1] for line in describe(perturbed=True).splitlines()[2:]
    ]
    assert described == PERTURBED_SCHEMA.names[len(SCHEMA) :]


def test_every_part_counts_in_the_digest() -> None:
    record = perturbed_records()[0]
    first = record.expert[0]
    assert first is not None
    others = [replace(record, perturbation=("pick", *record.perturbation[1:], "x"))]
    others += [replace(record, expert=(None, *record.expert[1:]))]
    for name in ExpertRecord.__slots__:
        changed = replace(first, **dict.fromkeys([name]))  # type: ignore[arg-type]
        others.append(replace(record, expert=(changed, *record.expert[1:])))
    others.append(replace(record, progress=0.25))
    digests = {r.digest() for r in [record, *others]}
    assert len(digests) == 1 + len(others)


def test_figures_are_counted() -> None:
    found = recovery_figures(load(perturbed_recipe()))
    records = perturbed_records()
    assert found.episodes == len(TASKS) * EPISODES
    assert found.solved == sum(record.success for record in records)
    assert found.keyframes == sum(record.labelled for record in records)
    assert found.unlabelled == sum(r.keyframes for r in records) - found.keyframes
    assert found.subtasks == sum(len(record.subtasks) for record in records)
    after = sum(
        any(kind != NONE for kind in record.perturbation[:keyframe])
        for record in records
        for keyframe in range(record.labelled)
    )
    assert found.after == after > 0
    assert sum(found.mistakes.values()) == sum(
        kind != NONE for record in records for kind in record.perturbation
    )


def test_the_verb_says_what_it_came_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("generate", "--perturb", "1", "--tasks", "pass", "--episodes", "1")
    assert lemma(*words, "--out", tmp_path, "--workers", 1, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["recovery"]["episodes"] == 1
    assert "differing" not in found
    assert lemma(*words, "--out", tmp_path, "--workers", 1) == 0
    assert "despite" in capsys.readouterr().out
    assert lemma("replay", tmp_path, "--workers", 1) == 0
    assert lemma("inspect", tmp_path, "--json") == 0


def test_perturbed_executions_have_a_place_of_their_own() -> None:
    order = order_of(perturb=0.3)
    assert order.out == Path("data/lemma-v3-recovery")
    assert order.splits == ("train",)
    assert order_of().out == Path("data/lemma-v3")
    assert order_of().splits == ("train", "val", "test")
    with pytest.raises(InvalidConfigError, match="Add --perturb"):
        order_of(perturb_seed=1)


@pytest.mark.parametrize("probability", [0.0, -0.1, 1.1, math.nan])
def test_a_probability_is_one(probability: float) -> None:
    with pytest.raises(InvalidConfigError, match=r"Try 0\.3"):
        Perturbation(probability)
