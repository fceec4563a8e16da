"""`lemma play`: a page in the browser with a table, two robots, and a sentence."""

import webbrowser
from dataclasses import dataclass
from typing import Annotated

import tyro

from lemma.cli.options import Flag, Number, Word, messages, output
from lemma.tasks.suite import default_split
from lemma.tasks.task import TASKS
from lemma.viewer.wish import OWN_WORDS, Wish

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class Listening:
    """Where the page is."""

    host: str = LOOPBACK
    """Address to listen on; only this machine reaches the default."""
    port: int = 8080
    """Port to listen on; the next one that is free if it is taken."""
    no_open: Flag = False
    """Open no browser."""


_HERE = Listening()


def play(
    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TASK]")] = (
        "hook_stack"
    ),
    index: Number = None,
    split: Word = None,
    policy: Word = None,
    say: Annotated[
        str | None, tyro.conf.arg(metavar="TEXT", help_behavior_hint="")
    ] = None,
    at: Annotated[Listening, tyro.conf.arg(name="")] = _HERE,
) -> int:
    """Open a page in the browser: say something, and watch two robots do it.

    Args:
        task: Task to begin with.
        index: Number of its instance; 0 by default.
        split: Frozen list to take it from: train, val or test; or free, which samples
            it. By default test, and free for tasks of your own.
        policy: Who acts, as in lemma evaluate. By default reachnet where torch is
            installed, else the expert, which reads the benchmark's sentences alone.
        say: A sentence of your own, which is acted on at once.
        at: Where the page is.

    Returns:
        Exit code: 0 after Ctrl-C.
    """
    from lemma.viewer.page import Page
    from lemma.viewer.policies import choices
    from lemma.viewer.session import Session

    TASKS[task]
    policies = choices(policy)
    wish = Wish(
        task,
        split or default_split(task, "test"),
        index or 0,
        "high_level" if say is None else OWN_WORDS,
        say or "",
        policy or policies[0],
    )
    if at.host not in (LOOPBACK, "localhost", "::1"):
        messages().print(
            f"Whoever reaches {at.host} can use this page; it asks for no password.",
            style="yellow",
        )
    page = Page(Session(wish, policies, acts=say is not None), at.host, at.port)
    try:
        output().print(f"{page.address}   (Ctrl-C ends it)", soft_wrap=True)
        if not at.no_open:
            webbrowser.open(page.address)
        page.run()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
    return 0
