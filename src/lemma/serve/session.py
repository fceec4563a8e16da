"""The side of a conversation that answers for a policy, in either protocol."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError, shown
from lemma.core.robot_names import robot_names
from lemma.core.version import VERSION as __version__
from lemma.env.view import View
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import PastStep, PolicyInput, is_oracle, keeps_state
from lemma.serve.faults import (
    UNAVAILABLE,
    FaultKind,
    PolicyFailedError,
    ProtocolError,
    trouble_of,
)
from lemma.serve.messages import (
    METHODS,
    PROTOCOL,
    Act,
    Array,
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
from lemma.serve.vla_eval import Kind, Message, format_of, hello, pack, unpack

Call = Callable[[Callable[[], Any]], Any]
"""Calls a function that asks the policy in the right thread; returns its result."""
_MEMORIES = 1024
"""Episodes whose memory a session keeps: more than are played at a time."""
_STATE = ("agent_pos", "agent_vel", "tcp_pose")
_PER_ROBOT = 7
_SEES = ("rgb", "state")
_DEFAULTS = {"control": "joint_position", "control_hz": 20.0, "observation": "rgb"}
_SIZE = {"width": 640, "height": 480}


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
            about: Description of the policy, ready for JSON.
            call: Asks the policy, in the right thread.

        Raises:
            ProtocolError: It has none of these methods, or is an oracle.
        """
        self.methods = [name for name in METHODS if hasattr(policy, name)]
        if not self.methods:
            raise ProtocolError(
                f"A {type(policy).__name__} is no policy: it has no act(), plan() or "
                "ground()."
            )
        if is_oracle(policy):
            raise ProtocolError(
                f"A {type(policy).__name__} needs the simulation's state, which is "
                "sent to no other process. Evaluate it where it lives: lemma "
                "evaluate --timeout 0."
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
        """Return the answer to a message; errors are answers as well."""
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
        """Return motor commands, and keep the policy's memory of each episode."""
        act = self._method("act")
        inputs = [
            each.read(self._memories.get(each.episode) if each.step else None)
            for each in asked
        ]
        answers = list(self._call(lambda: act(inputs)))
        for each, answer in zip(asked, answers, strict=False):
            self._memories[each.episode] = getattr(answer, "memory", None)
        while len(self._memories) > _MEMORIES:
            del self._memories[next(iter(self._memories))]
        return Commands(actions=[_rows(answer) for answer in answers])

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


def _rows(answer: object) -> Array:
    """Return an answer's actions as a message.

    Raises:
        PolicyFailedError: They are no array of numbers.
    """
    rows = answer.rows if isinstance(answer, Actions) else answer
    try:
        return Array.of(np.asarray(rows, np.float64), "float64")
    except (TypeError, ValueError) as error:
        raise PolicyFailedError(
            FaultKind.MALFORMED, f"The actions are no array of numbers: {error}."
        ) from error


class ModelSession:
    """Answers the messages of one connection of vla-eval, one episode at a time.

    It answers the actions of a chunk one by one. Messages of vla-eval hold no depths,
    no maps and no calibration of cameras.
    """

    def __init__(
        self,
        policy: Any,
        about: Mapping[str, Any] | None = None,
        call: Call = lambda work: work(),
    ) -> None:
        """Begin.

        Args:
            policy: See :class:`lemma.policies.control.interfaces.ControlPolicy`.
            about: Description of the policy: its ``name``.
            call: Asks the policy, in the right thread.

        Raises:
            InvalidConfigError: Messages of vla-eval do not hold all that it needs.
        """
        options = {**_DEFAULTS, **getattr(policy, "control_options", {})}
        if options["observation"] not in _SEES:
            raise InvalidConfigError(
                f"The policy observes {shown(options['observation'])}, and messages of "
                f"vla-eval hold images and joints. Valid: {', '.join(_SEES)}; or serve "
                "it without --protocol vla-eval."
            )
        self._policy, self._options = policy, options
        self._sees = options["observation"] == _SEES[0]
        self._name = str((about or {}).get("name", type(policy).__name__))
        self._call = call
        self._begin()

    def answer(self, data: bytes | str) -> bytes | None:
        """Return the answer to a message, if it has one; errors are answers as well."""
        seq = 0
        failed: dict[str, str] = {}
        try:
            asked = unpack(data)
            seq = asked.seq
            found = self._answer(asked)
            if found is None:
                return None
            kind = Kind.HELLO if asked.kind is Kind.HELLO else Kind.ACTION
            return pack(Message.of(kind, found, seq))
        except (ProtocolError, PolicyFailedError) as error:
            failed["error"] = str(error)
        except Exception as error:
            # The policy is anybody's code.
            failed["error"] = f"{type(error).__name__}: {error}"
            if trouble_of(error) is not None:
                failed["kind"] = UNAVAILABLE
        return pack(Message.of(Kind.ERROR, failed, seq))

    def _answer(self, asked: Message) -> dict[str, Any] | None:
        if asked.kind is Kind.HELLO:
            return self._welcome()
        if asked.kind is Kind.OBSERVATION:
            return {"actions": self._act(asked.payload)}
        self._begin()
        return None

    def _begin(self) -> None:
        self._memory: Any = None
        self._step = 0
        self._chunk: list[NDArray[Any]] = []

    def _welcome(self) -> dict[str, Any]:
        own = format_of(self._options["control"])
        wanted = {**_SIZE, **self._options, "state": list(_STATE), "send_state": True}
        unspoken = {"clip_actions"} | ({"observation"} if self._sees else set())
        params = {k: v for k, v in wanted.items() if k not in unspoken}
        return hello(
            model_server=self._name,
            capabilities={},
            observation_params=params,
            action_spec={"actions": {"name": "actions", "dims": 0, "format": own}},
            observation_spec={
                "language": {"name": "language", "dims": 0, "format": "language"},
                "state": {"name": "state", "dims": 0, "format": "raw"},
            },
        )

    def _act(self, seen: Mapping[str, Any]) -> NDArray[Any]:
        """Return the next action, (n,)."""
        if not self._chunk:
            given = self._given(seen)
            [answer] = self._call(lambda: self._policy.act([given]))
            rows = answer
            if isinstance(answer, Actions):
                rows, self._memory = answer.rows, answer.memory
            values = np.asarray(rows)
            if values.dtype.kind not in "fiu" or values.ndim not in (2, 3):
                raise ProtocolError(
                    f"The policy answered {shown(rows)}. Valid: one action, (robots, "
                    "numbers), or a chunk, (steps, robots, numbers)."
                )
            self._chunk = list(values if values.ndim == 3 else values[None])
            if not self._chunk:
                raise ProtocolError("The policy answered a chunk of no actions.")
        self._step += 1
        return self._chunk.pop(0).ravel()

    def _given(self, seen: Mapping[str, Any]) -> ControlInput:
        """Return the input of the policy."""
        state = np.ravel(seen.get("states", seen.get("state", ())))
        robots = state.size // (len(_STATE) * _PER_ROBOT)
        if not robots or state.size % (len(_STATE) * _PER_ROBOT):
            raise ProtocolError(
                f"The observation has a state of {state.size} numbers. This policy is "
                f"given {', '.join(_STATE)}, {_PER_ROBOT} numbers for each robot: in "
                "the benchmark's parameters, state: [agent_pos, agent_vel, tcp_pose]."
            )
        parts = dict(zip(_STATE, np.split(state, len(_STATE)), strict=True))
        images = dict(seen.get("images") or {})
        return ControlInput(
            instruction=str(seen.get("task_description", "")),
            robots=tuple(seen.get("robots") or robot_names(robots)),
            observation={**parts, **({"pixels": images} if images else {})},
            step=self._step,
            time_s=self._step / float(self._options["control_hz"]),
            memory=self._memory,
        )
