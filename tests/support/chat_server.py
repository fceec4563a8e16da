"""A chat server for tests: speaks OpenAI's format, and answers by rules.

It reads the prompt as a model does, and nothing else: what is asked for from the
sentence, who reaches what and what was done from the text. Sentences that name a fault
are answered with it.
"""

import json
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

_OBJECT = re.compile(
    r"^- (\w+) at .*?, (?:reached by (.*)|(within|not in) your reach)$"
)
_MEANT = re.compile(r"(red|blue|green|yellow|purple|white|pink|orange) (cube|pad)")


class RuleServer(ThreadingHTTPServer):
    """Counts what it was asked."""

    daemon_threads = True

    def __init__(self, faults: list[str] | None = None) -> None:
        """Listen at a free port.

        Args:
            faults: Trouble with the first requests, one each: ``"hang"``,
                ``"drip"``, ``"html"``, ``"prose"``, ``"list"``, ``"name"``,
                ``"impossible"``, or a status, such as ``"500"``; ``""`` for none.
                Empty questions, which test the server, do not count as requests.
        """
        super().__init__(("127.0.0.1", 0), _Handler)
        self.faults = list(faults or [])
        self.always = ""
        self.unknown: tuple[str, ...] = ()
        self.answer_s = 0.0
        self.one_by_one = threading.Lock()
        self.probes: list[dict[str, Any]] = []
        self.requests: list[dict[str, Any]] = []
        self.headers: list[dict[str, str]] = []
        self.ended = threading.Event()
        self.lock = threading.Lock()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/v1"

    def next_fault(self) -> str:
        with self.lock:
            return self.faults.pop(0) if self.faults else self.always

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that went away."""


@contextmanager
def chat_server(*faults: str, always: str = "") -> Iterator[RuleServer]:
    server = RuleServer(list(faults))
    server.always = always
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.ended.set()
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    server: RuleServer

    def do_POST(self) -> None:
        length = int(self.headers["Content-Length"])
        request = json.loads(self.rfile.read(length))
        is_probe = "Robots\n\nObjects" in question_of(request)
        with self.server.lock:
            kept = self.server.probes if is_probe else self.server.requests
            kept.append(request)
            self.server.headers.append(dict(self.headers))
        fault = self.server.always if is_probe else self.server.next_fault()
        if any(name in request for name in self.server.unknown):
            fault = "400"
        if self.server.answer_s:
            with self.server.one_by_one:
                time.sleep(self.server.answer_s)
        if fault == "hang":
            self.server.ended.wait(30.0)
        elif fault == "drip":
            self._drip()
        elif fault == "307":
            self.send_response(307)
            self.send_header("Location", f"{self.server.url}/elsewhere")
            self.send_header("Content-Length", "0")
            self.end_headers()
        elif fault.isdecimal():
            key = self.headers.get("Authorization", "")
            self._send(int(fault), f'{{"error": "as you like it, {key}"}}')
        elif fault == "html":
            self._send(200, "<html>Welcome</html>")
        else:
            self._send(200, json.dumps(completion(request, fault)))

    def _drip(self) -> None:
        self.send_response(200)
        self.end_headers()
        while not self.server.ended.is_set():
            self.wfile.write(b" ")
            self.wfile.flush()
            time.sleep(0.05)

    def _send(self, status: int, text: str) -> None:
        body = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Be silent."""


def completion(request: dict[str, Any], fault: str) -> dict[str, Any]:
    answer = decide(request)
    if fault == "name":
        answer["pick"] = "unicorn"
    elif fault == "impossible":
        answer.update(robot="robot_0", primitive="move", pick="none", place="shared")
    content = json.dumps(answer)
    if fault == "prose":
        content = "I would rather not."
    elif fault == "list":
        content = f"[{content}]"
    words = sum(len(str(m["content"]).split()) for m in request["messages"])
    return {
        "choices": [{"message": {"role": "assistant", "content": content}}],
        "usage": {"prompt_tokens": words, "completion_tokens": len(content.split())},
    }


def question_of(request: dict[str, Any]) -> str:
    content = request["messages"][1]["content"]
    return content if isinstance(content, str) else content[0]["text"]


def decide(request: dict[str, Any]) -> dict[str, str]:
    """Return the next sub-task for a sentence that says to put one thing on another."""
    schema = request["response_format"]["json_schema"]["schema"]
    fields = schema["properties"]
    text = question_of(request)
    sentence = json.loads(text.splitlines()[0].removeprefix("Sentence: "))
    found: dict[str, tuple[str, set[str]]] = {}
    me = [name for name in fields["robot"]["enum"] if name != "none"]
    for line in text.splitlines():
        if match := _OBJECT.match(line):
            name, teams, own = match.groups()
            who = set(re.findall(r"robot_\d", teams or ""))
            found[name] = (line, {me[0]} if own == "within" else who)
    meant = ["_".join(pair) for pair in _MEANT.findall(sentence.lower())]
    meant = list(dict.fromkeys(name for name in meant if name in found))
    answer = dict.fromkeys(fields, "none") | {"reason": "as asked", "primitive": "stop"}
    for field in ("reason", "message"):
        if field in fields:
            answer[field] = "as asked"
    if len(meant) < 2:
        return answer
    top, bottom = meant[:2]
    if f"on the {bottom}" in found[top][0]:
        return answer
    both = found[top][1] & found[bottom][1]
    robots, place = (both, bottom) if both else (found[top][1], "shared")
    if not both and f"move {top} -> shared: success" in text:
        robots = set()
    if not robots:
        if "wait" in fields["primitive"]["enum"]:
            return answer | {"primitive": "wait"}
        return answer
    return answer | {
        "robot": min(robots),
        "primitive": "move",
        "pick": top,
        "place": place,
    }
