"""How language models are asked, and what comes back."""

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
    """Nobody answers, or nobody may be asked.

    No fault of the model: nothing is known about what it would have decided.
    """


@dataclass(frozen=True)
class ChatOptions:
    """How a language model is asked; plain data, so that other processes can ask."""

    base_url: str = ""
    """Address of an OpenAI-compatible server, such as http://127.0.0.1:8000/v1. A key
    is read from the environment variable LEMMA_API_KEY."""
    cassette: Path | None = None
    """File of requests and answers: requests that are in it are not sent."""
    cassette_mode: Literal["record", "replay", "strict"] = "record"
    """Treatment of other requests. record: they are sent and kept; replay: they are
    sent; strict: they are an error that says what changed."""
    perception: Literal["truth", "seen"] = "truth"
    """Source of the text about the table: the simulation, or ReachNet's perception."""
    team: Literal["one", "each"] = "one"
    """One planner for the team, or one for each robot, with messages between them."""
    pictures: bool = False
    """Send the images of the robots' cameras as well."""
    tries: AtLeastOne = 3
    """Answers to a question, until one is a sub-task."""
    max_tokens: AtLeastOne = 1024
    """Largest length of an answer."""
    concurrency: AtLeastOne = 8
    """Requests at a time, of all workers of this machine. Each may take --timeout times
    as long, since the server may answer one after the other."""
    extra_body: str = ""
    """JSON object with fields of every request that replace the usual ones, for servers
    that do not know those; null leaves a field out."""

    def __post_init__(self) -> None:
        """Check the names and the numbers."""
        check_ranges(self)
        reserved = {"model", "messages", "stream"} & self.fields.keys()
        if reserved:
            raise InvalidConfigError(
                f"The extra body sets {', '.join(sorted(reserved))}, which every "
                "request sets for itself. Leave it out."
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
        """Return the options that decide the answers, not where they come from."""
        names = ("perception", "team", "pictures", "tries", "max_tokens")
        extra = {"extra_body": self.fields} if self.fields else {}
        return {name: getattr(self, name) for name in names} | extra

    def words(self) -> list[str]:
        """Return the options of the command line that ask for the same.

        Of a cassette the name alone: it is shared, and may lie anywhere.
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
    """The answer to a request, or why there is none."""

    content: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0
    failure: str = ""
    """``"timeout"`` or ``"raised"`` where the server gave no answer to this request."""
    explanation: str = ""
    """Error in one sentence, if it failed."""
    remark: str = ""
    """Why the content is empty or not whole, a sentence; empty if nothing is odd."""
