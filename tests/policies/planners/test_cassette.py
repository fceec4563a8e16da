"""Cassettes: the same answer to the same request, whoever wrote it and when."""

import json
import multiprocessing
from pathlib import Path
from typing import Any

import pytest

from lemma.core.errors import DatasetError
from lemma.policies.planners.cassette import Cassette, differences, key_of
from lemma.policies.planners.chat import Reply


def request(text: str = "go", **changes: Any) -> dict[str, Any]:
    messages = [
        {"role": "system", "content": "Obey.\nAnswer."},
        {"role": "user", "content": text},
    ]
    return {"model": "m", "temperature": 0, "messages": messages, **changes}


def test_what_was_kept_is_found_by_another_reader(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "c.jsonl"
    writer, reader = Cassette(path), Cassette(path)
    assert reader.find(request()) is None
    odd = Reply("\ud800 \x00 {", 3, 4)
    assert writer.keep(request(), odd) == odd
    failed = Reply(failure="timeout", explanation="Late.")
    writer.keep(request("b"), failed)
    assert reader.find(request()) == Cassette(path).find(request()) == odd
    assert reader.find(request("b")) == failed


def test_the_order_of_fields_is_no_matter_and_everything_else_is() -> None:
    one = request()
    assert key_of(one) == key_of(dict(reversed(one.items())))
    others = [request("Go"), request(model="n"), request(seed=0)]
    assert len({key_of(each) for each in (one, *others)}) == 4


def test_the_first_answer_counts(tmp_path: Path) -> None:
    first, second = Cassette(tmp_path / "c"), Cassette(tmp_path / "c")
    assert second.find(request()) is None
    first.keep(request(), Reply("a"))
    assert second.keep(request(), Reply("b")) == Reply("a")
    assert len((tmp_path / "c").read_bytes().splitlines()) == 1


def _write(path: Path, first: int) -> None:
    cassette = Cassette(path)
    for number in range(30):
        # Half of the requests are everybody's.
        name = number if number % 2 else number + first
        cassette.keep(request(f"{name}"), Reply(f"{name}"))


@pytest.mark.slow
def test_processes_write_one_file(tmp_path: Path) -> None:
    path = tmp_path / "c.jsonl"
    context = multiprocessing.get_context("spawn")
    writers = [
        context.Process(target=_write, args=(path, 100 * number)) for number in (1, 2)
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert len(lines) == len({line["key"] for line in lines}) == 15 + 2 * 15
    reader = Cassette(path)
    assert reader.find(request("29")) == Reply("29")
    assert reader.find(request("228")) == Reply("228")


@pytest.mark.parametrize("cut", [40, -1])
def test_a_last_line_that_has_no_end_is_written_over_or_kept(
    tmp_path: Path, cut: int
) -> None:
    """A killed writer has begun it; or all of it is there but the line break."""
    path = tmp_path / "c.jsonl"
    writer = Cassette(path)
    writer.keep(request("a"), Reply("a"))
    first = path.read_bytes()
    path.write_bytes(first[:cut] if cut < 0 else first + first[:cut])
    cassette = Cassette(path)
    assert cassette.find(request("b")) is None
    cassette.keep(request("b"), Reply("b"))
    assert path.read_bytes().startswith(first)
    again = Cassette(path)
    assert [again.find(request(n)) for n in "ab"] == [Reply("a"), Reply("b")]


@pytest.mark.parametrize(
    "line",
    [
        b"no JSON\n",
        b"[]\n",
        b'{"another": "file"}',
        b'{"key": "a"}\n',
        b"[" * 100_000 + b"\n",
        json.dumps({"key": "0", "request": {}, "reply": {"content": "x"}}).encode()
        + b"\n",
        b"\xff\xfe\n",
    ],
    ids=["text", "list", "another", "fields", "deep", "edited", "bytes"],
)
def test_a_damaged_line_is_named(tmp_path: Path, line: bytes) -> None:
    path = tmp_path / "c.jsonl"
    Cassette(path).keep(request(), Reply("a"))
    path.write_bytes(path.read_bytes() + line)
    with pytest.raises(DatasetError, match=r"Line 2 of .*c\.jsonl"):
        Cassette(path).find(request("other"))


@pytest.mark.parametrize(
    ("now", "told"),
    [
        (request("go", model="n"), "'model=\"m\"' became 'model=\"n\"'"),
        (request("go", seed=3), "'' became 'seed=3'"),
        (request("went"), "'go' became 'went'"),
        (request("go\non"), "'' became 'on'"),
    ],
)
def test_what_changed_is_told(tmp_path: Path, now: dict[str, Any], told: str) -> None:
    assert differences(request(), now) == [told]
    cassette = Cassette(tmp_path / "c.jsonl")
    cassette.keep(request("something else altogether", model="x", top=1), Reply())
    cassette.keep(request(), Reply())
    error = str(cassette.missing(now, "Nobody is asked."))
    assert told in error
    assert "line 2" in error
    assert "--cassette-mode record" in error


def test_an_empty_cassette_says_so(tmp_path: Path) -> None:
    error = Cassette(tmp_path / "c.jsonl").missing(request(), "Nobody is asked.")
    assert "is empty" in str(error)


def test_blank_lines_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "c"
    Cassette(path).keep(request("a"), Reply("a"))
    path.write_bytes(b"\n" + path.read_bytes() + b"\r\n\n")
    cassette = Cassette(path)
    assert cassette.find(request("a")) == Reply("a")
    cassette.keep(request("b"), Reply("b"))
    assert Cassette(path).find(request("b")) == Reply("b")
    assert "line 2" in str(cassette.missing(request("c"), "No."))


def test_what_is_no_file_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file" / "c"):
        with pytest.raises(DatasetError, match=r"cassette .* cannot be written"):
            Cassette(path).keep(request(), Reply())
    with pytest.raises(DatasetError, match=r"cassette .* cannot be read"):
        Cassette(tmp_path).find(request())
