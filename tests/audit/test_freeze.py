"""Freezing gives the lists that are frozen, byte for byte."""

import gzip
import hashlib
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from tiers import slow_but

import freeze_instances as freezer
from freeze_instances import MANIFEST, Accepted, accept, freeze, write_list
from lemma.core.errors import SamplingError
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, ExpertStep, solve
from lemma.tasks.instance import Instance
from lemma.tasks.suite import SUITE, load_instance


@pytest.mark.parametrize("task", slow_but(SUITE, "pass2"))
def test_the_expert_accepts_what_is_frozen(task: str) -> None:
    frozen = load_instance(task, "test", 5)
    accepted = accept(task, "test", 5)
    assert accepted.instance == frozen
    assert accepted.elapsed_s < 100.0
    assert accepted.rejected >= 0
    assert accepted.unsolved >= 0


@cache
def unhindered() -> Accepted:
    return accept("stack", "free", 4)


def test_a_refused_draw_is_counted_and_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = unhindered()
    assert first.unsolved == 0
    calls: list[Episode] = []

    def refuse_once(episode: Episode, expert: Expert) -> Iterator[ExpertStep]:
        calls.append(episode)
        return solve(episode, expert) if len(calls) > 1 else iter(())

    monkeypatch.setattr(freezer, "solve", refuse_once)
    second = accept("stack", "free", 4)
    assert second.unsolved == 1
    assert second.instance.key == first.instance.key
    assert second.instance.scene != first.instance.scene
    assert second.instance.team == first.instance.team


def test_an_instance_that_one_robot_solves_is_counted_and_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = unhindered()
    asked: list[Instance] = []

    def broken_once(instance: Instance) -> str | None:
        asked.append(instance)
        return "by_magic" if len(asked) == 1 else None

    monkeypatch.setattr(freezer, "cheap_attacks_succeed", broken_once)
    second = accept("stack", "free", 4)
    assert asked == [first.instance, second.instance]
    assert (second.unsolved, second.broken) == (0, ("by_magic",))


def test_a_task_that_the_expert_never_solves_is_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(freezer, "solve", lambda *args: iter(()))
    with pytest.raises(
        SamplingError, match="Of 20 instances of pass/free/3 the expert solved none"
    ):
        accept("pass", "free", 3)


def test_the_same_instances_are_the_same_bytes(tmp_path: Path) -> None:
    instances = [load_instance("hook", "val", index) for index in range(5)]
    paths = [tmp_path / name for name in ("a.jsonl.gz", "b.jsonl.gz")]
    digests = {write_list(instances, path) for path in paths}
    assert len(digests) == 1
    assert paths[0].read_bytes() == paths[1].read_bytes()
    lines = gzip.decompress(paths[0].read_bytes())
    assert digests == {hashlib.sha256(lines).hexdigest()}
    assert [json.loads(line) for line in lines.decode().splitlines()] == [
        instance.to_dict() for instance in instances
    ]


@pytest.mark.slow
def test_a_folder_of_lists_has_a_manifest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(freezer, "splits_of", lambda _: {"val": 2})
    tasks = ("pass", "stack")
    lines = list(freeze(tmp_path / "frozen", tasks, ("val",), workers=1))
    assert [line.split(":")[0] for line in lines] == ["pass-val", "stack-val"]
    assert (
        "2 instances, 0 tables rejected, 0 not solved by the expert, none broken"
        in lines[0]
    )
    manifest = json.loads((tmp_path / "frozen" / MANIFEST).read_text())
    assert set(manifest) == {"pass-val", "stack-val"}
    for name, entry in manifest.items():
        text = gzip.decompress((tmp_path / "frozen" / f"{name}.jsonl.gz").read_bytes())
        assert entry["sha256"] == hashlib.sha256(text).hexdigest()
        assert entry["instances"] == 2
        for index, line in enumerate(text.decode().splitlines()):
            frozen = load_instance(name.split("-")[0], "val", index)
            assert json.loads(line) == frozen.to_dict()
    # A second run, of another split, adds to the manifest.
    monkeypatch.setattr(freezer, "splits_of", lambda _: {"test": 1})
    list(freeze(tmp_path / "frozen", tasks, ("test",), workers=1))
    manifest = json.loads((tmp_path / "frozen" / MANIFEST).read_text())
    assert set(manifest) == {"pass-val", "stack-val", "pass-test", "stack-test"}
