"""The schema: what goes in comes out, and every part of it counts."""

import math
from dataclasses import fields, replace
from pathlib import Path

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recipes import made_up

from lemma.dataset.recipe.schema import (
    SCHEMA,
    EpisodeRecord,
    SubTaskRecord,
    describe,
    from_table,
    to_table,
)
from lemma.tasks.instance import Instance

ROOT = Path(__file__).parents[3]

words = st.text(max_size=12)
numbers = st.floats(allow_nan=False)
poses = st.tuples(numbers, numbers, numbers)
subtasks = st.builds(
    SubTaskRecord,
    **{name: words for name in ("robot", "primitive", "pick", "place")},
    instruction=words,
    pick_pose=poses,
    place_pose=poses,
    outcome=words,
    start_s=numbers,
    duration_s=numbers,
)


def tuples(of: st.SearchStrategy[object]) -> st.SearchStrategy[tuple[object, ...]]:
    return st.lists(of, max_size=4).map(tuple)


records = st.builds(
    EpisodeRecord,
    **{name: words for name in ("key", "task", "split", "team", "instance")},
    **{name: words for name in ("high_level", "human", "unseen", "instance_sha256")},
    index=st.integers(0, 2**31 - 1),
    distractors=st.integers(0, 127),
    subtasks=tuples(subtasks),
    keyframe_time_s=tuples(numbers),
    keyframe_state=tuples(st.binary(max_size=40)),
    keyframe_sha256=tuples(words),
    success=st.booleans(),
    progress=numbers,
    failure=st.none() | words,
    elapsed_s=numbers,
    idle_s=tuples(numbers),
)


@given(st.lists(records, max_size=4))
def test_what_goes_in_comes_out(found: list[EpisodeRecord]) -> None:
    table = to_table(found)
    assert table.schema.equals(SCHEMA)
    assert from_table(table) == found


def test_a_record_has_exactly_the_columns() -> None:
    assert [field.name for field in fields(EpisodeRecord)] == SCHEMA.names
    struct = SCHEMA.field("subtasks").type.value_type
    assert [field.name for field in fields(SubTaskRecord)] == [f.name for f in struct]


def test_only_the_failure_may_be_missing() -> None:
    assert [field.name for field in SCHEMA if field.nullable] == ["failure"]
    with pytest.raises(TypeError, match="missing"):
        EpisodeRecord()  # type: ignore[call-arg]


@pytest.mark.parametrize(
    "change",
    [
        {"instance": "{}"},
        {"subtasks": ()},
        {"keyframe_time_s": (0.0,)},
        {"keyframe_sha256": ("00",)},
        {"success": False},
        {"progress": 0.5},
        {"failure": "timeout"},
        {"elapsed_s": 1.0},
        {"idle_s": (0.0, 0.0)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_the_digest_notices_every_change(change: dict[str, object]) -> None:
    record = made_up()
    assert replace(record, **change).digest() != record.digest()  # type: ignore[arg-type]


@pytest.mark.parametrize("field", [field.name for field in fields(SubTaskRecord)])
def test_the_digest_notices_every_change_of_a_subtask(field: str) -> None:
    record = made_up()
    row = record.subtasks[0]
    found = getattr(row, field)
    changed: object = f"{found}."
    if isinstance(found, float):
        changed = math.nextafter(found, math.inf)
    elif isinstance(found, tuple):
        changed = (*found[:2], math.nextafter(found[2], math.inf))
    other = replace(row, **{field: changed})  # type: ignore[arg-type]
    rows = (other, *record.subtasks[1:])
    assert replace(record, subtasks=rows).digest() != record.digest()


def test_a_record_gives_back_states_and_instance() -> None:
    record = made_up(keyframes=4)
    assert record.keyframes == 4
    assert record.state(2).tobytes() == record.keyframe_state[2]
    instance = Instance.from_dict(record.instance_data())
    assert instance.sha256() == record.instance_sha256


def test_every_column_is_described_in_the_file_itself() -> None:
    assert all(field.metadata[b"description"] for field in SCHEMA)
    assert [line.split("`")[1] for line in describe().splitlines()[2:]] == SCHEMA.names
    assert pa.types.is_struct(SCHEMA.field("subtasks").type.value_type)


def test_the_page_about_the_format_shows_the_columns() -> None:
    page = (ROOT / "docs" / "dataset_format.md").read_text(encoding="utf-8")
    assert all(f"```{{columns}} {name}\n" in page for name in ("recipe", "perturbed"))
