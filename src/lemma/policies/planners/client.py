"""Chat servers that speak OpenAI's format, over plain HTTP.

The key, if the server asks for one, is in the environment variable
:data:`KEY_VARIABLE` and nowhere else: not in options, results or messages.
"""

import http.client
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

from lemma.core.errors import InvalidConfigError
from lemma.policies.planners.options import PlannerUnavailableError

KEY_VARIABLE = "LEMMA_API_KEY"
"""Environment variable with the key of the server."""
WAITS_S = (1.0, 4.0)
"""Before each further attempt at a request that was not answered [s]."""
_LONGEST_WAIT_S = 60.0
_LARGEST = 4_000_000
_CHUNK = 65_536
_SHOWN = 200

TIMEOUT = "timeout"
RAISED = "raised"
"""Kinds of failure, by the names that results have for them."""


@dataclass(frozen=True, slots=True)
class Reply:
    """What came of a request: text, or why there is none."""

    content: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    failure: str = ""
    """``"timeout"`` or ``"raised"`` where the server gave no answer to this request."""
    explanation: str = ""
    """In one sentence, if it failed."""


class _NotAnsweredError(Exception):
    """An attempt that did not succeed."""

    def __init__(
        self,
        failure: str,
        explanation: str,
        *,
        wait_s: float = 0.0,
        gone: bool = False,
        again: bool = True,
    ) -> None:
        """Keep what happened.

        Args:
            failure: In one word.
            explanation: In one sentence.
            wait_s: How long the server wants to be left alone [s].
            gone: Whether that says nothing about this request.
            again: Whether another attempt may succeed.
        """
        super().__init__(explanation)
        self.reply = Reply(failure=failure, explanation=explanation)
        self.wait_s = wait_s
        self.gone = gone
        self.again = again


class _NoRedirects(HTTPRedirectHandler):
    """A key belongs to the server that was named, not to where it points."""

    def redirect_request(self, *args: Any, **kwargs: Any) -> None:
        return None


class ChatServer:
    """Asks one server; may be used by several threads."""

    def __init__(
        self, base_url: str, timeout_s: float, waits_s: tuple[float, ...] | None = None
    ) -> None:
        """Keep the address.

        Args:
            base_url: ``"http://127.0.0.1:8000/v1"``.
            timeout_s: For one attempt [s].
            waits_s: Before each further attempt [s]; :data:`WAITS_S` if None.

        Raises:
            InvalidConfigError: It is no address of that kind.
        """
        parts = urlsplit(base_url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise InvalidConfigError(
                f"{base_url!r} is no address of a chat server. Valid: "
                "http://HOST:PORT/v1, as in http://127.0.0.1:8000/v1."
            )
        if parts.username or parts.password or parts.query:
            raise InvalidConfigError(
                "The address of a chat server holds no key and no password. Put the "
                f"key into the environment variable {KEY_VARIABLE}."
            )
        self._url = f"{base_url.rstrip('/')}/chat/completions"
        self._timeout_s = timeout_s
        self._waits_s = WAITS_S if waits_s is None else waits_s
        proxies = (ProxyHandler({}),) if _is_loopback(parts.hostname) else ()
        self._opener = build_opener(_NoRedirects, *proxies)

    def ask(self, request: Mapping[str, Any]) -> Reply:
        """Return the reply to a request; one that failed, if the request is to blame.

        Raises:
            PlannerUnavailableError: Nobody answers there, or refuses everything.
        """
        body = json.dumps(request).encode()
        for wait_s in (*self._waits_s, None):
            try:
                return self._attempt(body)
            except _NotAnsweredError as error:
                if wait_s is not None and error.again:
                    time.sleep(min(max(wait_s, error.wait_s), _LONGEST_WAIT_S))
                    continue
                if error.gone:
                    raise PlannerUnavailableError(
                        f"{self._url} does not answer: {error.reply.explanation} Begin "
                        "the server, or name another with --base-url; the same command "
                        "then goes on."
                    ) from error
                return error.reply
        raise AssertionError("the last attempt has returned or raised")

    def _attempt(self, body: bytes) -> Reply:
        key = os.environ.get(KEY_VARIABLE, "")
        headers = {"Content-Type": "application/json"}
        if key:
            headers["Authorization"] = f"Bearer {key}"
        request = Request(self._url, data=body, headers=headers, method="POST")
        late = time.monotonic() + self._timeout_s
        try:
            with self._opener.open(request, timeout=self._timeout_s) as response:
                return _read_reply(_read_all(response, late))
        except HTTPError as error:
            with error:
                raise self._refused(error, key) from error
        except TimeoutError as error:
            raise _NotAnsweredError(TIMEOUT, self._too_late()) from error
        except (URLError, OSError, http.client.HTTPException, ValueError) as error:
            reason = getattr(error, "reason", error)
            if isinstance(reason, TimeoutError):
                raise _NotAnsweredError(TIMEOUT, self._too_late()) from error
            text = f"{type(reason).__name__}: {reason}.".replace("..", ".")
            raise _NotAnsweredError(RAISED, _hidden(text, key), gone=True) from error

    def _too_late(self) -> str:
        return f"The server did not answer within {self._timeout_s:g} s."

    def _refused(self, error: HTTPError, key: str) -> Exception:
        """Return what an answer with an HTTP status of failure means."""
        try:
            told = error.read(_CHUNK).decode(errors="replace")
        except (OSError, http.client.HTTPException):
            told = ""
        said = _hidden(" ".join(told.split()), key)[:_SHOWN]
        text = f"The server answered HTTP {error.code}: {said or error.reason}"
        if error.code in (408, 429) or error.code >= 500:
            after = error.headers.get("Retry-After", "")
            wait_s = float(after) if after.isdecimal() else 0.0
            # Who asks too often learns nothing about the model.
            return _NotAnsweredError(
                RAISED, text, wait_s=wait_s, gone=error.code == 429
            )
        if error.code in (400, 413, 422):
            return _NotAnsweredError(RAISED, text, again=False)
        return PlannerUnavailableError(
            f"{self._url} refuses to answer. {text}. Check the address, the name of "
            f"the model, and the key in the environment variable {KEY_VARIABLE}."
        )


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


def _read_reply(body: bytes) -> Reply:
    """Return what a chat completion says.

    Raises:
        _NotAnsweredError: It is none.
    """
    try:
        told = json.loads(body)
        content = told["choices"][0]["message"]["content"]
        usage = told.get("usage") or {}
        asked, said = (
            _count(usage, f"{end}_tokens") for end in ("prompt", "completion")
        )
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        start = body[:_SHOWN].decode(errors="replace")
        raise _NotAnsweredError(
            RAISED, f"The server's answer is no chat completion: {start!r}"
        ) from None
    return Reply(content if isinstance(content, str) else "", asked, said)


def _count(usage: Mapping[str, Any], name: str) -> int:
    count = usage.get(name)
    return count if isinstance(count, int) and count >= 0 else 0


def _hidden(text: str, key: str) -> str:
    return text.replace(key, "***") if key else text
