"""Reading: on demand, by name, by part, and with next to nothing installed."""

import pickle
from pathlib import Path

import pytest
from interpreter import told_without
from recipes import made_up, small_recipe, write_recipe

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.dataset.recipe import files
from lemma.dataset.recipe.files import load, versions
from lemma.tasks.instance import BENCHMARK_VERSION


@pytest.fixture
def long_recipe(tmp_path: Path) -> Path:
    """Three row groups of one task, and one of another."""
    write_recipe(tmp_path, [made_up("stack", "train", i) for i in range(45)])
    write_recipe(tmp_path, [made_up("pass", "test", i) for i in range(5)])
    return tmp_path


def test_episodes_are_in_the_order_of_the_files(long_recipe: Path) -> None:
    recipe = load(long_recipe)
    assert len(recipe) == 50
    expected = [made_up("pass", "test", i) for i in range(5)]
    expected += [made_up("stack", "train", i) for i in range(45)]
    assert list(recipe) == expected
    assert recipe[-1] == expected[-1]
    with pytest.raises(IndexError):
        recipe[50]


def test_a_slice_is_a_recipe(long_recipe: Path) -> None:
    part = load(long_recipe)[10:14]
    assert [record.index for record in part] == [5, 6, 7, 8]
    assert [record.index for record in part[::-2]] == [8, 6]


def test_parts_by_task_and_split(long_recipe: Path) -> None:
    recipe = load(long_recipe)
    assert len(recipe.select(task="stack")) == 45
    assert len(recipe.select(split="test")) == 5
    assert len(recipe.select(task="stack", split="test")) == 0
    assert {path.name for path in recipe.files()} == {"pass.parquet", "stack.parquet"}
    assert recipe.select(task="pass").files()[0].parent.name == "test"


def test_columns_are_read_alone(long_recipe: Path) -> None:
    rows = list(load(long_recipe)[4:7].rows("task", "index"))
    assert rows == [
        {"task": "pass", "index": 4},
        {"task": "stack", "index": 0},
        {"task": "stack", "index": 1},
    ]


def test_an_episode_is_found_by_name(long_recipe: Path) -> None:
    assert load(long_recipe).find("stack", "train", 41) == made_up("stack", "train", 41)
    with pytest.raises(InvalidConfigError, match=r"no episode stack/train/45.*inspect"):
        load(long_recipe).find("stack", "train", 45)


def test_row_groups_cover_every_episode_once(long_recipe: Path) -> None:
    groups = load(long_recipe).groups()
    assert [(path.stem, group, len(rows)) for path, group, rows in groups] == [
        ("pass", 0, 5),
        ("stack", 0, 20),
        ("stack", 1, 20),
        ("stack", 2, 5),
    ]
    path, group, rows = load(long_recipe)[28:30].groups()[0]
    assert (path.stem, group, rows) == ("stack", 1, (3, 4))


def test_few_groups_are_kept(
    long_recipe: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[int] = []
    read = files.read_group

    def count(path: Path, group: int) -> list[object]:
        reads.append(group)
        return list(read(path, group))

    monkeypatch.setattr(files, "read_group", count)
    monkeypatch.setattr(files, "_KEPT_GROUPS", 2)
    recipe = load(long_recipe)
    for index in (5, 6, 25, 5, 45, 25, 5):
        recipe[index]
    # The third group drives out the second, which then drives out the first.
    assert reads == [0, 1, 2, 1, 0]


def test_loader_workers_get_places_only(long_recipe: Path) -> None:
    recipe = load(long_recipe)
    fresh = len(pickle.dumps(recipe))
    assert len(list(recipe)) == 50
    assert len(pickle.dumps(recipe)) == fresh
    assert list(pickle.loads(pickle.dumps(recipe))) == list(recipe)


def test_an_empty_folder_is_no_recipe(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(DatasetError, match="lemma generate"):
            load(folder)


def test_the_files_of_another_engine_can_still_be_read(tmp_path: Path) -> None:
    write_recipe(
        tmp_path, [made_up()], {**versions(BENCHMARK_VERSION), "mujoco": "4.0.0"}
    )
    assert load(tmp_path)[0] == made_up()


def test_reading_needs_neither_simulator_nor_torch() -> None:
    blocked = ("mujoco", "torch", "numba", "scipy", "ray", "huggingface_hub", "PIL")
    code = (
        "import lemma\n"
        "from lemma.dataset.recipe import schema\n"
        f"recipe = lemma.load({str(small_recipe())!r})\n"
        "record = recipe.find('stack', 'test', 2)\n"
        "assert record.state(0).dtype == '<f8' and record.state(0).size > 100\n"
        "assert schema.from_table(schema.to_table([record])) == [record]\n"
        'print(record.key, len(list(recipe.rows("key"))), record.digest()[:4])\n'
    )
    digest = load(small_recipe()).find("stack", "test", 2).digest()[:4]
    assert (
        told_without(blocked, code) == f"{BENCHMARK_VERSION}/stack/test/2 12 {digest}\n"
    )
