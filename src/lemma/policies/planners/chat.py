"""Chat servers that speak OpenAI's format, over plain HTTP, and how they are asked.

The key, if the server asks for one, is in the environment variable
:data:`KEY_VARIABLE` and nowhere else: not in options, results or messages.
"""

import http.client
import json
import os
import shlex
import tempfile
import time
from base64 import b64encode
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from html import escape
from ipaddress import ip_address
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any, Literal, get_args, get_type_hints
from urllib.error import HTTPError, URLError
from urllib.parse import quote, urlsplit
from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

from filelock import FileLock, Timeout

from lemma.core.arguments import (
    check_address_has_no_secret,
    known,
    secret_of,
    whole,
    without_passwords,
)
from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.policies.class_path import secret_in

KEY_VARIABLE = "LEMMA_API_KEY"
"""Environment variable with the key of the server."""
WAITS_S = (1.0, 4.0)
"""Before each further attempt at a request that was not answered [s]."""
_LONGEST_WAIT_S = 60.0
_LARGEST = 4_000_000
_CHUNK = 65_536
_SHOWN = 200
_POLL_S = 0.02
_SHORTEST_SECRET = 8
"""Shorter keys are placeholders such as ``none``, which may be words of an answer."""

TIMEOUT = "timeout"
RAISED = "raised"
"""Kinds of failure, by the names that results have for them."""

_EMPTY_QUESTION = (
    'Sentence: "stop"\n\nRobots\n\nObjects\n\nSo far\n- nothing was done yet\n\n'
    "What is the next sub-task?"
)
_GREY_PICTURE = (
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAEAAAABACAAAAACPAi4CAAAALElEQVR4"
    "nO3MoQEAAAjDMOByTueIGUTqm97KmvAHAAAAAAAAAAAAAAAA8B44QHQBALYvz+QAAAAASUVORK5CYII="
)
"""64 x 64 pixels: some models take no smaller ones."""


class PlannerUnavailableError(LemmaError, RuntimeError):
    """Nobody answers, or nobody may be asked.

    No fault of the model: nothing is known about what it would have decided.
    """


@dataclass(frozen=True)
class ChatOptions:
    """How a language model is asked; plain data, so that other processes can ask."""

    base_url: str = ""
    """Address of an OpenAI-compatible server, such as http://127.0.0.1:8000/v1. A key
    is read from the environment variable LEMMA_API_KEY."""
    cassette: Path | None = None
    """File of requests and answers: requests that are in it are not sent."""
    cassette_mode: Literal["record", "replay", "strict"] = "record"
    """Treatment of other requests. record: they are sent and kept; replay: they are
    sent; strict: they are an error that says what changed."""
    perception: Literal["truth", "seen"] = "truth"
    """Source of the text about the table: the simulation, or ReachNet's perception."""
    team: Literal["one", "each"] = "one"
    """One planner for the team, or one for each robot, with messages between them."""
    pictures: bool = False
    """Send the images of the robots' cameras as well."""
    tries: int = 3
    """Answers to a question, until one is a sub-task."""
    max_tokens: int = 1024
    """Largest length of an answer."""
    concurrency: int = 8
    """Requests at a time, of all workers of this machine. Each may take --timeout times
    as long, since the server may answer one after the other."""
    extra_body: str = ""
    """JSON object with fields of every request that replace the usual ones, for servers
    that do not know those; null leaves a field out."""

    def __post_init__(self) -> None:
        """Check the names and the numbers."""
        hints = get_type_hints(ChatOptions)
        for name in ("cassette_mode", "perception", "team"):
            known(name.replace("_", " "), getattr(self, name), get_args(hints[name]))
        for name in ("tries", "max_tokens", "concurrency"):
            whole(name, getattr(self, name), 1)
        reserved = {"model", "messages", "stream"} & self.fields.keys()
        if reserved:
            raise InvalidConfigError(
                f"The extra body sets {', '.join(sorted(reserved))}, which every "
                "request sets for itself. Leave it out."
            )
        if secret := secret_in(self.extra_body or "{}"):
            raise InvalidConfigError(
                f"The extra body sets {secret!r}, a secret that results would show. "
                f"Put the server's key into the environment variable {KEY_VARIABLE}."
            )

    @cached_property
    def fields(self) -> dict[str, Any]:
        """The fields of :attr:`extra_body`."""
        try:
            found = json.loads(self.extra_body or "{}")
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            raise InvalidConfigError(
                "The extra body of requests is no JSON object. Write it as in "
                """'{"max_tokens": null, "max_completion_tokens": 1024}'."""
            )
        return found

    def settings(self) -> dict[str, Any]:
        """Return the options that decide the answers, not where they come from."""
        names = ("perception", "team", "pictures", "tries", "max_tokens")
        extra = {"extra_body": self.fields} if self.fields else {}
        return {name: getattr(self, name) for name in names} | extra

    def words(self) -> list[str]:
        """Return the options of the command line that ask for the same.

        Of a cassette the name alone: it is shared, and may lie anywhere.
        """
        options = self.settings()
        if self.fields:
            options["extra_body"] = self.extra_body
        if self.concurrency != ChatOptions.concurrency:
            options["concurrency"] = self.concurrency
        if self.cassette is not None:
            options["cassette"] = self.cassette.name
        else:
            options["base_url"] = self.base_url
        return [
            f"--{name.replace('_', '-')}"
            + ("" if value is True else f" {shlex.quote(str(value))}")
            for name, value in options.items()
            if value is not False
        ]


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a request, or why there is none."""

    content: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    failure: str = ""
    """``"timeout"`` or ``"raised"`` where the server gave no answer to this request."""
    explanation: str = ""
    """Error in one sentence, if it failed."""
    remark: str = ""
    """Why the content is empty or not whole, a sentence; empty if nothing is odd."""


@dataclass
class _NotAnsweredError(Exception):
    """An attempt that did not succeed."""

    failure: str
    """Kind of the fault, one word."""
    explanation: str
    """The fault in one sentence."""
    wait_s: float = 0.0
    """How long the server wants to be left alone [s]."""
    gone: bool = False
    """Whether that says nothing about this request."""
    again: bool = True
    """Whether another attempt may succeed."""


class _NoRedirects(HTTPRedirectHandler):
    """Follows no redirects: the key belongs to the server that was named."""

    def redirect_request(self, *args: Any, **kwargs: Any) -> None:
        return None


class ChatServer:
    """Asks one server; may be used by several threads."""

    def __init__(
        self,
        base_url: str,
        timeout_s: float,
        waits_s: tuple[float, ...] | None = None,
        concurrency: int = 1,
    ) -> None:
        """Keep the address and the key.

        Args:
            base_url: ``"http://127.0.0.1:8000/v1"``.
            timeout_s: For an answer [s]. Some servers answer one request after the
                other, so an attempt may take this times ``concurrency``.
            waits_s: Before each further attempt [s]; :data:`WAITS_S` if None.
            concurrency: Requests that the processes of this machine have under way at
                a time.

        Raises:
            InvalidConfigError: It is no address of that kind, or the key is no key.
        """
        check_address(base_url)
        self._key = secret_of(KEY_VARIABLE)
        self._url = f"{base_url.rstrip('/')}/chat/completions"
        self._timeout_s = timeout_s * concurrency
        self._waits_s = WAITS_S if waits_s is None else waits_s
        self._slots = _Slots(base_url, concurrency)
        host = urlsplit(base_url).hostname or ""
        proxies = (ProxyHandler({}),) if _is_loopback(host) else ()
        self._opener = build_opener(_NoRedirects, *proxies)

    def ask(self, request: Mapping[str, Any]) -> Reply:
        """Return the reply to a request; one that failed, if the request is to blame.

        A server that fails at a request is also asked an empty question in the same
        form. If it fails at that as well, the request is not to blame.

        Raises:
            PlannerUnavailableError: Nobody answers there, or refuses everything.
        """
        reply = self._ask(request, self._waits_s)
        if reply.failure and self._ask(probe_of(request), ()).failure:
            raise PlannerUnavailableError(
                f"{self._url} fails at every request, also at an empty question. "
                f"{reply.explanation} Mend the server, or raise --timeout. If it does "
                "not know a field of the request, replace that with --extra-body, "
                'where null leaves it out: --extra-body \'{"max_tokens": null, '
                '"max_completion_tokens": 1024}\'. The same command then goes on.'
            )
        return reply

    def _ask(self, request: Mapping[str, Any], waits_s: tuple[float, ...]) -> Reply:
        """Return the reply to a request, after a wait before each further attempt."""
        body = json.dumps(request).encode()
        for wait_s in (*waits_s, None):
            try:
                with self._slots.one():
                    return self._attempt(body)
            except _NotAnsweredError as error:
                failed = error
            if wait_s is not None and failed.again:
                time.sleep(min(max(wait_s, failed.wait_s), _LONGEST_WAIT_S))
                continue
            if failed.gone:
                raise PlannerUnavailableError(
                    f"{self._url} does not answer: {failed.explanation} Start "
                    "the server, or name another with --base-url; the same command "
                    "then goes on."
                )
            return Reply(failure=failed.failure, explanation=failed.explanation)
        raise AssertionError("the last attempt has returned or raised")

    def _attempt(self, body: bytes) -> Reply:
        headers = {"Content-Type": "application/json"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        request = Request(self._url, data=body, headers=headers, method="POST")
        late = time.monotonic() + self._timeout_s
        # Errors are raised outside of "except": their causes may show the key.
        try:
            with self._opener.open(request, timeout=self._timeout_s) as response:
                return self._read_reply(_read_all(response, late))
        except HTTPError as error:
            with error:
                failed: Exception = self._refused(error)
        except TimeoutError:
            failed = self._too_late()
        except (URLError, OSError, http.client.HTTPException, ValueError) as error:
            reason = getattr(error, "reason", error)
            text = f"{type(reason).__name__}: {reason}.".replace("..", ".")
            failed = _NotAnsweredError(RAISED, self._hidden(text), gone=True)
            if isinstance(reason, TimeoutError):
                failed = self._too_late()
        raise failed

    def _too_late(self) -> _NotAnsweredError:
        return _NotAnsweredError(
            TIMEOUT, f"The server did not answer within {self._timeout_s:g} s."
        )

    def _refused(self, error: HTTPError) -> Exception:
        """Return what an answer with an HTTP status of failure means."""
        try:
            body = error.read(_CHUNK)
        except (OSError, http.client.HTTPException):
            body = b""
        said = self._excerpt(body or str(error.reason).encode())
        text = f"The server answered HTTP {error.code}: {said}"
        if error.code in (408, 429) or error.code >= 500:
            after = error.headers.get("Retry-After", "")
            wait_s = float(after) if after.isdecimal() else 0.0
            # 429 says nothing about the request: there were too many.
            return _NotAnsweredError(RAISED, text, wait_s, gone=error.code == 429)
        if error.code in (400, 413, 422):
            return _NotAnsweredError(RAISED, text, again=False)
        return PlannerUnavailableError(
            f"{self._url} refuses to answer. {text}. Check the address, the name of "
            f"the model, and the key in the environment variable {KEY_VARIABLE}."
        )

    def _read_reply(self, body: bytes) -> Reply:
        """Return the answer that a chat completion holds.

        Raises:
            _NotAnsweredError: It is none.
        """
        try:
            found = json.loads(body)
            choice = found["choices"][0]
            content, remark = _content_of(choice, choice["message"])
            usage = found.get("usage") or {}
            asked, said = (
                _count(usage, f"{end}_tokens") for end in ("prompt", "completion")
            )
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
            found = None
        if found is None:
            raise _NotAnsweredError(
                RAISED,
                f"The server's answer is no chat completion: {self._excerpt(body)}",
            )
        if len(self._key) >= _SHORTEST_SECRET:
            content = _without(self._key, content)
        return Reply(content, asked, said, remark=self._hidden(remark)[:_SHOWN])

    def _excerpt(self, data: bytes) -> str:
        """Return the beginning of an answer for a message, without the key."""
        return self._hidden(" ".join(data.decode(errors="replace").split()))[:_SHOWN]

    def _hidden(self, text: str) -> str:
        """Return a message without the key and without passwords in addresses."""
        return _without(self._key, without_passwords(text))


class _Slots:
    """Counts requests that are under way, of all processes of this machine."""

    def __init__(self, url: str, count: int) -> None:
        """Keep the number.

        Args:
            url: Of the server: each has slots of its own.
            count: How many there are.
        """
        self._count = count
        self._here = BoundedSemaphore(count)
        user = os.getuid() if hasattr(os, "getuid") else 0
        digest = sha256(f"{user} {url}".encode()).hexdigest()[:16]
        self._name = f"lemma-chat-{digest}"

    @contextmanager
    def one(self) -> Iterator[None]:
        """Wait for a free slot, and hold it."""
        with self._here:
            lock = self._acquire()
            try:
                yield
            finally:
                if lock is not None:
                    lock.release()

    def _acquire(self) -> FileLock | None:
        """Return a lock; None where none can be made: each process counts alone."""
        try:
            folder = Path(tempfile.gettempdir()) / self._name
            folder.mkdir(exist_ok=True)
            while True:
                for number in range(self._count):
                    lock = FileLock(folder / f"{number}.lock")
                    try:
                        lock.acquire(timeout=0.0)
                    except Timeout:
                        continue
                    return lock
                time.sleep(_POLL_S)
        except (OSError, NotImplementedError):
            return None


def check_address(base_url: str) -> None:
    """Check the address of a chat server.

    Raises:
        InvalidConfigError: It is none, or holds a password.
    """
    try:
        parts = urlsplit(base_url)
        is_url = parts.scheme in ("http", "https") and bool(parts.hostname)
        is_url = is_url and parts.port != 0
    except ValueError:
        is_url = False
    advice = f"Put the key into the environment variable {KEY_VARIABLE}."
    check_address_has_no_secret(base_url, "a chat server", advice)
    if not is_url:
        raise InvalidConfigError(
            f"{base_url!r} is no address of a chat server. Valid: "
            "http://HOST:PORT/v1, as in http://127.0.0.1:8000/v1."
        )


def probe_of(request: Mapping[str, Any]) -> dict[str, Any]:
    """Return a request in the same form whose question is empty."""
    messages = request["messages"]
    parts = messages[1]["content"]
    content: Any = _EMPTY_QUESTION
    if isinstance(parts, list):
        grey = {"type": "image_url", "image_url": {"url": _GREY_PICTURE}}
        pictures = [grey for part in parts if part["type"] == "image_url"]
        content = [{"type": "text", "text": _EMPTY_QUESTION}, *pictures]
    question = {"role": "user", "content": content}
    return {**request, "messages": [messages[0], question]}


def _without(secret: str, text: str) -> str:
    """Return a text in which no usual spelling of a secret is left."""
    if not secret:
        return text
    plain = json.dumps(secret)[1:-1]
    spellings = {
        *(secret, plain, plain.replace("/", "\\/"), repr(secret)[1:-1]),
        *(quote(secret), quote(secret, safe=""), escape(secret)),
        b64encode(secret.encode()).decode().rstrip("="),
    }
    for spelling in sorted(spellings, key=len, reverse=True):
        text = text.replace(spelling, "***")
    return text


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _read_all(response: http.client.HTTPResponse, late: float) -> bytes:
    """Return the body; a server that sends a byte now and then is late as well."""
    content = bytearray()
    while chunk := response.read1(_CHUNK):
        content += chunk
        if time.monotonic() > late:
            raise TimeoutError
        if len(content) > _LARGEST:
            raise _NotAnsweredError(RAISED, "The server's answer has no end.")
    return bytes(content)


def _content_of(
    choice: Mapping[str, Any], message: Mapping[str, Any]
) -> tuple[str, str]:
    """Return the text of an answer, and what is odd about it."""
    content = message.get("content")
    if isinstance(content, list):
        # Some servers send thoughts and text as parts of the content.
        texts = [part.get("text") for part in content if part.get("type") == "text"]
        content = "".join(text for text in texts if isinstance(text, str))
    content = content if isinstance(content, str) else ""
    if choice.get("finish_reason") in ("length", "max_tokens"):
        return content, "It was cut off after as many tokens as --max-tokens allows."
    if content:
        return content, ""
    if message.get("refusal"):
        return "", f"The model refuses: {message['refusal']}"
    calls = message.get("tool_calls") or []
    if calls:
        found = calls[0]["function"]["arguments"]
        text = found if isinstance(found, str) else json.dumps(found)
        return text if len(calls) == 1 else "", "It came as a tool call."
    if message.get("reasoning_content") or message.get("reasoning"):
        return "", "The server put all of it into reasoning_content."
    return "", ""


def _count(usage: Mapping[str, Any], name: str) -> int:
    count = usage.get(name)
    return count if isinstance(count, int) and count >= 0 else 0
