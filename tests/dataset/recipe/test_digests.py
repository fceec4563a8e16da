"""Digests: of all 25,400 episodes, and a sample of them made again."""

import platform
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from recipes import made_up, small_recipe, write_recipe
from recorded_episodes import played, recorded
from tiers import slow_but

from lemma.core.errors import UnknownNameError
from lemma.core.files import read_json
from lemma.dataset.files import MANIFEST, content_digest, shorten
from lemma.dataset.recipe.files import versions
from lemma.dataset.recipe.record import record_episode
from lemma.dataset.recipe.replay import differing, expected_digests
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS, splits_of
from lemma.tasks.suite import LISTED, SUITE, load_instance
from make_recipe import export

LISTS = [(task, split) for task in SUITE for split in SPLITS]
OTHER_LISTS = [(task, split) for task in LISTED[len(SUITE) :] for split in SPLITS]
DIGESTS = Path(str(files("lemma.dataset") / "digests"))
NAMED = tuple(t for t in LISTED if not t.endswith(("_fixed", "_varied")))
"""A task of each name; the degrees of a rung are slow."""
SEED = 20230802


def test_every_frozen_instance_has_a_digest() -> None:
    for task, split in LISTS + OTHER_LISTS:
        digests = expected_digests(task, split)
        count = splits_of(task)[split]
        assert len(digests) == len(set(digests)) == count, (task, split)
        assert all(len(digest) == 32 and int(digest, 16) >= 0 for digest in digests)


@pytest.mark.parametrize("split", SPLITS)
def test_the_manifest_has_the_sha256_of_every_split(split: str) -> None:
    entry = read_json(DIGESTS / MANIFEST)["splits"][split]
    every = [d for task in sorted(LISTED) for d in expected_digests(task, split)]
    assert entry == {"episodes": len(every), "sha256": content_digest(every)}


def test_digests_are_of_this_benchmark_and_engine() -> None:
    here = versions(BENCHMARK_VERSION)
    found = read_json(DIGESTS / MANIFEST)["versions"]
    assert found["benchmark"] == here["benchmark"]
    assert found["format"] == here["format"]
    assert found["mujoco"] == here["mujoco"]


def test_digests_are_small() -> None:
    for entry in DIGESTS.glob("*.txt"):
        text = entry.read_bytes()
        # 128 bits of each episode, in hexadecimal, and a line break.
        assert len(text) == 33 * len(text.splitlines()), entry.name


on_the_same_platform = pytest.mark.skipif(
    platform.machine() != "x86_64" or platform.system() != "Linux",
    reason="other builds of MuJoCo and of the C library compute other last bits",
)


def check(record: EpisodeRecord) -> None:
    assert record.success, record.key
    expected = expected_digests(record.task, record.split)[record.index]
    assert shorten(record.digest()) == expected, record.key


@on_the_same_platform
@pytest.mark.parametrize("task", slow_but(LISTED, *NAMED))
def test_an_episode_of_every_task_is_made_again_to_the_bit(task: str) -> None:
    done = recorded(task, "ur5+ur10") if task in SUITE else played(task)
    check(done.record)


@pytest.mark.slow
@on_the_same_platform
@pytest.mark.parametrize(("task", "split"), LISTS + OTHER_LISTS[1::3])
def test_an_episode_of_every_list_is_made_again_to_the_bit(
    task: str, split: str
) -> None:
    rng = np.random.default_rng((SEED, *f"{task}-{split}".encode()))
    index = int(rng.integers(splits_of(task)[split]))
    check(record_episode(load_instance(task, split, index)))


def test_what_is_exported_is_what_was_generated(tmp_path: Path) -> None:
    manifest = export(small_recipe(), tmp_path)
    assert read_json(tmp_path / MANIFEST) == manifest
    assert manifest["splits"]["val"]["episodes"] == 6
    names = {f"{task}-{split}.txt" for task in ("pass", "stack") for split in TWO}
    assert {path.name for path in tmp_path.iterdir()} == {*names, MANIFEST}
    digests = (tmp_path / "stack-val.txt").read_text().split()
    assert tuple(digests) == expected_digests("stack", "val")[:3]


TWO = ("val", "test")


def test_episodes_that_differ_are_named(tmp_path: Path) -> None:
    write_recipe(tmp_path, [made_up(index=i) for i in range(2)])
    assert differing(tmp_path) == ["stack/val/0", "stack/val/1"]


def test_an_unknown_list_is_explained() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'stack-val'"):
        expected_digests("stack", "vall")
