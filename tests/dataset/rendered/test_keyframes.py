"""The files of keyframes, filled with noise: no scene, no OpenGL."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from interpreter import told_without

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.dataset.recipe.files import METADATA_KEY
from lemma.dataset.rendered.keyframes import (
    FORM,
    KEYFRAMES_VERSION,
    PARTS,
    Header,
    KeyframeFile,
    camera_columns,
    describe,
    map_columns,
    write_keyframes,
)
from lemma.scene.raster import Raster

RASTER = Raster(rows=6, columns=10, cell_m=0.3, floor_m=-0.1)
HEADER = Header(
    form=FORM,
    part="maps",
    version=KEYFRAMES_VERSION,
    versions={"lemma": "0.1.0", "mujoco": "3.17.0"},
    renderer="noise",
    robots=2,
    width=8,
    height=4,
    raster=RASTER,
    entities=("red_cube", "blue_pad", "stick"),
    digests=("a", "b"),
    keyframes=(3, 2),
)


def noise(count: int) -> list[dict[str, Any]]:
    random = np.random.default_rng(5)
    columns = {**map_columns(HEADER), **camera_columns(HEADER)}

    def value(name: str, kind: pa.DataType, row: int) -> Any:
        if isinstance(kind, pa.FixedShapeTensorType):
            dtype = pa.array([], kind.value_type).to_numpy().dtype
            if dtype.kind == "u":
                return random.integers(0, np.iinfo(dtype).max, kind.shape, dtype)
            return random.normal(size=kind.shape)
        if pa.types.is_string(kind):
            return f"{name} {row}"
        return float(row) / 3 if pa.types.is_floating(kind) else row

    return [
        {name: value(name, kind, row) for name, (kind, _) in columns.items()}
        for row in range(count)
    ]


def write(folder: Path, rows: Any) -> dict[str, Path]:
    paths = {part: folder / part / "train" / "stack-000.arrow" for part in PARTS}
    files = [(path, replace(HEADER, part=part)) for part, path in paths.items()]
    write_keyframes(files, rows)
    return paths


def same(found: Any, expected: Any) -> bool:
    if isinstance(expected, np.ndarray):
        return found.dtype == expected.dtype and np.array_equal(found, expected)
    return bool(found == expected)


def test_what_is_written_is_read_bit_for_bit_in_any_order(tmp_path: Path) -> None:
    rows = noise(5)
    paths = write(tmp_path, iter(rows))
    seen = set()
    for path in paths.values():
        file = KeyframeFile(path)
        assert len(file) == 5
        for row in (3, 0, 4, 4, 1, 2):
            for name, value in file[row].items():
                assert same(value, rows[row][name]), name
                seen.add(name)
    assert seen == set(rows[0])


def test_the_header_comes_back(tmp_path: Path) -> None:
    paths = write(tmp_path, noise(5))
    for part, path in paths.items():
        assert KeyframeFile(path).header == replace(HEADER, part=part)


def test_only_columns_that_are_asked_for_are_read(tmp_path: Path) -> None:
    path = write(tmp_path, noise(2))["maps"]
    assert set(KeyframeFile(path, ("map_height", "key"))[1]) == {"map_height", "key"}
    with pytest.raises(UnknownNameError, match="Did you mean 'map_height'"):
        KeyframeFile(path, ("map_heights",))


@pytest.mark.parametrize("compressed", [True, False])
def test_arrays_can_be_changed_and_the_file_stays(
    tmp_path: Path, compressed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not compressed:
        # As other libraries may write it: then arrays would be the file itself.
        codecs = dict.fromkeys(PARTS)
        monkeypatch.setattr("lemma.dataset.rendered.keyframes._CODECS", codecs)
    path = write(tmp_path, noise(1))["maps"]
    file = KeyframeFile(path)
    before = path.read_bytes()
    first = file[0]
    for value in first.values():
        if isinstance(value, np.ndarray):
            value[...] = 1
    assert file[0]["map_rgb"].max() > 1
    assert path.read_bytes() == before


def test_any_arrow_library_can_read_the_images(tmp_path: Path) -> None:
    rows = noise(3)
    path = write(tmp_path, rows)["cameras"]
    table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    column = table["depth"].combine_chunks()
    assert np.array_equal(column.to_numpy_ndarray()[2], rows[2]["depth"])


def test_writing_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def rows() -> Iterator[dict[str, Any]]:
        yield from noise(2)
        raise OSError(28, "No space left on device")

    with pytest.raises(DatasetError, match="disk is full"):
        write(tmp_path, rows())
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def other_header(path: Path, **changes: Any) -> None:
    header = json.loads(HEADER.schema().metadata[METADATA_KEY])
    text = json.dumps({**header, **changes}).encode()
    schema = pa.schema([pa.field("key", pa.string())], metadata={METADATA_KEY: text})
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_file(sink, schema):
        pass


def test_another_version_is_explained(tmp_path: Path) -> None:
    other_header(tmp_path / "new.arrow", version="99", versions={"lemma": "7.0"})
    with pytest.raises(DatasetError, match=r"version 99.*reads version 1.*\(7.0\)"):
        KeyframeFile(tmp_path / "new.arrow")


def test_other_arrow_files_are_refused(tmp_path: Path) -> None:
    other_header(tmp_path / "other.arrow", form="sounds")
    with pytest.raises(DatasetError, match="has no rendered keyframes"):
        KeyframeFile(tmp_path / "other.arrow")


def test_every_column_is_described() -> None:
    text = describe()
    for name in (*map_columns(HEADER), *camera_columns(HEADER)):
        assert f"| `{name}` |" in text
    assert "uint16[2, 480, 640]" in text


def test_reading_needs_neither_mujoco_nor_torch(tmp_path: Path) -> None:
    path = write(tmp_path, noise(1))["maps"]
    code = (
        "from pathlib import Path\n"
        "import lemma.dataset.rendered.dataset\n"
        "from lemma.dataset.rendered.keyframes import KeyframeFile\n"
        f"print(KeyframeFile(Path({str(path)!r}))[0]['map_rgb'].shape)\n"
    )
    assert told_without(("mujoco", "torch"), code) == "(6, 10, 3)\n"


def test_the_documentation_shows_the_columns() -> None:
    page = Path(__file__).parents[3] / "docs" / "rendered_format.md"
    text = page.read_text()
    assert all(f"```{{columns}} {part}\n" in text for part in PARTS)
