"""The side of a conversation on which the policy is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from lemma import __version__
from lemma.env.view import View
from lemma.policies.interfaces import PastStep, PolicyInput
from lemma.serve.protocol.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.serve.protocol.messages import (
    METHODS,
    PROTOCOL,
    Message,
    decision_to_message,
    entries,
    grounded_to_message,
    malformed,
    short,
    subtask_from_message,
    subtask_to_message,
    view_from_message,
)
from lemma.serve.selftest.echo import echo

Call = Callable[[Callable[[], Any]], Any]
"""Runs something that asks the policy, and returns what it returned."""


@dataclass
class _Known:
    """What was told of an episode."""

    instruction: str
    robots: tuple[str, ...]
    views: dict[int, View] = field(default_factory=dict)


class _MissingError(Exception):
    """Something is referred to that was never told, or told before a restart."""

    def __init__(self, episodes: list[int], views: list[list[int]]) -> None:
        super().__init__()
        self.reply = {"type": "missing", "episodes": episodes, "views": views}


class Session:
    """Answers the messages of one client; keeps what that client has shown."""

    def __init__(
        self,
        policy: object,
        about: Mapping[str, Any] | None = None,
        call: Call = lambda work: work(),
    ) -> None:
        """Begin.

        Args:
            policy: Anything that can act, plan or ground; see
                :mod:`lemma.policies.interfaces`.
            about: What the policy says of itself, ready for JSON.
            call: Asks the policy, in the right thread.

        Raises:
            ProtocolError: It can do nothing of it.
        """
        self.methods = [name for name in METHODS if hasattr(policy, name)]
        if not self.methods:
            raise ProtocolError(
                f"A {type(policy).__name__} is no policy: it has no act(), plan() or "
                "ground()."
            )
        self._policy: Any = policy
        self._about = {"name": type(policy).__name__, **(about or {})}
        self._call = call
        self._known: dict[int, _Known] = {}

    def answer(self, message: Message) -> Message:
        """Return the answer to a message; what goes wrong is an answer as well."""
        try:
            reply = self._answer(message)
        except _MissingError as missing:
            reply = missing.reply
        except ProtocolError as error:
            reply = _error("request", str(error))
        except PolicyFailedError as error:
            reply = _error(error.kind, str(error))
        except Exception as error:
            # The policy is anybody's code, and the client finds out which episode.
            reply = _error(FaultKind.RAISED, f"{type(error).__name__}: {error}")
        return {**reply, "id": message.get("id")}

    def _answer(self, message: Message) -> Message:
        match message.get("type"):
            case "hello":
                return self._hello(message)
            case "reset":
                return self._reset(message)
            case "check":
                return echo(self._policy, message)
            case method if method in self.methods:
                return self._decide(str(method), message)
            case other:
                raise ProtocolError(
                    f"The message {other!r} is not known here. Known: hello, reset, "
                    f"check, {', '.join(self.methods)}."
                )

    def _hello(self, message: Message) -> Message:
        if message.get("protocol") != PROTOCOL:
            raise ProtocolError(
                f"This is version {PROTOCOL} of the protocol, and the client speaks "
                f"version {message.get('protocol')!r}. Install the same version of "
                "lemma-bench on both sides."
            )
        return {
            "type": "hello",
            "protocol": PROTOCOL,
            "lemma": __version__,
            "methods": self.methods,
            "policy": self._about,
        }

    def _reset(self, message: Message) -> Message:
        for number in message.get("forget", ()):
            self._known.pop(number, None)
        for told in entries(message, "episodes"):
            self._known[int(told["episode"])] = _Known(
                str(told["instruction"]), tuple(map(str, told["robots"]))
            )
        return {"type": "ready"}

    def _decide(self, method: str, message: Message) -> Message:
        asked = entries(message, "inputs")
        # Everything is taken in before anything is missed: it is not sent again.
        for one in asked:
            self._look(one)
        inputs = self._inputs(asked)
        if method == "ground":
            subtasks = [subtask_from_message(s) for s in entries(message, "subtasks")]
            found = _listed(self._call(lambda: self._policy.ground(inputs, subtasks)))
            return {
                "type": "poses",
                "poses": [None if g is None else grounded_to_message(g) for g in found],
            }
        if method == "plan":
            planned = _listed(self._call(lambda: self._policy.plan(inputs)))
            return {
                "type": "subtasks",
                "subtasks": [subtask_to_message(s) for s in planned],
            }
        decided = _listed(self._call(lambda: self._policy.act(inputs)))
        return {
            "type": "decisions",
            "decisions": [decision_to_message(d) for d in decided],
        }

    def _look(self, asked: Message) -> None:
        known = self._known.get(asked["episode"])
        if known is not None:
            for number, view in asked.get("views", ()):
                known.views[number] = view_from_message(view)

    def _inputs(self, asked: list[Message]) -> list[PolicyInput]:
        unknown = [a["episode"] for a in asked if a["episode"] not in self._known]
        unseen = [
            [one["episode"], number]
            for one in asked
            if one["episode"] in self._known
            for number in {one["view"], *(step["view"] for step in one["past"])}
            if number not in self._known[one["episode"]].views
        ]
        if unknown or unseen:
            raise _MissingError(unknown, sorted(unseen))
        return [self._input(one) for one in asked]

    def _input(self, asked: Message) -> PolicyInput:
        known = self._known[asked["episode"]]
        past = tuple(
            PastStep(
                known.views[step["view"]],
                subtask_from_message(step["subtask"]),
                str(step["outcome"]),
            )
            for step in asked["past"]
        )
        return PolicyInput(
            known.instruction, known.robots, known.views[asked["view"]], past
        )


def _listed(answers: object) -> list[Any]:
    if not isinstance(answers, list | tuple):
        raise malformed(f"it returned {short(answers)}, not a list")
    return list(answers)


def _error(kind: str, text: str) -> Message:
    return {"type": "error", "kind": kind, "message": text}
