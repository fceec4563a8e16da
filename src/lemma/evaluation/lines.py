"""Reading, writing, packing and finding files with lines of episodes.

An evaluation writes ``episodes.jsonl`` into its own folder. A published result,
``seed-0.json``, has the same lines packed beside it, ``seed-0.jsonl.xz``. Packed lines
lack the fields that depend on the machine, so equal episodes have equal lines.
"""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType

from lemma.core.errors import DatasetError
from lemma.core.files import write_text, write_whole
from lemma.evaluation.records import (
    EPISODES,
    PACKED,
    SUMMARY,
    WALL_CLOCK,
    EpisodeKey,
    Row,
    check_line,
    key_of,
    place_of,
)

MOST_LINE = 1 << 21
"""Largest length of an episode's line [bytes]. 100 sub-tasks take 0.1 MB; the longest
lines have a grasp and a release in every control step."""
MOST_UNPACKED = 100_000_000
"""Largest size of an unpacked file [bytes], against decompression bombs. The 1,920
episodes of a published result take up to 10 MB."""


def read_rows(folder: Path) -> list[Row]:
    """Return the lines of episodes in a folder; an empty list without a file.

    Raises:
        DatasetError: The file is damaged.
    """
    path = folder / EPISODES
    return read_lines(path) if path.exists() else []


def read_lines(path: Path) -> list[Row]:
    """Return the lines of a file, packed or not.

    Raises:
        DatasetError: The file is missing or damaged, or has an episode twice.
    """
    number = 0
    rows: dict[EpisodeKey, Row] = {}
    try:
        for line in _lines(path):
            number += 1
            row = json.loads(line, parse_constant=_refuse)
            check_line(row)
            if key_of(row) in rows:
                raise ValueError(f"episode {' '.join(map(str, key_of(row)))} twice")
            rows[key_of(row)] = row
    except (OSError, ValueError, RecursionError) as why:
        where = f"Line {number} of {path}" if number else str(path)
        again = "evaluate again"
        if path.name.endswith(PACKED):
            again = "fetch it again"
        raise DatasetError(
            f"{where} cannot be read: {why}. Remove the file and {again}."
        ) from why
    return list(rows.values())


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file, with only one in memory at a time.

    Raises:
        ValueError: A line is too long, the packed data are too large or damaged, or the
            text is not UTF-8.
    """
    rest = b""
    for piece in _pieces(path):
        *whole, rest = (rest + piece).split(b"\n")
        for line in whole:
            yield line.decode()
        if len(rest) > MOST_LINE:
            raise ValueError(f"a line is longer than {MOST_LINE:,} bytes")
    if rest:
        yield rest.decode()


def _pieces(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        if not path.name.endswith(PACKED):
            yield from iter(lambda: file.read(_PIECE), b"")
            return
        lzma = _lzma()
        unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MOST_MEMORY)
        total = 0
        try:
            while not unpacker.eof:
                more = file.read(_PIECE) if unpacker.needs_input else b""
                if unpacker.needs_input and not more:
                    raise ValueError("its end is missing")
                piece = unpacker.decompress(more, _PIECE)
                total += len(piece)
                if total > MOST_UNPACKED:
                    raise ValueError(f"it unpacks to over {MOST_UNPACKED:,} bytes")
                yield piece
        except lzma.LZMAError as error:
            raise ValueError(str(error)) from error


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Write lines of episodes, atomically."""
    write_text(path, _text(rows))


def write_packed(path: Path, rows: Iterable[Row]) -> None:
    """Write packed lines of episodes, atomically.

    Args:
        path: The file, ``NAME.jsonl.xz``.
        rows: Lines in any order; fields that depend on the machine are left out.
    """
    kept = (
        {name: value for name, value in row.items() if name not in WALL_CLOCK}
        for row in sorted(rows, key=place_of)
    )
    lzma = _lzma()
    # "extreme" is 8 % smaller and takes some seconds. The format has no time stamps.
    preset = 9 | lzma.PRESET_EXTREME
    packed: bytes = lzma.compress(_text(kept).encode(), preset=preset)

    def write(draft: Path) -> None:
        draft.write_bytes(packed)

    write_whole(path, write)


def packed_beside(result: Path) -> Path:
    """Return the path of the packed lines of a result's file."""
    return result.with_name(result.name.removesuffix(".json") + PACKED)


def lines_beside(result: Path) -> list[Path]:
    """Return the file with the lines of a result: one or none.

    Packed lines have priority, because they were written with the result, while the
    evaluation may have continued since then.

    Args:
        result: File of the result, ``summary.json`` or ``NAME.json``.
    """
    if result.name == SUMMARY:
        found = [result.with_name(EPISODES)]
    else:
        found = [packed_beside(result), result.with_suffix("") / EPISODES]
    return [path for path in found if path.is_file()][:1]


def result_beside(lines: Path) -> Path:
    """Return the path of the result that belongs to a file of lines."""
    if lines.name.endswith(PACKED):
        return lines.with_name(lines.name.removesuffix(PACKED) + ".json")
    own, folder = lines.with_name(SUMMARY), lines.parent
    if folder.name in ("", ".."):
        # Relative paths such as "." have no name.
        folder = folder.resolve()
    # A reproduction writes its summary beside the folder.
    return own if own.is_file() else folder.with_name(f"{folder.name}.json")


def is_lines(path: Path) -> bool:
    """Return whether a path has the name of a file of lines."""
    return path.name == EPISODES or path.name.endswith(PACKED)


def lines_in(path: Path) -> list[Path]:
    """Return the files of lines of a path, one for each result.

    Args:
        path: A file of lines; their result, ``seed-0.json`` or ``seed-0``; or a folder
            with such files at any depth.
    """
    if is_lines(path):
        return [path]
    if not path.is_dir():
        return lines_beside(path)
    files = sorted(file for file in path.rglob("*") if is_lines(file))
    packed = {result_beside(file) for file in files if file.name != EPISODES}
    return [
        file
        for file in files
        if file.name != EPISODES or result_beside(file) not in packed
    ]


def lines_at(path: Path) -> Path:
    """Return the lines of one result.

    Args:
        path: As for :func:`lines_in`; in a folder ``episodes.jsonl`` has priority.

    Raises:
        DatasetError: There are no lines, or those of several results.
    """
    own = path / EPISODES
    if own.is_file():
        return own
    found = lines_in(path)
    if not found:
        raise DatasetError(
            f"There are no episodes in {path}: neither {EPISODES} of 'lemma evaluate' "
            f"nor NAME{PACKED} of 'lemma reproduce'. The command in the result "
            "creates them again."
        )
    if len(found) > 1:
        named = ", ".join(str(result_beside(file)) for file in found[:_MOST_NAMED])
        raise DatasetError(
            f"{path} holds the episodes of {len(found)} results, such as {named}. "
            "Name one of them."
        )
    return found[0]


_MOST_NAMED = 3
_PIECE = 1 << 16
_MOST_MEMORY = 128 << 20
"""Memory for unpacking [bytes]; published files need 65 MB."""


def _text(rows: Iterable[Row]) -> str:
    return "".join(json.dumps(row) + "\n" for row in rows)


def _lzma() -> ModuleType:
    """Return the module ``lzma`` of the standard library.

    Raises:
        DatasetError: This Python was built without it.
    """
    try:
        import lzma  # noqa: PLC0415
    except ImportError as error:
        raise DatasetError(
            "This Python was built without lzma, which packed lines need. Install "
            "liblzma's headers (liblzma-dev, xz-devel) and build it again, or take "
            "another Python."
        ) from error
    return lzma


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no number of JSON")
