"""Options of requests to language models, and their replies."""

import json
import shlex
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from lemma.core.arguments import check_ranges
from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.policies.class_path import secret_in

KEY_VARIABLE = "LEMMA_API_KEY"
"""Environment variable with the key of the server."""
AtLeastOne = Annotated[int, msgspec.Meta(ge=1)]


class PlannerUnavailableError(LemmaError, RuntimeError):
    """The server does not answer, or requests to it are not allowed.

    This is not counted as a failure of the model, whose decision is unknown.
    """


@dataclass(frozen=True)
class ChatOptions:
    """Options of requests to a language model: plain data for other processes."""

    base_url: str = ""
    """Address of an OpenAI-compatible server, such as http://127.0.0.1:8000/v1. A key
    is read from the environment variable LEMMA_API_KEY."""
    cassette: Path | None = None
    """File of recorded requests and replies: requests in it are not sent."""
    cassette_mode: Literal["record", "replay", "strict"] = "record"
    """Treatment of other requests. record: send and record them; replay: send them;
    strict: an error that shows the changes."""
    perception: Literal["truth", "seen"] = "truth"
    """Source of the text about the table: the simulation, or ReachNet's perception."""
    team: Literal["one", "each"] = "one"
    """One planner for the team, or one for each robot, with messages between them."""
    pictures: bool = False
    """Send the images of the robots' cameras as well."""
    tries: AtLeastOne = 3
    """Largest number of answers to a question, until one is valid."""
    max_tokens: AtLeastOne = 1024
    """Largest length of an answer."""
    concurrency: AtLeastOne = 8
    """Concurrent requests of all workers of this machine. The time limit of each is
    --timeout times this number, since the server may answer them sequentially."""
    extra_body: str = ""
    """JSON object whose fields replace those of every request, for servers that do not
    support them; null removes a field."""

    def __post_init__(self) -> None:
        """Check the names and the numbers."""
        check_ranges(self)
        reserved = {"model", "messages", "stream"} & self.fields.keys()
        if reserved:
            raise InvalidConfigError(
                f"The extra body sets {', '.join(sorted(reserved))}, which each "
                "request needs to set itself. Leave it out."
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
        """Return the options that affect the answers, without the source of replies."""
        names = ("perception", "team", "pictures", "tries", "max_tokens")
        extra = {"extra_body": self.fields} if self.fields else {}
        return {name: getattr(self, name) for name in names} | extra

    def words(self) -> list[str]:
        """Return these options as arguments of the command line.

        A cassette has its file name without the folder, which differs between machines.
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
    """The reply to a request, or the reason why there is none."""

    content: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    failure: str = ""
    """``"timeout"`` or ``"raised"`` if the server did not reply to this request."""
    explanation: str = ""
    """The error in one sentence, after a failure."""
    remark: str = ""
    """Why the content is empty or incomplete, in one sentence; empty otherwise."""
