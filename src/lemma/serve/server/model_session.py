"""A policy at control level that answers as a model server of vla-eval does."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.errors import InvalidConfigError, shown
from lemma.core.robot_names import robot_names
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.serve.protocol.faults import PolicyFailedError, ProtocolError
from lemma.serve.protocol.vla_eval import (
    Kind,
    Message,
    format_of,
    hello,
    pack,
    unpack,
)
from lemma.serve.server.session import Call

_STATE = ("agent_pos", "agent_vel", "tcp_pose")
_PER_ROBOT = 7
_SEES = ("rgb", "state")
_DEFAULTS = {"control": "joint_position", "control_hz": 20.0, "observation": "rgb"}
_SIZE = {"width": 640, "height": 480}


class ModelSession:
    """Answers the messages of one connection, on which one episode is played at a time.

    Chunks are given out action by action. What vla-eval's messages do not hold is
    missing: depths, maps and the calibration of cameras.
    """

    def __init__(
        self,
        policy: Any,
        about: Mapping[str, Any] | None = None,
        call: Call | None = None,
    ) -> None:
        """Begin.

        Args:
            policy: See :class:`lemma.policies.control.interfaces.ControlPolicy`.
            about: What the policy says of itself: its ``name``.
            call: Asks the policy, in the right thread.

        Raises:
            InvalidConfigError: It needs what vla-eval's messages do not hold.
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
        self._call: Call = call or (lambda work: work())
        self._begin()

    def answer(self, data: bytes | str) -> bytes | None:
        """Return the answer to a message, if it has one; errors are answers as well."""
        seq = 0
        try:
            asked = unpack(data)
            seq = asked.seq
            found = self._answer(asked)
            if found is None:
                return None
            kind = Kind.HELLO if asked.kind is Kind.HELLO else Kind.ACTION
            return pack(Message(kind, found, seq))
        except (ProtocolError, PolicyFailedError) as error:
            text = str(error)
        except Exception as error:
            # The policy is anybody's code.
            text = f"{type(error).__name__}: {error}"
        return pack(Message(Kind.ERROR, {"error": text}, seq))

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
        """Return what the policy is given."""
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
