"""Cassettes: recorded requests to language models with their replies, as JSON lines.

The key of a line is the SHA-256 of the request as canonical JSON, so replay needs no
server and gives the same replies in any order and in any number of processes. If two
processes get different replies to one request, both use the one that was written first.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from difflib import SequenceMatcher
from pathlib import Path
from threading import Lock
from typing import Any

import msgspec
from filelock import FileLock

from lemma.core.errors import DatasetError
from lemma.policies.planners.chat import PlannerUnavailableError, Reply

_LOCK = ".lock"
_BEGIN = b'{"key": "'
"""First bytes of every line."""
_SHOWN = 90
_MOST = 3


class _Line(msgspec.Struct):
    key: str
    request: dict[str, Any]
    reply: Reply


def key_of(request: Mapping[str, Any]) -> str:
    """Return the key of a request: the SHA-256 of its canonical JSON."""
    text = json.dumps(request, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class Cassette:
    """A file of recorded replies, safe for several threads and processes."""

    def __init__(self, path: Path) -> None:
        """Store the path; the first request reads the file.

        Args:
            path: The file, which need not exist yet.
        """
        self.path = path
        self._replies: dict[str, Reply] = {}
        self._end = 0
        self._lines = 0
        self._lock = Lock()

    def find(self, request: Mapping[str, Any]) -> Reply | None:
        """Return the recorded reply to a request, or None.

        Raises:
            DatasetError: The file is damaged.
        """
        key = key_of(request)
        with self._lock, self._explained("read"):
            if key not in self._replies:
                self._read_on()
            return self._replies.get(key)

    def keep(self, request: Mapping[str, Any], reply: Reply) -> Reply:
        """Record a reply and return it; an earlier reply to the request has priority.

        Raises:
            DatasetError: The file is damaged, or cannot be written.
        """
        key = key_of(request)
        line = {"key": key, "request": request, "reply": asdict(reply)}
        data = json.dumps(line, sort_keys=True).encode() + b"\n"
        with self._explained("written"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self._lock, FileLock(f"{self.path}{_LOCK}"):
                self._read_on()
                if key not in self._replies:
                    self._append(data)
                    self._replies[key] = reply
                return self._replies[key]

    @contextmanager
    def _explained(self, what: str) -> Iterator[None]:
        """Convert OS errors to one sentence.

        Raises:
            DatasetError: The file cannot be used.
        """
        try:
            yield
        except OSError as error:
            raise DatasetError(
                f"The cassette {self.path} cannot be {what}: "
                f"{error.strerror or error}. Name a file that you may read and write; "
                "what was written before is not lost."
            ) from error

    def _append(self, data: bytes) -> None:
        """Append a line; replace an incomplete last line of a killed process."""
        with self.path.open("r+b" if self.path.exists() else "xb+") as file:
            file.truncate(self._end)
            file.seek(max(0, self._end - 1))
            if file.read(1) not in (b"", b"\n"):
                data = b"\n" + data
            file.seek(self._end)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        self._end += len(data)
        self._lines += 1

    def _read_on(self) -> None:
        """Read the lines that were added since the last read."""
        for number, end, line in self._read(self._lines, self._end):
            self._lines, self._end = number, end
            if line is not None:
                self._replies.setdefault(line.key, line.reply)

    def _read(
        self, number: int = 0, end: int = 0
    ) -> Iterator[tuple[int, int, _Line | None]]:
        """Yield number, end [bytes] and content of further lines; None for blank ones.

        Args:
            number: Number of the last read line.
            end: End of that line [bytes].
        """
        if not self.path.exists():
            return
        with self.path.open("rb") as file:
            file.seek(end)
            for each, data in enumerate(file, number + 1):
                end += len(data)
                try:
                    line = self._parsed(data, each) if data.strip() else None
                except DatasetError:
                    is_begun = _BEGIN.startswith(data[: len(_BEGIN)])
                    if data.endswith(b"\n") or not is_begun:
                        raise
                    # An incomplete last line of a killed process.
                    return
                yield each, end, line

    def _parsed(self, data: bytes, number: int) -> _Line:
        try:
            line = msgspec.convert(json.loads(data), _Line)
            if key_of(line.request) != line.key:
                raise ValueError("its key is not that of its request, so it was edited")
        except (ValueError, RecursionError, msgspec.MsgspecError) as error:
            raise DatasetError(
                f"Line {number} of {self.path} cannot be read: {error}. Remove the "
                "line, and record it again."
            ) from error
        return line

    def missing(self, request: Mapping[str, Any], why: str) -> PlannerUnavailableError:
        """Return the error for a request that is not on the cassette.

        Args:
            request: The request.
            why: A sentence, why the request is not sent to a server.
        """
        text = f"{self.path} has no answer to a request ({key_of(request)[:12]}). {why}"
        wanted = _flat(request)
        nearest = max(
            ((number, line.request) for number, _, line in self._read() if line),
            key=lambda one: SequenceMatcher(None, _flat(one[1]), wanted).quick_ratio(),
            default=None,
        )
        if nearest is None:
            return PlannerUnavailableError(f"{text} The cassette is empty.")
        number, other = nearest
        changes = "; ".join(differences(other, request))
        return PlannerUnavailableError(
            f"{text} The nearest request, in line {number}, differs: {changes}. Undo "
            "the change, or ask again with --cassette-mode record."
        )


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the first differences between two requests, as "... became ...".

    Args:
        before: The recorded request.
        now: The present request.
    """
    old, new = _flat(before), _flat(now)
    matcher = SequenceMatcher(None, old, new, autojunk=False)
    found = []
    for tag, start, end, first, last in matcher.get_opcodes():
        if tag != "equal":
            texts = ("\n".join(old[start:end]), "\n".join(new[first:last]))
            found.append(" became ".join(map(repr, _apart(*texts))))
    return found[:_MOST]


def _flat(request: Mapping[str, Any]) -> list[str]:
    """Return a request as lines of text, to compare."""
    lines = [f"{k}={json.dumps(v)}" for k, v in sorted(request.items())]
    for message in request.get("messages") or ():
        content = message.get("content") if isinstance(message, dict) else message
        for part in content if isinstance(content, list) else [content]:
            text = part.get("text", part) if isinstance(part, dict) else part
            lines += (text if isinstance(text, str) else json.dumps(text)).split("\n")
    return [line for line in lines if not line.startswith("messages=")]


def _apart(before: str, now: str) -> tuple[str, str]:
    """Return excerpts of two texts that begin shortly before their first difference."""
    pairs = enumerate(zip(before, now, strict=False))
    parting = next((i for i, (a, b) in pairs if a != b), min(len(before), len(now)))
    start = max(0, parting - _SHOWN // 3)
    head = "..." if start else ""
    old, new = (head + text[start:] for text in (before, now))
    return (
        old if len(old) <= _SHOWN else f"{old[:_SHOWN]}...",
        new if len(new) <= _SHOWN else f"{new[:_SHOWN]}...",
    )
