"""`lemma play`: an interactive page in the browser with a table and robots."""

import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from lemma.cli.options import File, Flag, MaybeTask, Number, Word, messages, output
from lemma.cli.selection import Selection, read_instance
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.tasks.suite import default_split
from lemma.tasks.task import TASKS
from lemma.viewer.episode.status import OWN_WORDS, EpisodeRequest

if TYPE_CHECKING:
    from lemma.viewer.failures import FailurePage
    from lemma.viewer.page import Page

_FIRST = "hook_stack"
LOOPBACK = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class Listening:
    """Address of the page."""

    host: str = LOOPBACK
    """Address to listen on; the default is reachable only from this machine."""
    port: int = 8080
    """Port to listen on; if it is taken, the next free one."""
    no_open: Flag = False
    """Do not open a browser."""
    allow_host: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="HOST", help_behavior_hint="")
    ] = ()
    """Host names in the browser's address bar, for a page behind a proxy."""


_HERE = Listening()


def play(
    task: MaybeTask = None,
    index: Number = None,
    split: Word = None,
    instance: File = None,
    policy: Word = None,
    say: Annotated[
        str | None, tyro.conf.arg(metavar="TEXT", help_behavior_hint="")
    ] = None,
    failures: Flag = False,
    at: Annotated[Listening, tyro.conf.arg(name="")] = _HERE,
) -> int:
    """Open a page in the browser: give an instruction, and watch robots follow it.

    Args:
        task: Task to begin with, hook_stack by default; with --failures a folder of
            results.
        index: Index of the instance; 0 by default.
        split: Frozen list of the instance: train, val or test; or free, which samples
            it. The default is test, and free for your own tasks.
        instance: JSON file with your own instance, to begin with.
        policy: As in lemma evaluate; or 'oracle together', the expert with all robots
            at once, which is the default for teams of three and four. The default for
            pairs is reachnet if torch is installed, otherwise the expert, which
            understands only the benchmark's sentences.
        say: Your own sentence, which the policy follows at once.
        failures: List the failures in a folder of results, and play them beside the
            expert or another policy.
        at: Address of the page.

    Returns:
        Exit code: 0 after Ctrl-C.
    """
    if at.host not in (LOOPBACK, "localhost", "::1"):
        _warn(f"Anybody who reaches {at.host} can use this page: it has no password.")
    if failures:
        if (index, split, instance, say) != (None,) * 4:
            raise InvalidConfigError(
                "--failures takes --policy, but no instance and no --say."
            )
        return _open(_failures(task, policy, at), at)
    from lemma.viewer.episode.session import Session, best_for, choices
    from lemma.viewer.page import Page
    from lemma.viewer.server import open_server

    own = None
    if instance is not None:
        own = read_instance(instance, task, Selection(split=split, index=index))
        task = own.task
    task = task or _FIRST
    TASKS[task]
    policies = choices(policy)
    split = split or default_split(task, "test")
    kind = "high_level" if say is None else OWN_WORDS
    who = policy or best_for(task, policies)
    request = EpisodeRequest(task, split, index or 0, kind, say or "", who, own)
    session = Session(request, policies, acts=say is not None)
    server = open_server(at.host, at.port, at.allow_host, _warn)
    return _open(Page(session, server), at)


def _failures(folder: str | None, policy: str | None, at: Listening) -> "FailurePage":
    """Return the page of the failures in a folder.

    Raises:
        InvalidConfigError: No folder is named, or no episode failed.
        UnknownNameError: No episode of that policy failed.
    """
    from lemma.viewer.failures import FailurePage, policies_of
    from lemma.viewer.replays import cases_in

    if folder is None:
        raise InvalidConfigError(
            "--failures needs a folder of results, such as lemma play runs/mine "
            "--failures"
        )
    cases = cases_in(Path(folder))
    policies = policies_of(case for case in cases if case.cause is not None)
    if policy is not None and policy not in policies:
        raise UnknownNameError("policy", policy, policies)
    return FailurePage(cases, at.host, at.port, policy, at.allow_host, _warn)


def _warn(text: str) -> None:
    messages().print(text, style="yellow", markup=False, soft_wrap=True)


def _open(page: "Page | FailurePage", at: Listening) -> int:
    """Show a page until Ctrl-C."""
    try:
        output().print(f"{page.address}   (Ctrl-C to stop)", soft_wrap=True)
        if not at.no_open:
            webbrowser.open(page.address)
        page.run()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
    return 0
