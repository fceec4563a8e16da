"""Lines of episodes in files: read, written, packed, and found beside their results.

An evaluation writes ``episodes.jsonl`` into a folder of its own. Beside a published
result, ``seed-0.json``, lie the same lines packed, ``seed-0.jsonl.xz``. Fields that
depend on the machine are left out, so the same episodes are the same lines.
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
"""Length of the line of an episode [bytes]. 100 sub-tasks take 0.1 MB; a gripper that
grasps and lets go in every control step takes most."""
MOST_UNPACKED = 100_000_000
"""Most that a packed file may hold [bytes], since a small one can unpack to anything.
The 1,920 episodes of a published result take up to 10 MB."""


def read_rows(folder: Path) -> list[Row]:
    """Return the episodes that were played into a folder; none if there are none yet.

    Raises:
        DatasetError: The file is damaged.
    """
    path = folder / EPISODES
    return read_lines(path) if path.exists() else []


def read_lines(path: Path) -> list[Row]:
    """Return lines of episodes, packed or not.

    Raises:
        DatasetError: The file is missing or damaged, or holds an episode twice.
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
            again = "fetch it again, or do without lines"
        raise DatasetError(
            f"{where} cannot be read: {why}. Remove the file and {again}."
        ) from why
    return list(rows.values())


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file, of which no more than one is held at a time.

    Raises:
        ValueError: A line is too long, what was packed is too much or damaged, or it is
            not UTF-8.
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
    """Write lines of episodes, all of them or none."""
    write_text(path, _text(rows))


def write_packed(path: Path, rows: Iterable[Row]) -> None:
    """Write lines of episodes packed, all of them or none.

    Args:
        path: The file, ``NAME.jsonl.xz``.
        rows: In any order; what depends on the machine is left out.
    """
    kept = (
        {name: value for name, value in row.items() if name not in WALL_CLOCK}
        for row in sorted(rows, key=place_of)
    )
    lzma = _lzma()
    # 8 % smaller than without "extreme", for some seconds; there is no clock in it.
    preset = 9 | lzma.PRESET_EXTREME
    packed: bytes = lzma.compress(_text(kept).encode(), preset=preset)

    def write(draft: Path) -> None:
        draft.write_bytes(packed)

    write_whole(path, write)


def packed_beside(result: Path) -> Path:
    """Return where the packed lines of the file of a result are, if there are any."""
    return result.with_name(result.name.removesuffix(".json") + PACKED)


def lines_beside(result: Path) -> list[Path]:
    """Return the file with the lines of a result: one or none.

    Packed lines come first, which were written with the result. The evaluation may
    have gone on since then.

    Args:
        result: Its file, ``summary.json`` or ``NAME.json``.
    """
    if result.name == SUMMARY:
        found = [result.with_name(EPISODES)]
    else:
        found = [packed_beside(result), result.with_suffix("") / EPISODES]
    return [path for path in found if path.is_file()][:1]


def result_beside(lines: Path) -> Path:
    """Return the file of the result that lines lie beside, if there is one."""
    if lines.name.endswith(PACKED):
        return lines.with_name(lines.name.removesuffix(PACKED) + ".json")
    own, folder = lines.with_name(SUMMARY), lines.parent
    if folder.name in ("", ".."):
        # The current folder and the one above are written without their names.
        folder = folder.resolve()
    # A reproduction keeps its summary beside the folder.
    return own if own.is_file() else folder.with_name(f"{folder.name}.json")


def is_lines(path: Path) -> bool:
    """Whether a path is named as lines are."""
    return path.name == EPISODES or path.name.endswith(PACKED)


def lines_in(path: Path) -> list[Path]:
    """Return the files of lines that somebody means, each result's once.

    Args:
        path: Lines; the result that they lie beside, ``seed-0.json`` or ``seed-0``; or
            a folder that holds some at any depth.
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
        path: As for :func:`lines_in`, but of a folder with ``episodes.jsonl`` these.

    Raises:
        DatasetError: There are none, or those of several results.
    """
    own = path / EPISODES
    if own.is_file():
        return own
    found = lines_in(path)
    if not found:
        raise DatasetError(
            f"There are no episodes in {path}: neither {EPISODES}, which 'lemma "
            f"evaluate' writes, nor NAME{PACKED}, which lies beside a result of "
            "'lemma reproduce'. The command of the result makes them again."
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
    """Return the module of the standard library, which some Pythons are built without.

    Raises:
        DatasetError: This one is.
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
