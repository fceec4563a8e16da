"""Rendering that is interrupted, repeated, or finds what it should not."""

from pathlib import Path
from shutil import copytree
from typing import Any

import pytest
from in_process import Killed, KilledAfter
from recipes import bytes_of
from rendered_sets import (
    SPLIT,
    TASKS,
    recipe,
    recipe_folder,
)

from lemma.core.errors import DatasetError
from lemma.core.workers.pool import ProcessPool, Serial
from lemma.dataset.files import MANIFEST, check_files
from lemma.dataset.hub import check
from lemma.dataset.recipe.files import REVISION_VARIABLE
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.dataset import KeyframeDataset
from lemma.dataset.rendered.render import RenderConfig, render

pytestmark = pytest.mark.render

SMALL = KeyframeForm(80, 60)


@pytest.fixture(autouse=True)
def _one_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REVISION_VARIABLE, "of-the-tests")


def order(out: Path, **changes: Any) -> RenderConfig:
    return RenderConfig(recipe=recipe_folder(), out=out, **changes)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed") / "set"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(REVISION_VARIABLE, "of-the-tests")
        render(order(folder), SMALL, Serial())
    return folder


def test_a_run_that_was_killed_is_completed_with_the_same_bytes(
    undisturbed: Path, tmp_path: Path
) -> None:
    out = tmp_path / "set"
    with pytest.raises(Killed):
        render(order(out), SMALL, KilledAfter(1))
    with pytest.raises(DatasetError, match="is not complete"):
        check(out)
    assert not (out / MANIFEST).exists()
    # A writer that was killed leaves its draft, and half of a pair.
    (out / "maps" / SPLIT / ".stack-000.arrow.1.draft").write_bytes(b"half")
    (out / "cameras" / SPLIT / "pass-000.arrow").unlink()
    seen: list[int] = []
    summary = render(order(out), SMALL, Serial(), seen.append)
    assert sum(seen) == summary.episodes == 4
    assert bytes_of(out) == bytes_of(undisturbed)


@pytest.mark.slow
def test_processes_give_the_same_bytes(undisturbed: Path, tmp_path: Path) -> None:
    summary = render(order(tmp_path / "set"), SMALL, ProcessPool(2))
    assert summary.made == 4
    assert bytes_of(tmp_path / "set") == bytes_of(undisturbed)


def test_a_second_run_makes_nothing(undisturbed: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in undisturbed.glob("*/*/*")}
    summary = render(order(undisturbed), SMALL, Serial())
    assert (summary.made, summary.episodes) == (0, 4)
    assert summary.rows == sum(record.keyframes for record in recipe())
    assert {p: p.stat().st_mtime_ns for p in undisturbed.glob("*/*/*")} == before


def test_tasks_can_be_rendered_one_after_the_other(
    undisturbed: Path, tmp_path: Path
) -> None:
    for task in reversed(TASKS):
        summary = render(
            order(tmp_path / "set", tasks=(task,), splits=(SPLIT,)), SMALL, Serial()
        )
        assert summary.episodes == 2
    assert bytes_of(tmp_path / "set") == bytes_of(undisturbed)


@pytest.mark.slow
def test_a_recipe_that_has_grown_is_rendered_again(tmp_path: Path) -> None:
    def grow(episodes: int) -> int:
        recipe_order = GenerateConfig(
            out=tmp_path / "recipe", tasks=("pass",), splits=(SPLIT,), episodes=episodes
        )
        generate(recipe_order, Serial())
        return render(
            RenderConfig(recipe=tmp_path / "recipe", out=tmp_path / "set"),
            SMALL,
            Serial(),
        ).rows

    assert (grow(1), grow(2)) == (3, 6)


def test_a_file_that_was_cut_short_is_told_and_made_again(
    undisturbed: Path, tmp_path: Path
) -> None:
    out = copytree(undisturbed, tmp_path / "set")
    path = out / "maps" / SPLIT / "stack-000.arrow"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(DatasetError, match=r"stack-000.arrow .*truncated.*Delete"):
        KeyframeDataset(out, SPLIT)
    with pytest.raises(DatasetError, match=r"stack-000.arrow is damaged.*Delete"):
        render(order(out), SMALL, Serial())
    path.unlink()
    with pytest.raises(DatasetError, match=r"is missing. Run 'lemma render' again"):
        KeyframeDataset(out, SPLIT)
    render(order(out), SMALL, Serial())
    assert bytes_of(out) == bytes_of(undisturbed)


def test_a_wrong_checksum_is_told(undisturbed: Path, tmp_path: Path) -> None:
    out = copytree(undisturbed, tmp_path / "set")
    check_files(out)
    path = out / "cameras" / SPLIT / "pass-000.arrow"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match=r"pass-000.arrow has another checksum"):
        check_files(out)
    with pytest.raises(DatasetError, match=r"pass-000.arrow has another checksum"):
        render(order(out), SMALL, Serial())


def test_what_was_made_otherwise_is_refused(undisturbed: Path, tmp_path: Path) -> None:
    before = bytes_of(undisturbed)
    with pytest.raises(DatasetError, match="height was 60 and is now 90"):
        render(order(undisturbed), KeyframeForm(80, 90), Serial())
    with pytest.raises(DatasetError, match="has 'recipe', not 'keyframes'"):
        render(order(recipe_folder()), SMALL, Serial())
    other = GenerateConfig(
        out=tmp_path / "other", tasks=("pass",), splits=("test",), episodes=1
    )
    generate(other, Serial())
    (tmp_path / "other" / "test").rename(tmp_path / "other" / SPLIT)
    manifest = tmp_path / "other" / MANIFEST
    manifest.write_text(manifest.read_text().replace('"test/', f'"{SPLIT}/'))
    with pytest.raises(DatasetError, match="made from other episodes"):
        render(
            RenderConfig(recipe=tmp_path / "other", out=undisturbed), SMALL, Serial()
        )
    assert bytes_of(undisturbed) == before
