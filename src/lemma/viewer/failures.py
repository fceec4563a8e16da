"""The page of failures: the list of a report, with replays computed on demand."""

import sys
import threading
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import lru_cache
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import AF_INET, AF_INET6
from typing import Any
from urllib.parse import parse_qs, urlsplit

from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.evaluation.records import EPISODES, PACKED
from lemma.evaluation.report.episodes import Case
from lemma.viewer.replays import PLAYER, player_script, replay_of_case, replays_page
from lemma.viewer.server import Guard, address_of, check_address
from lemma.viz.pages.report import Findings, failures_page

NOT_SAID = (
    "Some cannot be played again: lines of control level have no motor commands, and "
    "other versions have other instances."
)
_REPLAYS = "replays"
_KEPT = 16
_PORTS = 100


class FailurePage:
    """A server of a page with the failures of results."""

    def __init__(
        self,
        cases: Sequence[Case],
        host: str,
        port: int,
        policy: str | None = None,
        hosts: Collection[str] = (),
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Listen on an address.

        Args:
            cases: Episodes of results.
            host: Address to listen on.
            port: Port to listen on; if it is taken, the next free one.
            policy: Title of the policy whose failures are shown first; None for all.
            hosts: Allowed host names of a proxy.
            tell: Called with a sentence at the first refused request.

        Raises:
            InvalidConfigError: The address or port is not valid on this machine; or no
                episode failed.
        """
        if not cases:
            raise InvalidConfigError(
                "These results have no lines of episodes. Put the file "
                f"{EPISODES} of 'lemma evaluate', or NAME{PACKED} of 'lemma "
                "reproduce', into the same folder."
            )
        if all(case.cause is None for case in cases):
            raise InvalidConfigError(f"None of the {len(cases)} episodes failed.")
        check_address(host, port)
        self.cases = tuple(cases)
        self._guard = Guard(host, hosts, tell)
        self._one_at_a_time, self._runs = threading.Lock(), False
        self._kept = lru_cache(_KEPT)(self._replay)
        self._numbers = {_address(number): number for number in range(len(cases))}
        self._files = {
            "/": failures_page(self._findings()).encode(),
            f"/{_REPLAYS}/{PLAYER}": player_script().encode(),
        }
        self._server = _listen(host, port, self._handler())
        self.address = address_of(host, self._server.server_port)
        if policy is not None:
            number = policies_of(self.cases).index(policy)
            self.address += f"/#failures?policy={number}"

    def run(self) -> None:
        """Serve until another thread calls :meth:`close`, or until an interrupt."""
        self._runs = True
        self._server.serve_forever(poll_interval=0.1)

    def close(self) -> None:
        """Stop listening, and end :meth:`run` in another thread."""
        if self._runs:
            self._server.shutdown()
        self._server.server_close()

    def _findings(self) -> Findings:
        starts: dict[tuple[object, ...], list[int]] = {}
        for number, case in enumerate(self.cases):
            if case.is_repeatable:
                starts.setdefault(_start(case), []).append(number)
        replays, beside = {}, {}
        for number, case in enumerate(self.cases):
            if case.cause is not None and case.is_repeatable:
                replays[number] = _address(number).removeprefix("/")
                beside[number] = tuple(
                    (other, self.cases[other].policy)
                    for other in starts[_start(case)]
                    if self.cases[other].policy != case.policy
                )
        failed = sum(case.cause is not None for case in self.cases)
        missing = NOT_SAID if len(replays) < failed else ""
        return Findings(self.cases, missing=missing, replays=replays, beside=beside)

    def answer(self, path: str) -> bytes | None:
        """Return the content of a file of the page; None if there is no such file."""
        address = urlsplit(path)
        if address.path in self._files:
            return self._files[address.path]
        number = self._numbers.get(address.path)
        if number is None:
            return None
        (beside,) = parse_qs(address.query).get("beside", [""])[:1]
        with self._one_at_a_time:
            return self._kept(number, self._numbers.get(_address(beside)))

    def _replay(self, number: int, other: int | None) -> bytes:
        beside = None if other is None else self.cases[other]
        try:
            page = replays_page([replay_of_case(self.cases[number], beside)], None)
        except Exception as error:
            # The page reports any error and continues.
            what = str(error) if isinstance(error, LemmaError) else repr(error)
            page = f"<!doctype html><p>It cannot be played again: {escape(what)}</p>"
        return page.encode()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        page, guard = self, self._guard

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                host = self.headers.get("Host")
                origin = f"http://{host}" if host else None
                if not guard.admits(origin, host):
                    status, content = HTTPStatus.FORBIDDEN, b"Not by this name.\n"
                elif (found := page.answer(self.path)) is not None:
                    status, content = HTTPStatus.OK, found
                else:
                    status, content = HTTPStatus.NOT_FOUND, b"There is no such page.\n"
                kind = "javascript" if self.path.endswith(".js") else "html"
                self.send_response(status)
                self.send_header("Content-Type", f"text/{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: object) -> None:
                """Print nothing."""

        return Handler


def _address(number: object) -> str:
    """Return the address of an episode's page, relative to the page of failures."""
    return f"/{_REPLAYS}/{number}.html"


def policies_of(cases: Iterable[Case]) -> tuple[str, ...]:
    """Return titles of the policies, in order."""
    return tuple(dict.fromkeys(case.policy for case in cases))


def _start(case: Case) -> tuple[object, ...]:
    """Return instance and instruction, which comparable episodes have in common."""
    row = case.row
    moved = row.get("perturb_start", False)
    kind, about = row["instruction_kind"], case.about
    return row["task"], row["split"], row["index"], kind, moved, about["language"]


def _listen(
    host: str, port: int, handler: type[BaseHTTPRequestHandler]
) -> ThreadingHTTPServer:
    class Server(ThreadingHTTPServer):
        address_family = AF_INET6 if ":" in host else AF_INET
        daemon_threads = True

        def handle_error(self, request: Any, client_address: Any) -> None:
            # A browser that leaves before it has read everything is no error.
            if not isinstance(sys.exc_info()[1], ConnectionError):
                super().handle_error(request, client_address)

    for each in range(port, min(port + _PORTS, 65536)):
        try:
            return Server((host, each), handler)
        except OSError:
            continue
    raise InvalidConfigError(f"All ports of {host} from {port} on are taken.")
