"""The client of chat servers: what goes wrong there costs one request, or says why."""

import json
import threading
import time
from collections.abc import Callable
from html import escape
from typing import Any
from urllib.parse import quote_plus

import pytest
from chat_server import chat_server

from lemma.core.errors import InvalidConfigError
from lemma.policies.planners.answers import AnswerFormat
from lemma.policies.planners.chat import (
    KEY_VARIABLE,
    ChatOptions,
    PlannerUnavailableError,
    Reply,
)
from lemma.policies.planners.chat_client import ChatServer

SECRET = "sk-very-secret"
BLANKS = ("\n", "\r\n", " ", "\ufeff")


def request() -> dict[str, Any]:
    schema = AnswerFormat(("robot_0",), ("red_cube", "blue_pad")).schema()
    return {
        "model": "rules",
        "messages": [
            {"role": "system", "content": "Obey."},
            {"role": "user", "content": 'Sentence: "stop"'},
        ],
        "response_format": {"json_schema": {"schema": schema}},
    }


def ask(
    url: str, timeout_s: float = 10.0, waits_s: tuple[float, ...] = (0.0,)
) -> Reply:
    return ChatServer(url, timeout_s, waits_s).ask(request())


def test_an_answer_and_its_tokens() -> None:
    with chat_server() as server:
        reply = ask(f"{server.url}/")
    assert '"stop"' in reply.content
    assert (reply.failure, reply.prompt_tokens) == ("", 3)
    assert reply.completion_tokens > 0
    assert server.requests == [request()]


@pytest.mark.parametrize("fault", ["500", "503", "429", "html", "hang"])
def test_what_passes_is_tried_again(fault: str) -> None:
    with chat_server(fault) as server:
        reply = ask(server.url, timeout_s=3.0 if fault == "hang" else 30.0)
        assert len(server.requests) == 2
    assert not reply.failure


@pytest.mark.parametrize(
    ("fault", "kind", "words", "asked"),
    [
        ("500", "raised", "HTTP 500", 2),
        ("html", "raised", "no chat completion", 2),
        ("400", "raised", "HTTP 400", 1),
        ("hang", "timeout", "within 0.3 s", 2),
        ("drip", "timeout", "within 0.3 s", 2),
    ],
)
def test_a_fault_at_one_request_alone_is_a_failure_of_that_request(
    fault: str, kind: str, words: str, asked: int
) -> None:
    with chat_server(*[fault] * asked) as server:
        reply = ask(server.url, timeout_s=0.3 if kind == "timeout" else 30.0)
        assert (len(server.requests), len(server.probes)) == (asked, 1)
    assert reply.failure == kind
    assert words in reply.explanation


@pytest.mark.parametrize("fault", ["500", "html", "400", "422", "hang"])
def test_a_fault_at_every_request_ends_the_run(fault: str) -> None:
    with (
        chat_server(always=fault) as server,
        pytest.raises(PlannerUnavailableError, match="--extra-body"),
    ):
        ask(server.url, timeout_s=0.3 if fault == "hang" else 30.0)


@pytest.mark.parametrize("fault", ["401", "404", "429", "307"])
def test_a_server_that_refuses_everything_ends_the_run(fault: str) -> None:
    with (
        chat_server(always=fault) as server,
        pytest.raises(PlannerUnavailableError, match=f"HTTP {fault}"),
    ):
        ask(server.url)
    # Nobody was sent elsewhere, with a key.
    assert len(server.requests) == (2 if fault == "429" else 1)


def test_nobody_there_ends_the_run() -> None:
    with chat_server() as server:
        url = server.url
    with pytest.raises(PlannerUnavailableError, match="--base-url"):
        ask(url)


def test_the_key_is_sent_and_never_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KEY_VARIABLE, SECRET)
    with chat_server("400", "401") as server:
        rejected = ask(server.url)
        with pytest.raises(PlannerUnavailableError) as refused:
            ask(server.url)
    assert server.headers[0]["Authorization"] == f"Bearer {SECRET}"
    # The server repeats it.
    for text in (rejected.explanation, str(refused.value)):
        assert "***" in text
        assert SECRET not in text
    assert SECRET not in str(server.requests)


@pytest.mark.parametrize("odd", [f"{SECRET}\nsecond", f"“{SECRET}”", f"{SECRET}\x7f"])
def test_a_key_that_cannot_be_sent_is_refused_by_the_name_of_its_variable(
    odd: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(KEY_VARIABLE, odd)
    with pytest.raises(InvalidConfigError, match=KEY_VARIABLE) as caught:
        ChatServer("http://127.0.0.1:1/v1", 1.0)
    assert SECRET not in str(caught.value)


@pytest.mark.parametrize("spell", [str, repr, json.dumps, quote_plus, escape])
@pytest.mark.parametrize("as_answer", [False, True])
def test_a_server_that_repeats_the_key_in_any_spelling(
    spell: Callable[[str], str], as_answer: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = "sk/<&'\"+very\\secret"
    monkeypatch.setenv(KEY_VARIABLE, key)
    server = ChatServer("http://127.0.0.1:1/v1", 1.0)
    told = spell(key)
    if as_answer:
        choice = {"message": {"content": told}}
        shown = server._read_reply(json.dumps({"choices": [choice]}).encode()).content
    else:
        shown = server._excerpt(f"{'x' * 195} {told}".encode())
        assert server._excerpt(told.encode())[:5].strip("\"'") == "***"
    assert "secret" not in shown
    assert "sk" not in shown


def test_the_password_of_a_proxy_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://me:word@proxy:port")
    with pytest.raises(PlannerUnavailableError) as caught:
        ask("http://example.invalid/v1")
    assert "word" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "sent"),
    [
        (None, None),
        # Words of an answer are no secret.
        ("none", "Bearer none"),
        *(
            (f"{SECRET}{end}", f"Bearer {SECRET}")
            for end in ("\n", "\r\n", " ", "\ufeff")
        ),
    ],
)
def test_a_key_is_sent_without_blanks_around_it(
    key: str | None, sent: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    if key is not None:
        monkeypatch.setenv(KEY_VARIABLE, key)
    with chat_server() as server:
        assert '"none"' in ask(server.url).content
    assert server.headers[0].get("Authorization") == sent


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:8000",
        "ftp://host/v1",
        "http://",
        "http://me:word@host/v1",
        "ftp://me:word@host/v1",
        "http://me:word@host:port/v1",
        "https://host/v1?key=abc",
        "https://host/v1#abc",
        "https://host/v1;key=abc",
    ],
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(InvalidConfigError, match="chat server") as caught:
        ChatServer(url, 1.0)
    assert "word@" not in str(caught.value)
    assert "abc" not in str(caught.value)


def test_waits_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []
    monkeypatch.setattr(time, "sleep", waited.append)
    with chat_server("500", "500") as server:
        assert not ask(server.url, waits_s=(1.0, 4.0)).failure
    assert [wait for wait in waited if wait >= 1.0] == [1.0, 4.0]


def test_a_slow_server_is_not_blamed_for_a_queue_of_requests() -> None:
    with chat_server() as server:
        server.answer_s = 0.1
        clients = [ChatServer(server.url, 0.2, (), concurrency=3) for _ in range(2)]
        replies: list[Reply] = []
        threads = [
            threading.Thread(target=lambda c=c: replies.append(c.ask(request())))
            for c in clients * 4
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        # One after the other takes 0.8 s, and each of three may wait for two.
        assert len(server.requests) == 8
    assert not any(reply.failure for reply in replies)


ODD_CHOICES: dict[str, tuple[dict[str, Any], str]] = {
    "cut off": (
        {"message": {"content": None}, "finish_reason": "length"},
        "--max-tokens",
    ),
    "refusal": ({"message": {"content": None, "refusal": "I will not."}}, "will not"),
    "tool": (
        {"message": {"tool_calls": [{"function": {"arguments": "{}"}}]}},
        "tool call",
    ),
    "thoughts": ({"message": {"content": "", "reasoning_content": "So"}}, "reasoning"),
}


@pytest.mark.parametrize("name", ODD_CHOICES)
def test_a_reply_says_why_it_is_not_whole(name: str) -> None:
    choice, words = ODD_CHOICES[name]
    server = ChatServer("http://127.0.0.1:1/v1", 1.0)
    reply = server._read_reply(json.dumps({"choices": [choice]}).encode())
    assert words in reply.remark
    assert reply.content == ("{}" if name == "tool" else "")


def test_parts_of_a_content_are_joined_without_thoughts() -> None:
    parts = [{"type": "thinking", "thinking": []}, {"type": "text", "text": "{}"}]
    body = json.dumps({"choices": [{"message": {"content": parts}}]}).encode()
    assert ChatServer("http://h/v1", 1.0)._read_reply(body).content == "{}"


@pytest.mark.parametrize(
    "body",
    [
        "[]",
        "{",
        "3",
        '{"model": "x"}',
        '{"stream": true}',
        '{"api_key": "sk-word"}',
        '{"extra": [{"headers": {"X-API-Key": "sk-word"}}]}',
        "[" * 100_000,
        '{"a": {"api_key": "sk-word"}, "a": 2}',
    ],
)
def test_an_extra_body_that_cannot_be_sent_is_refused(body: str) -> None:
    with pytest.raises(InvalidConfigError, match="extra body") as caught:
        ChatOptions(extra_body=body)
    assert "sk-word" not in str(caught.value)
