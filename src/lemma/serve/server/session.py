"""The side of a conversation on which the policy is."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from lemma.core.version import VERSION as __version__
from lemma.env.view import View
from lemma.policies.interfaces import PastStep, PolicyInput, is_oracle, keeps_state
from lemma.serve.protocol.control import read, sent
from lemma.serve.protocol.faults import (
    UNAVAILABLE,
    FaultKind,
    PolicyFailedError,
    ProtocolError,
    trouble_of,
)
from lemma.serve.protocol.messages import (
    METHODS,
    PROTOCOL,
    Act,
    Commands,
    Control,
    ControlMessage,
    Decisions,
    Error,
    Ground,
    Hello,
    InputMessage,
    Plan,
    Poses,
    Reply,
    SubTasks,
    Welcome,
    decode_request,
    encode,
)

Call = Callable[[Callable[[], Any]], Any]
"""Runs something that asks the policy, and returns what it returned."""


_MEMORIES = 1024
"""Episodes of which a session keeps what its policy remembers: more than are played at
a time."""


class Session:
    """Answers the messages of one connection; keeps the views of its last request."""

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
            ProtocolError: It can do nothing of it, or is an oracle.
        """
        self.methods = [name for name in METHODS if hasattr(policy, name)]
        if not self.methods:
            raise ProtocolError(
                f"A {type(policy).__name__} is no policy: it has no act(), plan() or "
                "ground()."
            )
        if is_oracle(policy):
            raise ProtocolError(
                f"A {type(policy).__name__} needs the truth, which never travels. An "
                "oracle must live in the process that evaluates it: --timeout 0."
            )
        self._policy: Any = policy
        self._about = {"name": type(policy).__name__, **(about or {})}
        if hasattr(policy, "control_options"):
            self._about["control_options"] = dict(policy.control_options)
        if keeps_state(policy):
            self._about["keeps_state"] = True
        self._call = call
        self._views: dict[int, View] = {}
        self._memories: dict[int, Any] = {}

    def answer(self, data: bytes | str) -> bytes:
        """Return the answer to a message; what goes wrong is an answer as well."""
        try:
            return encode(self._answer(data))
        except ProtocolError as error:
            return encode(Error(kind="request", message=str(error)))
        except PolicyFailedError as error:
            return encode(Error(kind=error.kind, message=str(error)))
        except Exception as error:
            trouble = trouble_of(error)
            if trouble is not None:
                return encode(Error(kind=UNAVAILABLE, message=str(trouble)))
            # The policy is anybody's code, and the client finds out which episode.
            text = f"{type(error).__name__}: {error}"
            return encode(Error(kind=FaultKind.RAISED, message=text))

    def _answer(self, data: bytes | str) -> Reply:
        match decode_request(data):
            case Hello(protocol=version):
                return self._welcome(version)
            case Ground(subtasks=subtasks) as asked:
                inputs, ground = self._inputs(asked), self._method("ground")
                return Poses(poses=self._call(lambda: ground(inputs, subtasks)))
            case Plan() as asked:
                inputs, plan = self._inputs(asked), self._method("plan")
                return SubTasks(subtasks=self._call(lambda: plan(inputs)))
            case Act() as asked:
                inputs, act = self._inputs(asked), self._method("act")
                return Decisions(decisions=self._call(lambda: act(inputs)))
            case Control(inputs=asked):
                return self._control(asked)

    def _control(self, asked: list[ControlMessage]) -> Commands:
        """Return motor commands, and keep what the policy remembers."""
        act = self._method("act")
        inputs = [
            read(each, self._memories.get(each.episode) if each.step else None)
            for each in asked
        ]
        answers = list(self._call(lambda: act(inputs)))
        for each, answer in zip(asked, answers, strict=False):
            self._memories[each.episode] = getattr(answer, "memory", None)
        while len(self._memories) > _MEMORIES:
            del self._memories[next(iter(self._memories))]
        return Commands(actions=[sent(answer) for answer in answers])

    def _welcome(self, version: int) -> Welcome:
        if version != PROTOCOL:
            raise ProtocolError(
                f"This is version {PROTOCOL} of the protocol, and the client speaks "
                f"version {version}. Install the same version of lemma-bench on both "
                "sides."
            )
        return Welcome(
            protocol=PROTOCOL,
            methods=self.methods,
            policy=self._about,
            lemma=__version__,
        )

    def _method(self, name: str) -> Callable[..., Any]:
        if name not in self.methods:
            raise ProtocolError(
                f"The policy has no {name}(), but {', '.join(self.methods)}."
            )
        method: Callable[..., Any] = getattr(self._policy, name)
        return method

    def _inputs(self, asked: Act) -> list[PolicyInput]:
        """Return the inputs of a request, and keep its views for the next one."""
        known = self._views | {view.number: view.read() for view in asked.views}
        used = {number for one in asked.inputs for number in _numbers(one)}
        unknown = sorted(used - known.keys())
        if unknown:
            raise ProtocolError(f"The views {unknown} were not sent, or are forgotten.")
        self._views = {number: known[number] for number in used}
        return [self._input(one) for one in asked.inputs]

    def _input(self, asked: InputMessage) -> PolicyInput:
        past = tuple(
            PastStep(
                self._views[step.view], step.subtask, step.outcome, step.explanation
            )
            for step in asked.past
        )
        return PolicyInput(
            asked.instruction, tuple(asked.robots), self._views[asked.view], past
        )


def _numbers(asked: InputMessage) -> Iterable[int]:
    return (asked.view, *(step.view for step in asked.past))
