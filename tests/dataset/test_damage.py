"""Damaged files of every format: each is named, with the command that writes it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from painted_keyframes import write_painted
from recipes import made_up, write_recipe

from lemma.core.errors import DatasetError
from lemma.dataset.recipe.files import load, read_table
from lemma.dataset.rendered.dataset import KeyframeDataset
from lemma.dataset.rendered.keyframes import KeyframeFile

Damage = Callable[[bytes], bytes]


def zeroed(data: bytes) -> bytes:
    """Overwrite the middle: states of a recipe, images of keyframes."""
    middle, width = len(data) // 2, len(data) // 4
    start = middle - width // 2
    return data[:start] + bytes(width) + data[start + width :]


DAMAGES: dict[str, Damage] = {
    "empty": lambda data: b"",
    "a beginning": lambda data: data[:10],
    "half": lambda data: data[: len(data) // 2],
    "without its end": lambda data: data[:-40],
    "without its last byte": lambda data: data[:-1],
    "zeroed in the middle": zeroed,
}


def recipe_file(folder: Path) -> Path:
    return write_recipe(folder, [made_up(index=i) for i in range(40)])


def keyframe_file(folder: Path) -> Path:
    write_painted(folder, {"val": 3})
    return next(folder.glob("maps/*/*.arrow"))


READERS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], Any], str]] = {
    "a table": (recipe_file, read_table, "lemma generate"),
    "a recipe": (
        recipe_file,
        lambda path: list(load(path.parents[1])),
        "lemma generate",
    ),
    "keyframes": (
        keyframe_file,
        lambda path: [
            KeyframeFile(path)[row] for row in range(len(KeyframeFile(path)))
        ],
        "lemma render",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("reader", READERS)
def test_a_damaged_file_is_named_and_explained(
    tmp_path: Path, reader: str, damage: str
) -> None:
    make, read, command = READERS[reader]
    path = make(tmp_path)
    read(path)
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    with pytest.raises(DatasetError, match=f"(?s){path.name} is damaged.*{command}"):
        read(path)
    path.unlink()
    if reader != "a recipe":
        with pytest.raises(
            DatasetError, match=f"(?s){path.name} is damaged.*{command}"
        ):
            read(path)


@pytest.mark.parametrize("change", [lambda data: data[:-9], lambda data: data + b"x"])
def test_sizes_of_keyframes_are_compared_with_the_manifest(
    tmp_path: Path, change: Damage
) -> None:
    path = keyframe_file(tmp_path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(DatasetError, match=r"bytes, but \d+ in manifest.json"):
        KeyframeDataset(tmp_path, "val")
