"""An HTTP client for chat servers with OpenAI's format.

The key for the server, if it needs one, comes from an environment variable. It never
appears in options, results or messages.
"""

import http.client
import json
import os
import tempfile
import time
from base64 import b64encode
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from html import escape
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote, urlsplit
from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

from filelock import FileLock, Timeout

from lemma.core.arguments import (
    check_address_has_no_secret,
    is_loopback,
    secret_of,
    without_passwords,
)
from lemma.core.errors import InvalidConfigError
from lemma.policies.planners.chat import (
    KEY_VARIABLE,
    PlannerUnavailableError,
    Reply,
)

WAITS_S = (1.0, 4.0)
"""Delay before each further attempt at a request without an answer [s]."""
_LONGEST_WAIT_S = 60.0
_LARGEST = 4_000_000
_CHUNK = 65_536
_SHOWN = 200
_POLL_S = 0.02
_SHORTEST_SECRET = 8
"""Shorter keys are not hidden: they are placeholders such as ``none``, which may be
words of an answer."""

TIMEOUT = "timeout"
RAISED = "raised"
"""Kinds of failure, as in results."""

_EMPTY_QUESTION = (
    'Sentence: "stop"\n\nRobots\n\nObjects\n\nSo far\n- nothing was done yet\n\n'
    "What is the next sub-task?"
)
_GREY_PICTURE = (
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAEAAAABACAAAAACPAi4CAAAALElEQVR4"
    "nO3MoQEAAAjDMOByTueIGUTqm97KmvAHAAAAAAAAAAAAAAAA8B44QHQBALYvz+QAAAAASUVORK5CYII="
)
"""A PNG image of 64 x 64 pixels, because some models reject smaller ones."""


@dataclass
class _NotAnsweredError(Exception):
    """A failed attempt."""

    failure: str
    """Kind of the fault, one word."""
    explanation: str
    """The fault in one sentence."""
    wait_s: float = 0.0
    """Delay that the server demands before another attempt [s]."""
    gone: bool = False
    """Whether the failure is independent of this request."""
    again: bool = True
    """Whether another attempt may succeed."""


class _NoRedirects(HTTPRedirectHandler):
    """Refuses redirects, so that another server does not get the key."""

    def redirect_request(self, *args: Any, **kwargs: Any) -> None:
        return None


class ChatServer:
    """A client of one server, safe for several threads."""

    def __init__(
        self,
        base_url: str,
        timeout_s: float,
        waits_s: tuple[float, ...] | None = None,
        concurrency: int = 1,
    ) -> None:
        """Store the address and the key.

        Args:
            base_url: ``"http://127.0.0.1:8000/v1"``.
            timeout_s: Time limit for an answer [s]. Some servers answer requests
                sequentially, so an attempt may take this times ``concurrency``.
            waits_s: Delay before each further attempt [s]; :data:`WAITS_S` if None.
            concurrency: Largest number of concurrent requests of all processes of this
                machine.

        Raises:
            InvalidConfigError: The address or the key is invalid.
        """
        check_address(base_url)
        self._key = secret_of(KEY_VARIABLE)
        self._url = f"{base_url.rstrip('/')}/chat/completions"
        self._timeout_s = timeout_s * concurrency
        self._waits_s = WAITS_S if waits_s is None else waits_s
        self._slots, self._here = concurrency, BoundedSemaphore(concurrency)
        user = os.getuid() if hasattr(os, "getuid") else 0
        digest = sha256(f"{user} {base_url}".encode()).hexdigest()[:16]
        self._locks = f"lemma-chat-{digest}"
        host = urlsplit(base_url).hostname or ""
        proxies = (ProxyHandler({}),) if is_loopback(host) else ()
        self._opener = build_opener(_NoRedirects, *proxies)

    def ask(self, request: Mapping[str, Any]) -> Reply:
        """Return the reply to a request; a failed one if the request is the cause.

        After a failure the client sends an empty question in the same form. If that
        fails, too, the cause is the server.

        Raises:
            PlannerUnavailableError: The server does not answer, or fails at all
                requests.
        """
        reply = self._ask(request, self._waits_s)
        if reply.failure and self._ask(probe_of(request), ()).failure:
            raise PlannerUnavailableError(
                f"{self._url} fails at every request, also at an empty question. "
                f"{reply.explanation} Fix the server, or raise --timeout. If it does "
                "not know a field of the request, replace that with --extra-body, "
                'where null removes it: --extra-body \'{"max_tokens": null, '
                '"max_completion_tokens": 1024}\'. The same command then goes on.'
            )
        return reply

    def _ask(self, request: Mapping[str, Any], waits_s: tuple[float, ...]) -> Reply:
        """Return the reply to a request, with a delay before each further attempt."""
        body = json.dumps(request).encode()
        for wait_s in (*waits_s, None):
            try:
                with self._slot():
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

    @contextmanager
    def _slot(self) -> Iterator[None]:
        """Wait for one of the slots that the processes of this machine share.

        If no lock file can be created, each process limits only its own requests.
        """
        with self._here, ExitStack() as stack:
            with suppress(OSError, NotImplementedError):
                folder = Path(tempfile.gettempdir(), self._locks)
                folder.mkdir(exist_ok=True)
                stack.callback(self._locked(folder).release)
            yield

    def _locked(self, folder: Path) -> FileLock:
        """Acquire and return the lock of a free slot."""
        while True:
            for number in range(self._slots):
                lock = FileLock(folder / f"{number}.lock")
                with suppress(Timeout):
                    lock.acquire(timeout=0.0)
                    return lock
            time.sleep(_POLL_S)

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
        """Return the exception for a response with an HTTP error status."""
        try:
            body = error.read(_CHUNK)
        except (OSError, http.client.HTTPException):
            body = b""
        said = self._excerpt(body or str(error.reason).encode())
        text = f"The server answered HTTP {error.code}: {said}"
        if error.code in (408, 429) or error.code >= 500:
            after = error.headers.get("Retry-After", "")
            wait_s = float(after) if after.isdecimal() else 0.0
            # 429, too many requests, is independent of this request.
            return _NotAnsweredError(RAISED, text, wait_s, gone=error.code == 429)
        if error.code in (400, 413, 422):
            return _NotAnsweredError(RAISED, text, again=False)
        return PlannerUnavailableError(
            f"{self._url} refuses to answer. {text}. Check the address, the name of "
            f"the model, and the key in the environment variable {KEY_VARIABLE}."
        )

    def _read_reply(self, body: bytes) -> Reply:
        """Return the reply in a chat completion.

        Raises:
            _NotAnsweredError: The body is no chat completion.
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


def check_address(base_url: str) -> None:
    """Check the address of a chat server.

    Raises:
        InvalidConfigError: The address is invalid, or contains a password.
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
    """Return a request of the same form with an empty question."""
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
    """Return a text without a secret in its usual encodings."""
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


def _read_all(response: http.client.HTTPResponse, late: float) -> bytes:
    """Return the body; the deadline is for the whole body, not for each read."""
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
    """Return the text of an answer, and a remark if it is empty or incomplete."""
    content = message.get("content")
    if isinstance(content, list):
        # Some servers send reasoning and text as parts of the content.
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
