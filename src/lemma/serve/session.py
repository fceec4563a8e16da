"""The server side of a connection, in either protocol."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError, shown
from lemma.core.robot_names import robot_names
from lemma.core.version import VERSION as __version__
from lemma.env.view import View
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import PastStep, PolicyInput, is_oracle, keeps_state
from lemma.policies.together.each_asked import EachAsked, asks_robots
from lemma.policies.together.interfaces import orders_of
from lemma.scene.cameras import CLOSE_PX
from lemma.serve import messages, vla_eval
from lemma.serve.arrays import Array
from lemma.serve.faults import (
    UNAVAILABLE,
    FaultKind,
    PolicyFailedError,
    ProtocolError,
    trouble_of,
)
from lemma.serve.vla_eval import Kind, Message

Call = Callable[[Callable[[], Any]], Any]
"""Runs a function in the policy's thread, and returns its result."""
_MEMORIES = 1024
"""Number of episodes whose memory a session keeps; fewer are played at a time."""
_STATE = ("agent_pos", "agent_vel", "tcp_pose")
_PER_ROBOT = 7
_SEES = ("rgb", "state")
_DEFAULTS = {"control": "joint_position", "control_hz": 20.0, "observation": "rgb"}
_SIZE = {"width": CLOSE_PX, "height": CLOSE_PX}


class Session:
    """Answers the messages of one connection; keeps the views of its last request."""

    def __init__(
        self,
        policy: object,
        about: Mapping[str, Any] | None = None,
        call: Call = lambda work: work(),
    ) -> None:
        """Begin a session.

        Args:
            policy: A policy; see :mod:`lemma.policies.interfaces`.
            about: Description of the policy, ready for JSON.
            call: Runs a function in the policy's thread.

        Raises:
            ProtocolError: The policy has none of the protocol's methods, or is an
                oracle.
        """
        if hasattr(policy, "act_alone") and not hasattr(policy, "act_together"):
            policy = EachAsked(policy)
        self.methods = [name for name in messages.METHODS if hasattr(policy, name)]
        if not self.methods:
            raise ProtocolError(
                f"A {type(policy).__name__} is not a policy: it has no act(), plan(), "
                "ground(), act_together() or act_alone()."
            )
        if is_oracle(policy):
            raise ProtocolError(
                f"A {type(policy).__name__} needs the simulation's state, which no "
                "other process gets. Evaluate it in the process of the simulation: "
                "lemma evaluate --timeout 0."
            )
        self._policy: Any = policy
        self._about = {"name": type(policy).__name__, **(about or {})}
        if hasattr(policy, "control_options"):
            self._about["control_options"] = dict(policy.control_options)
        if asks_robots(policy):
            self._about["asks_robots"] = True
        if keeps_state(policy):
            self._about["keeps_state"] = True
        self._call = call
        self._views: dict[int, View] = {}
        self._memories: dict[int, Any] = {}

    def answer(self, data: bytes | str) -> bytes:
        """Return the answer to a message; an error is answered with ``Error``."""
        try:
            return messages.encode(self._answer(messages.decode_request(data)))
        except Exception as error:
            kind, text = _error_fields(error)
            return messages.encode(messages.Error(kind=kind, message=text))

    def _answer(self, asked: messages.Request) -> messages.Reply:
        if isinstance(asked, messages.Hello):
            return self._welcome(asked.protocol)
        if isinstance(asked, messages.Control):
            return self._control(asked.inputs)
        inputs = self._inputs(asked)
        if isinstance(asked, messages.Together):
            answers = self._ask("act_together", inputs)
            return messages.AllOrders(orders=list(map(orders_of, answers)))
        if isinstance(asked, messages.Ground):
            return messages.Poses(poses=self._ask("ground", inputs, asked.subtasks))
        if isinstance(asked, messages.Plan):
            return messages.SubTasks(subtasks=self._ask("plan", inputs))
        return messages.Decisions(decisions=self._ask("act", inputs))

    def _ask(self, name: str, *arguments: Any) -> Any:
        """Call a method of the policy in its thread, and return the result."""
        if name not in self.methods:
            raise ProtocolError(
                f"The policy has no {name}(), only {', '.join(self.methods)}."
            )
        return self._call(lambda: getattr(self._policy, name)(*arguments))

    def _control(self, asked: list[messages.ControlMessage]) -> messages.Commands:
        """Return motor commands, and keep the policy's memory of each episode."""
        inputs = [
            each.read(self._memories.get(each.episode) if each.step else None)
            for each in asked
        ]
        answers = [*map(_rows, self._ask("act", inputs))]
        for each, (_, memory) in zip(asked, answers, strict=False):
            self._memories[each.episode] = memory
        while len(self._memories) > _MEMORIES:
            del self._memories[next(iter(self._memories))]
        return messages.Commands(
            actions=[Array.of(rows, "float64") for rows, _ in answers]
        )

    def _welcome(self, version: int) -> messages.Welcome:
        own = messages.PROTOCOL
        if version != own:
            raise ProtocolError(
                f"This server uses version {own} of the protocol, the client version "
                f"{version}. Install the same version of lemma-bench on both sides."
            )
        return messages.Welcome(
            protocol=own,
            methods=self.methods,
            policy=self._about,
            lemma=__version__,
        )

    def _inputs(self, asked: messages.Act | messages.Together) -> list[PolicyInput]:
        """Return the inputs of a request, and keep its views for the next one."""
        known = self._views | {view.number: view.read() for view in asked.views}
        used = {one.view for one in asked.inputs}
        used |= {step.view for one in asked.inputs for step in one.past}
        teams = [one for one in asked.inputs if isinstance(one, messages.TeamMessage)]
        used |= {view for one in teams for view in one.own_views.values()}
        unknown = sorted(used - known.keys())
        if unknown:
            raise ProtocolError(f"The views {unknown} were not sent, or not kept.")
        self._views = {number: known[number] for number in used}
        return [self._input(one) for one in asked.inputs]

    def _input(self, asked: messages.InputMessage) -> PolicyInput:
        past = tuple(
            PastStep(
                self._views[step.view], step.subtask, step.outcome, step.explanation
            )
            for step in asked.past
        )
        found = PolicyInput(
            asked.instruction,
            tuple(asked.robots),
            self._views[asked.view],
            past,
            tuple(asked.hands),
        )
        if isinstance(asked, messages.TeamMessage):
            return asked.read(found, self._views)
        return found


def _error_fields(error: Exception) -> tuple[str, str]:
    """Return the kind of an error message, and its text."""
    if isinstance(error, ProtocolError):
        return "request", str(error)
    if isinstance(error, PolicyFailedError):
        return error.kind, str(error)
    trouble = trouble_of(error)
    if trouble is not None:
        return UNAVAILABLE, str(trouble)
    # An error of the policy's own code; the client finds out for which episode.
    return FaultKind.RAISED, f"{type(error).__name__}: {error}"


def _rows(answer: object) -> tuple[NDArray[Any], Any]:
    """Return an answer's actions and the policy's new memory.

    Raises:
        PolicyFailedError: The actions are not an array of numbers.
    """
    rows = answer.rows if isinstance(answer, Actions) else answer
    try:
        return np.asarray(rows, np.float64), getattr(answer, "memory", None)
    except (TypeError, ValueError) as error:
        raise PolicyFailedError(
            FaultKind.MALFORMED, f"The actions are no array of numbers: {error}."
        ) from error


class ModelSession(Session):
    """Answers the messages of one connection of vla-eval, one episode at a time.

    It sends the actions of a chunk one by one. Messages of vla-eval have no depth, no
    maps and no camera calibration.
    """

    def __init__(
        self,
        policy: Any,
        about: Mapping[str, Any] | None = None,
        call: Call = lambda work: work(),
    ) -> None:
        """Begin a session.

        Args:
            policy: A :class:`lemma.policies.control.interfaces.ControlPolicy`.
            about: Description of the policy: its ``name``.
            call: Runs a function in the policy's thread.

        Raises:
            ProtocolError: The policy has no ``act``, or is an oracle.
            InvalidConfigError: Messages of vla-eval cannot carry all of its inputs.
        """
        super().__init__(policy, about, call)
        self._options = {**_DEFAULTS, **getattr(policy, "control_options", {})}
        sees = self._options["observation"]
        if sees not in _SEES:
            raise InvalidConfigError(
                f"The policy observes {shown(sees)}; messages of vla-eval have only "
                f"images and joints. Valid: {', '.join(_SEES)}; or serve it without "
                "--protocol vla-eval."
            )
        self._begin()

    def answer(self, data: bytes | str) -> bytes:
        """Return the answer to a message; empty bytes if there is none."""
        seq = 0
        try:
            asked = vla_eval.unpack(data)
            seq = asked.seq
            if asked.kind is Kind.HELLO:
                answer = Message.of(Kind.HELLO, self._hello(), seq)
            elif asked.kind is Kind.OBSERVATION:
                action = self._act(asked.payload)
                answer = Message.of(Kind.ACTION, {"actions": action}, seq)
            else:
                self._begin()
                return b""
            return vla_eval.pack(answer)
        except Exception as error:
            kind, text = _error_fields(error)
        failed = {"error": text, **({"kind": kind} if kind == UNAVAILABLE else {})}
        return vla_eval.pack(Message.of(Kind.ERROR, failed, seq))

    def _begin(self) -> None:
        self._memory: Any = None
        self._step = 0
        self._chunk: list[NDArray[Any]] = []

    def _hello(self) -> dict[str, Any]:
        own = vla_eval.format_of(self._options["control"])
        wanted = {**_SIZE, **self._options, "state": list(_STATE), "send_state": True}
        # vla-eval observes images by default.
        unspoken = {"clip_actions"}
        if wanted["observation"] == _SEES[0]:
            unspoken.add("observation")
        return vla_eval.hello(
            model_server=self._about["name"],
            capabilities={},
            observation_params={k: v for k, v in wanted.items() if k not in unspoken},
            action_spec={"actions": {"name": "actions", "dims": 0, "format": own}},
            observation_spec={
                "language": {"name": "language", "dims": 0, "format": "language"},
                "state": {"name": "state", "dims": 0, "format": "raw"},
            },
        )

    def _act(self, seen: Mapping[str, Any]) -> NDArray[Any]:
        """Return the next action, (n,)."""
        if not self._chunk:
            [answer] = self._ask("act", [self._control_input(seen)])
            rows, self._memory = _rows(answer)
            if rows.ndim not in (2, 3) or not len(rows):
                raise ProtocolError(
                    f"The policy answered {shown(rows)}. Valid: one action, (robots, "
                    "numbers), or a chunk, (steps, robots, numbers)."
                )
            self._chunk = list(rows if rows.ndim == 3 else rows[None])
        self._step += 1
        return self._chunk.pop(0).ravel()

    def _control_input(self, seen: Mapping[str, Any]) -> ControlInput:
        """Return the input of the policy."""
        state = np.ravel(seen.get("states", seen.get("state", ())))
        robots = state.size // (len(_STATE) * _PER_ROBOT)
        if not robots or state.size % (len(_STATE) * _PER_ROBOT):
            raise ProtocolError(
                f"The observation has a state of {state.size} numbers. This policy "
                f"needs {', '.join(_STATE)}, {_PER_ROBOT} numbers each for each robot: "
                "set state: [agent_pos, agent_vel, tcp_pose] in the benchmark's "
                "parameters."
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
