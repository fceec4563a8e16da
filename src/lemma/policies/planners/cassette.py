"""Cassettes: requests to language models and the answers, one JSON line each.

A line is found by the SHA-256 of the request as canonical JSON, so replay needs no
server and gives equal answers in any order and in any number of processes. If two
processes get different answers to one request, the first that was written counts for
both.
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
_SHOWN = 90


class _Line(msgspec.Struct):
    key: str
    request: dict[str, Any]
    reply: Reply


def key_of(request: Mapping[str, Any]) -> str:
    """Return the key of a request: the SHA-256 of its canonical JSON."""
    text = json.dumps(request, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class Cassette:
    """A file of answers; may be used by several threads, and the file by processes."""

    def __init__(self, path: Path) -> None:
        """Keep the path; the file is read at the first request.

        Args:
            path: The file, which need not exist yet.
        """
        self.path = path
        self._replies: dict[str, Reply] = {}
        self._end = 0
        self._lines = 0
        self._lock = Lock()

    def find(self, request: Mapping[str, Any]) -> Reply | None:
        """Return the reply to a request; None if it was never recorded.

        Raises:
            DatasetError: The file is damaged.
        """
        key = key_of(request)
        with self._lock, self._explained("read"):
            if key not in self._replies:
                self._read_on()
            return self._replies.get(key)

    def keep(self, request: Mapping[str, Any], reply: Reply) -> Reply:
        """Write a reply and return it, or the one that another process wrote before.

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
        """Turn the errors of files into one sentence.

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
        """Write a line, over an unfinished line of a writer that was killed."""
        with self.path.open("r+b" if self.path.exists() else "xb") as file:
            file.truncate(self._end)
            file.seek(self._end)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        self._end += len(data)
        self._lines += 1

    def _read_on(self) -> None:
        """Read the whole lines that were added since."""
        if not self.path.exists():
            return
        with self.path.open("rb") as file:
            file.seek(self._end)
            for data in file:
                if not data.endswith(b"\n"):
                    return
                if data.strip():
                    line = self._parsed(data, self._lines + 1)
                    self._replies.setdefault(line.key, line.reply)
                self._end += len(data)
                self._lines += 1

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
        """Return the error of a request that is not on the cassette.

        Args:
            request: The request.
            why: Why it is not sent to a server, a sentence.
        """
        text = f"{self.path} has no answer to a request ({key_of(request)[:12]}). {why}"
        nearest = self._nearest(request)
        if nearest is None:
            return PlannerUnavailableError(f"{text} The cassette is empty.")
        number, other = nearest
        changes = "; ".join(differences(other, request))
        return PlannerUnavailableError(
            f"{text} The nearest request, in line {number}, differs: {changes}. Undo "
            "the change, or ask again with --cassette-mode record."
        )

    def _nearest(
        self, request: Mapping[str, Any]
    ) -> tuple[int, Mapping[str, Any]] | None:
        """Return the number and the request of the line that is most alike."""
        if not self.path.exists():
            return None
        wanted = _flat(request)
        matcher = SequenceMatcher(autojunk=False)
        matcher.set_seq2(wanted)
        best: tuple[float, int, Mapping[str, Any]] | None = None
        with self.path.open("rb") as file:
            for number, data in enumerate(file, 1):
                if not data.strip():
                    continue
                if not data.endswith(b"\n"):
                    break
                other = self._parsed(data, number).request
                matcher.set_seq1(_flat(other))
                alike = matcher.quick_ratio()
                if best is None or alike > best[0]:
                    best = alike, number, other
        return None if best is None else best[1:]


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the differences between two requests, each as "was ... and is ...".

    Args:
        before: The one that was recorded.
        now: The other.
    """
    found = []
    for name in sorted({*before, *now} - {"messages"}):
        if before.get(name) != now.get(name):
            was, new = _apart(*(json.dumps(r.get(name)) for r in (before, now)))
            found.append(f"{name} was {was} and is {new}")
    lines = [list(_said(each.get("messages"))) for each in (before, now)]
    for number, (old, new) in enumerate(zip(*lines, strict=False), 1):
        if old != new:
            shorter = _apart(json.dumps(old), json.dumps(new))
            found.append(
                f"line {number} of the messages was {' and is '.join(shorter)}"
            )
            break
    else:
        if len(lines[0]) != len(lines[1]):
            found.append(
                f"the messages had {len(lines[0])} lines and have {len(lines[1])}"
            )
    return found


def _said(messages: Any) -> Iterator[str]:
    """Yield the lines of all messages."""
    for message in messages if isinstance(messages, list) else ():
        content = message.get("content") if isinstance(message, dict) else message
        parts = content if isinstance(content, list) else [content]
        for part in parts:
            text = part.get("text", part) if isinstance(part, dict) else part
            yield from (text if isinstance(text, str) else json.dumps(text)).split("\n")


def _flat(request: Mapping[str, Any]) -> list[str]:
    """Return a request as lines that can be compared."""
    rest = [f"{k}={json.dumps(v)}" for k, v in request.items() if k != "messages"]
    return [*rest, *_said(request.get("messages"))]


def _apart(before: str, now: str) -> tuple[str, str]:
    """Return two texts from a little before their first difference."""
    pairs = enumerate(zip(before, now, strict=False))
    parting = next((i for i, (a, b) in pairs if a != b), min(len(before), len(now)))
    start = max(0, parting - _SHOWN // 3)
    head = "..." if start else ""
    ends = (head + text[start:] for text in (before, now))
    old, new = (t if len(t) <= _SHOWN else f"{t[:_SHOWN]}..." for t in ends)
    return old, new
