"""Lines of episodes: packed as they were, found beside results, refused if damaged."""

import json
import lzma
import sys
from collections.abc import Callable
from pathlib import Path
from shutil import copyfile
from typing import Any

import pytest
from clumsy import EPISODES as PLAYED
from clumsy import FAILED, KINDS, played_clumsily
from command import run
from made_up import ABOUT, row

from lemma.core.errors import DatasetError
from lemma.evaluation.analysis.comparison import compare
from lemma.evaluation.analysis.result import check_lines, read_result, summarise
from lemma.evaluation.lines import (
    lines_at,
    lines_beside,
    lines_in,
    packed_beside,
    read_lines,
    read_rows,
    result_beside,
    write_packed,
    write_rows,
)
from lemma.evaluation.records import ABOUT as NOTE
from lemma.evaluation.records import EPISODES, PACKED, SUMMARY, read_about
from lemma.evaluation.report.episodes import cases_of
from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.viz.pages.report import video_command

RESULTS = Path(__file__).parents[2] / "results"
ROWS = [row("pass", 0, success=True), row("stack", 0), row("stack", 1)]


def kept(path: Path, rows: list[dict[str, Any]] = ROWS) -> Path:
    """Write what is committed of a reproduction, and return the summary's file."""
    summarise(rows, ABOUT, "lemma reproduce").write(path)
    write_packed(packed_beside(path), rows)
    return path


@pytest.fixture(scope="module")
def committed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results as a fresh checkout has them: summaries and packed lines."""
    played = played_clumsily()
    folder = tmp_path_factory.mktemp("results")
    summary = folder / "clumsy" / "seed-0.json"
    summary.parent.mkdir()
    copyfile(played / SUMMARY, summary)
    write_packed(packed_beside(summary), read_rows(played))
    return folder


def test_packed_lines_are_the_lines_without_the_clock(committed: Path) -> None:
    path = committed / "clumsy" / "seed-0.json"
    (packed,) = lines_beside(path)
    assert packed.name == "seed-0.jsonl.xz"
    rows = read_lines(packed)
    assert len(rows) == PLAYED * len(KINDS)
    assert all("wall_s" not in one for one in rows)
    result = read_result(path)
    check_lines(result, rows, path, packed)
    assert read_about(packed) == result.about


def test_neither_order_nor_clock_shows_in_packed_bytes(tmp_path: Path) -> None:
    slower = [{**one, "wall_s": 9.0} for one in reversed(ROWS)]
    write_packed(tmp_path / f"a{PACKED}", ROWS)
    write_packed(tmp_path / f"b{PACKED}", slower)
    packed = (tmp_path / f"a{PACKED}").read_bytes()
    assert (tmp_path / f"b{PACKED}").read_bytes() == packed
    write_rows(tmp_path / EPISODES, ROWS)
    assert read_lines(tmp_path / f"b{PACKED}") == [
        {name: one[name] for name in one if name != "wall_s"} for one in ROWS
    ]
    # Any tool unpacks them: one line of JSON for each episode.
    lines = lzma.decompress(packed).decode().splitlines()
    assert [json.loads(line)["index"] for line in lines] == [0, 0, 1]


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def turned(content: bytes) -> bytes:
    return content[:40] + bytes([content[40] ^ 1]) + content[41:]


def plain(content: bytes) -> bytes:
    return lzma.decompress(content)


def another(content: bytes) -> bytes:
    return lzma.compress(b'{"task": "stack"}\n')


def half_a_line(content: bytes) -> bytes:
    return lzma.compress(lzma.decompress(content)[:-20])


def no_text(content: bytes) -> bytes:
    return lzma.compress(b"\xff\xfe")


def nothing(content: bytes) -> bytes:
    return b""


DAMAGE = [cut, turned, plain, another, half_a_line, no_text, nothing]


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_packed_lines_are_named(
    tmp_path: Path, damage: Callable[[bytes], bytes]
) -> None:
    path = kept(tmp_path / "seed-0.json")
    packed = packed_beside(path)
    packed.write_bytes(damage(packed.read_bytes()))
    asked: list[Callable[[], object]] = [
        lambda: read_results([tmp_path]),
        lambda: compare(path, path),
    ]
    for ask in asked:
        with pytest.raises(DatasetError, match=r"seed-0\.jsonl\.xz cannot be read: .+"):
            ask()


def test_a_damaged_line_is_numbered(tmp_path: Path) -> None:
    path = tmp_path / f"mine{PACKED}"
    write_packed(path, [*ROWS, {**ROWS[0], "index": 7, "protocol": 1}])
    with pytest.raises(DatasetError, match=r"Line 2 of .* protocol 1, .* fetch it"):
        read_lines(path)
    write_packed(path, [*ROWS, ROWS[0]])
    with pytest.raises(DatasetError, match="high_level pass 0 twice"):
        read_lines(path)


def test_packed_lines_of_other_episodes_do_not_fit(tmp_path: Path) -> None:
    path = kept(tmp_path / "seed-0.json")
    others = [{**one, "instruction": "Do it"} for one in ROWS]
    write_packed(packed_beside(path), others)
    with pytest.raises(DatasetError, match=r"does not fit .*jsonl\.xz: the same rates"):
        read_results([tmp_path])
    assert cases_of(entries_of([read_result(path)]), [path]) == (
        [],
        [packed_beside(path)],
    )


def test_python_without_lzma_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = kept(tmp_path / "seed-0.json")
    monkeypatch.setitem(sys.modules, "lzma", None)
    with pytest.raises(DatasetError, match="built without lzma"):
        read_results([path])


def test_packed_lines_come_before_those_that_went_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = kept(tmp_path / "reachnet" / "seed-0.json")
    played = tmp_path / "reachnet" / "seed-0"
    played.mkdir()
    # A reproduction that was begun anew, on another machine.
    write_rows(played / EPISODES, [row("stack", 0, success=True)])
    (found,) = read_results([tmp_path])
    assert found.cells[0].successes == 1
    assert lines_in(tmp_path) == lines_beside(path) == [packed_beside(path)]
    assert lines_at(played) == played / EPISODES
    packed_beside(path).unlink()
    assert lines_in(tmp_path) == lines_beside(path) == [played / EPISODES]
    assert result_beside(played / EPISODES) == path
    monkeypatch.chdir(played)
    assert lines_in(Path()) == [Path(EPISODES)]
    assert result_beside(Path(EPISODES)).samefile(path)


def test_one_result_is_meant(tmp_path: Path) -> None:
    paths = [kept(tmp_path / "a" / f"seed-{seed}.json") for seed in range(2)]
    packed = packed_beside(paths[1])
    # The folder that it was played into is not there.
    for name in (paths[1], packed, tmp_path / "a" / "seed-1"):
        assert lines_at(name) == packed
    with pytest.raises(DatasetError, match=r"2 results, such as .*seed-0\.json, .*1"):
        lines_at(tmp_path / "a")
    packed.unlink()
    assert lines_at(tmp_path / "a") == packed_beside(paths[0])
    with pytest.raises(DatasetError, match=r"no episodes in .*seed-1"):
        lines_at(paths[1])


def test_what_was_played_is_compared_with_what_is_committed(tmp_path: Path) -> None:
    path = kept(tmp_path / "results" / "seed-0.json")
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / NOTE).write_text(json.dumps(ABOUT))
    write_rows(mine / EPISODES, [row("pass", 0), *ROWS[1:]])
    for other in (path, path.parent):
        one = compare(mine, other).by_kind["high_level"]["all"]
        assert (one.episodes, one.only_second) == (3, 1)
    (mine / EPISODES).write_text("")
    with pytest.raises(DatasetError, match=r"no episodes in .*mine yet"):
        compare(mine, path)


@pytest.mark.slow
def test_verbs_find_episodes_in_a_fresh_checkout(
    committed: Path, tmp_path: Path
) -> None:
    for asked in (
        committed,
        committed / "clumsy",
        committed / "clumsy" / "seed-0.json",
        committed / "clumsy" / f"seed-0{PACKED}",
    ):
        cases, uncounted = cases_of(entries_of(read_results([asked])), [asked])
        assert sum(case.cause is not None for case in cases) == FAILED * len(KINDS)
        assert uncounted == []
    command = video_command(cases[1]).split()
    assert command[:2] == ["lemma", "report"]
    shown = ("--failures", 0, "--no-replays", "--out", tmp_path / "report")
    assert run("report", command[2], *shown) == 0
    page = (tmp_path / "report" / "index.html").read_text()
    assert f"of {FAILED * len(KINDS)} failed episodes have pictures" in page


@pytest.mark.slow
def test_failures_of_several_results_are_played(
    committed: Path, tmp_path: Path
) -> None:
    pytest.importorskip("viser")
    from lemma.viewer.failures import policies_of  # noqa: PLC0415
    from lemma.viewer.replays import cases_in, replays_in  # noqa: PLC0415

    for seed in range(2):
        found = json.loads((committed / "clumsy" / "seed-0.json").read_text())
        found["about"]["weights"] = {"x": {"sha256": "", "seed": seed, "data": {}}}
        (tmp_path / f"seed-{seed}.json").write_text(json.dumps(found))
        source = committed / "clumsy" / f"seed-0{PACKED}"
        copyfile(source, tmp_path / f"seed-{seed}{PACKED}")
    cases = cases_in(tmp_path)
    assert policies_of(cases) == ("clumsy:Clumsy, seed 0", "clumsy:Clumsy, seed 1")
    assert sum(case.cause is not None for case in cases) == 2 * FAILED * len(KINDS)
    count, replays = replays_in(tmp_path, None, None, 1)
    assert count == 1
    # A failure comes first, beside the expert.
    assert [side.success for side in next(replays).sides] == [False, True]


@pytest.mark.slow
def test_committed_lines_fit_their_summaries() -> None:
    published = sorted(RESULTS.rglob(f"*{PACKED}"))
    assert published, f"No result in {RESULTS} has its lines beside it."
    for packed in published:
        path = result_beside(packed)
        assert path.is_file(), f"{packed} lies beside no result"
        rows, result = read_lines(packed), read_result(path)
        check_lines(result, rows, path, packed)
        # No more than what is counted.
        assert len(rows) == sum(cell.episodes for cell in result.cells)
