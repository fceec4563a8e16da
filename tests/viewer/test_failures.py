"""The page of failures: its list, and episodes that are played again on demand."""

import json
import re
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.client import HTTPConnection, RemoteDisconnected
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from browser import page_in_chromium
from clumsy import FAILED, KINDS, played_clumsily
from command import run as lemma

from lemma.core.errors import InvalidConfigError
from lemma.evaluation.report.episodes import Case
from lemma.viewer.failures import FailurePage
from lemma.viewer.replays import cases_in

OTHER = "other"


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return cases_in(played_clumsily())


@pytest.fixture(scope="module")
def page(cases: list[Case]) -> Iterator[FailurePage]:
    both = [*cases, *(replace(case, policy=OTHER) for case in cases)]
    found = FailurePage(both, "127.0.0.1", 18180, OTHER)
    loop = threading.Thread(target=found.run)
    loop.start()
    yield found
    found.close()
    loop.join(10.0)


def data_in(page: FailurePage, path: str, name: str) -> Any:
    """Return the JSON of a page."""
    found = re.search(
        rb'id="%b">(.*?)</script>' % name.encode(), page.answer(path) or b"", re.DOTALL
    )
    assert found is not None
    return json.loads(found[1])


def data_of(page: FailurePage) -> Any:
    return data_in(page, "/", "data")["failures"]


def told_at(page: FailurePage, path: str) -> Any:
    (told,) = data_in(page, path, "episodes")
    return told


@pytest.mark.slow
def test_every_failure_can_be_played_beside_the_expert_or_another(
    page: FailurePage,
) -> None:
    data = data_of(page)
    failed = [case for case in data["cases"] if case["cause"]]
    assert len(failed) == 2 * FAILED * len(KINDS)
    for case in failed:
        ((_, policy),) = case["beside"]
        assert policy == data["policies"][1 - case["policy"]]
        assert case["replay"]
    assert page.address.endswith("/#failures?policy=1")


def test_failure_opens_at_its_mistake(page: FailurePage) -> None:
    case = next(c for c in data_of(page)["cases"] if c.get("mistake") is not None)
    told = told_at(page, f"/{case['replay']}")
    policy, expert = told["sides"]
    assert (policy["solved"], expert["solved"]) == (False, True)
    start_s = policy["steps"][case["mistake"]]["start"]
    assert told["opens"] == pytest.approx(start_s, abs=0.01)
    ((number, name),) = case["beside"]
    beside = told_at(page, f"/{case['replay']}?beside={number}")
    assert [side["title"] for side in beside["sides"]] == [policy["title"], name]


def ask(page: FailurePage, path: str, host: str) -> int:
    number = int(page.address.split(":")[2].partition("/")[0])
    connection = HTTPConnection("127.0.0.1", number, timeout=60.0)
    connection.request("GET", path, headers={"Host": host})
    return connection.getresponse().status


@pytest.mark.parametrize(
    ("path", "host", "status"),
    [
        ("/", "127.0.0.1", 200),
        ("/", "evil.example", 403),
        ("/replays/player.js", "localhost:80", 200),
        ("/replays/99999.html", "localhost", 404),
        ("/replays/-1.html", "localhost", 404),
        ("/etc/passwd", "localhost", 404),
        ("/replays/../../etc/passwd", "localhost", 404),
    ],
)
def test_only_its_own_files_are_served(
    page: FailurePage, path: str, host: str, status: int
) -> None:
    assert ask(page, path, host) == status


def test_broken_lines_leave_the_page_alive(cases: list[Case]) -> None:
    broken = replace(cases[0], row={**cases[0].row, "subtasks": [{}]})
    commanded = replace(cases[1], row={**cases[1].row, "control": {}})
    page = FailurePage([cases[0], commanded], "127.0.0.1", 18185)
    assert [bool(c["replay"]) for c in data_of(page)["cases"]] == [True, False]
    assert b"motor commands" in (page.answer("/") or b"")
    page.cases = (broken, commanded)
    assert b"cannot be played again" in (page.answer("/replays/0.html") or b"")
    page.close()


def test_there_must_be_a_failure(cases: list[Case]) -> None:
    for found, says in (
        ([], r"episodes\.jsonl"),
        ([c for c in cases if c.cause is None], "None of the 2 episodes failed"),
    ):
        with pytest.raises(InvalidConfigError, match=says):
            FailurePage(found, "127.0.0.1", 18185)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--failures",), "needs a folder of results"),
        (("nowhere", "--failures"), "There is no nowhere"),
        (("nowhere", "--failures", "--index", "1"), "no instance"),
    ],
)
def test_verb_wants_results(
    more: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert lemma("play", *more) == 2
    assert says in capsys.readouterr().err


@pytest.mark.slow
def test_visitor_opens_a_failure(page: FailurePage, tmp_path: Path) -> None:
    with page_in_chromium(tmp_path) as browser:
        # Software draws large pictures slowly.
        browser.resize(600, 300)
        browser.open(page.address)
        browser.wait_for("document.querySelectorAll('.case').length > 1")
        assert browser.run("document.querySelector('.case header').innerText").endswith(
            OTHER
        )
        browser.run("document.querySelector('.case .replay button').click()")
        inner = "document.querySelector('.replay iframe').contentDocument"
        browser.wait_for(f"{inner}?.body?.dataset.at > 0")
        assert browser.run(f"{inner}.querySelectorAll('h2').length") == 2


@pytest.mark.parametrize(
    ("error", "is_told"),
    [(BrokenPipeError(), False), (ConnectionResetError(), False), (OSError(), True)],
)
def test_a_browser_that_leaves_is_no_error(
    page: FailurePage,
    error: OSError,
    is_told: bool,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def answer(path: str) -> bytes:
        raise error

    monkeypatch.setattr(page, "answer", answer)
    there = HTTPConnection(urlsplit(page.address).netloc, timeout=10.0)
    there.request("GET", "/")
    with pytest.raises(RemoteDisconnected):
        there.getresponse()
    there.close()
    assert ("Traceback" in capfd.readouterr().err) == is_told
