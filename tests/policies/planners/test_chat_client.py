"""The client of chat servers: what goes wrong there costs one request, or says why."""

import threading
import time
from typing import Any

import pytest
from chat_server import chat_server

from lemma.core.errors import InvalidConfigError
from lemma.policies.planners.client import KEY_VARIABLE, ChatServer, Reply
from lemma.policies.planners.grammar import Grammar
from lemma.policies.planners.options import PlannerUnavailableError

SECRET = "sk-very-secret"


def request() -> dict[str, Any]:
    schema = Grammar(("robot_0",), ("red_cube", "blue_pad")).schema()
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
    ("fault", "kind", "words"),
    [
        ("500", "raised", "HTTP 500"),
        ("html", "raised", "no chat completion"),
        ("hang", "timeout", "within 0.3 s"),
        ("drip", "timeout", "within 0.3 s"),
    ],
)
def test_what_stays_is_a_failure_of_this_request(
    fault: str, kind: str, words: str
) -> None:
    with chat_server(always=fault) as server:
        reply = ask(server.url, timeout_s=0.3)
        assert len(server.requests) == 2
    assert reply.failure == kind
    assert words in reply.explanation


def test_what_is_rejected_is_not_asked_again() -> None:
    with chat_server(always="400") as server:
        assert ask(server.url).failure == "raised"
        assert len(server.requests) == 1


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
    with chat_server("400", always="401") as server:
        rejected = ask(server.url)
        with pytest.raises(PlannerUnavailableError) as refused:
            ask(server.url)
    assert server.headers[0]["Authorization"] == f"Bearer {SECRET}"
    # The server repeats it.
    for text in (rejected.explanation, str(refused.value)):
        assert "***" in text
        assert SECRET not in text
    assert SECRET not in str(server.requests)


def test_without_a_key_none_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    with chat_server() as server:
        ask(server.url)
    assert "Authorization" not in server.headers[0]


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:8000",
        "ftp://host/v1",
        "http://",
        "http://me:word@host/v1",
        "https://host/v1?key=abc",
    ],
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(InvalidConfigError, match="chat server"):
        ChatServer(url, 1.0)


def test_threads_share_a_client() -> None:
    with chat_server() as server:
        client = ChatServer(server.url, 10.0)
        replies: list[Reply] = []
        threads = [
            threading.Thread(target=lambda: replies.append(client.ask(request())))
            for _ in range(6)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len({reply.content for reply in replies}) == 1
    assert len(replies) == 6


def test_waits_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []
    monkeypatch.setattr(time, "sleep", waited.append)
    with chat_server("500", "500") as server:
        assert not ask(server.url, waits_s=(1.0, 4.0)).failure
    assert [wait for wait in waited if wait >= 1.0] == [1.0, 4.0]
