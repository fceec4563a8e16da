"""Checks of a policy's decisions, so that a fault ends only the affected episodes.

An output or an exception of a policy becomes either a valid decision or a
:class:`Fault`, which ends its episode and no other. External policies that hang or
crash are in separate processes; see :mod:`lemma.serve.isolation`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_names
from lemma.policies.control.interfaces import Actions, ControlInput, ControlPolicy
from lemma.policies.interfaces import Decision, Effort, Policy, PolicyInput
from lemma.policies.together.interfaces import (
    LONGEST_MESSAGE,
    Message,
    Orders,
    TeamInput,
    orders_of,
)
from lemma.scene.objects.entity import SHARED, known_entities, pair_regions
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.serve.faults import FaultKind, PolicyFailedError, trouble_of
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

FARTHEST_M = 100.0
"""Largest distance of a pose from the center of the table [m]; a larger one is in other
units."""

_LONGEST = 300


@dataclass(frozen=True, slots=True)
class Fault:
    """The reason why a policy has no valid decision for an episode."""

    kind: FaultKind
    explanation: str
    """One sentence."""
    effort: Effort | None = None
    """The effort of the failed decision, if it is counted."""

    def to_dict(self) -> dict[str, str]:
        """Return plain data, ready for JSON."""
        return {"kind": str(self.kind), "explanation": self.explanation}


class IsolatedPolicy:
    """Calls a policy with many episodes, and checks its decisions."""

    def __init__(self, policy: Policy | ControlPolicy) -> None:
        """Store the policy."""
        self._policy: Any = policy
        self._one_by_one = False

    def decide(self, inputs: Sequence[Any]) -> list[Any]:
        """Return the next decision of each episode, or a :class:`Fault`.

        If the policy fails for a batch, it is called for each episode alone, so that
        only the affected episodes fail. After a timeout there are no batches any more.

        Args:
            inputs: One per episode; at least one.

        Raises:
            PolicyUnreachableError: The policy's server does not answer, or this machine
                has no memory, disk space or file handles left. This is no fault of the
                policy.
            PlannerUnavailableError: The server of a language model does not answer, or
                a cassette lacks a reply.
            DatasetError: A file, such as a cassette, cannot be read or written.
            WeightsError: Weights cannot be read.
            RenderingError: Images cannot be rendered.
        """
        if len(inputs) > 1 and not self._one_by_one:
            answers = self._ask(inputs)
            if not isinstance(answers, Fault):
                return list(map(check, answers, inputs))
            self._one_by_one = answers.kind is FaultKind.TIMEOUT
        alone = [self._ask([policy_input]) for policy_input in inputs]
        return [
            found if isinstance(found, Fault) else check(found[0], policy_input)
            for found, policy_input in zip(alone, inputs, strict=True)
        ]

    def _ask(self, inputs: Sequence[Any]) -> list[object] | Fault:
        try:
            together = isinstance(inputs[0], TeamInput)
            ask = self._policy.act_together if together else self._policy.act
            answers: object = ask(inputs)
        except PolicyFailedError as error:
            return Fault(error.kind, _cut(str(error)))
        except Exception as error:
            trouble = trouble_of(error)
            if trouble is not None:
                raise trouble from error
            # Any exception: the policy may be external code.
            text = f"{type(error).__name__}: {error}"
            return Fault(FaultKind.RAISED, _cut(text))
        if not isinstance(answers, list | tuple):
            what = f"The policy returned a {type(answers).__name__}, not a list."
            return Fault(FaultKind.MALFORMED, what)
        if len(answers) != len(inputs):
            return Fault(
                FaultKind.MALFORMED,
                f"The policy returned {len(answers)} decisions for {len(inputs)} "
                "episodes.",
            )
        return list(answers)


def check(
    answer: Any, policy_input: PolicyInput | ControlInput
) -> Decision | Actions | Orders | Fault:
    """Return a decision in plain Python types, or a fault.

    An absent entity and a pose out of reach are valid, but wrong decisions. They are
    executed, and fail with an outcome in the policy's next input.

    Args:
        answer: Output of the policy.
        policy_input: Input of the policy.
    """
    try:
        if isinstance(policy_input, ControlInput):
            return _checked_actions(answer)
        if isinstance(policy_input, TeamInput):
            return _checked_orders(answer, policy_input)
        return _checked_decision(answer, len(policy_input.robots))
    except PolicyFailedError as error:
        failed = isinstance(answer, Decision) and bool(answer.failed)
        effort = _effort(answer) if failed else None
        return Fault(error.kind, _cut(str(error)), effort)


def _effort(answer: Decision) -> Effort | None:
    return answer.effort if isinstance(answer.effort, Effort) else None


def _checked_orders(answer: Any, team_input: TeamInput) -> Orders:
    """Return orders for free robots, at most one for each."""
    try:
        found = orders_of(answer)
    except TypeError as error:
        raise _malformed(f"The policy's {error}") from error
    decisions = [
        _checked_decision(one, len(team_input.robots)) for one in found.decisions
    ]
    free = set(team_input.free)
    for decision in decisions:
        if not decision.stops and decision.subtask.robot not in free:
            raise _malformed(
                f"The policy orders {decision.subtask}, and {decision.subtask.robot} "
                "is busy or was ordered something in the same answer. Free are: "
                f"{', '.join(team_input.free) or 'none'}"
            )
        free.discard(decision.subtask.robot)
    messages = [_message(one, team_input) for one in found.messages]
    efforts = [one for one in found.efforts if isinstance(one, Effort)]
    return Orders(tuple(decisions), tuple(messages), tuple(efforts))


def _message(message: object, team_input: TeamInput) -> Message:
    if not isinstance(message, Message) or not isinstance(message.text, str):
        raise _malformed(f"A message is a {type(message).__name__}, no Message")
    if len(message.text) > LONGEST_MESSAGE:
        raise _malformed(f"A message is longer than {LONGEST_MESSAGE} characters")
    _check_name("robot", message.robot, robot_names(len(team_input.robots)))
    return Message(message.robot, message.text, team_input.time_s)


def _checked_actions(answer: Any) -> Actions:
    """Return actions; the environment checks their shape."""
    if isinstance(answer, PolicyFailedError):
        raise answer
    found = answer if isinstance(answer, Actions) else Actions(answer)
    try:
        rows = np.asarray(found.rows)
    except (TypeError, ValueError) as error:
        raise _malformed(f"The actions are no array of numbers: {error}") from error
    if rows.dtype.kind not in "fiu":
        kind = type(found.rows).__name__
        raise _malformed(
            f"The actions are a {kind} of {rows.dtype}, no array of numbers"
        )
    if not np.isfinite(rows).all():
        raise _not_finite("The actions are not finite: NaN or infinite.")
    return Actions(rows, found.memory)


def _checked_decision(answer: object, robots: int) -> Decision:
    if not isinstance(answer, Decision):
        raise _malformed(
            f"The policy decided on a {type(answer).__name__}, no Decision"
        )
    explanation, effort = str(answer.explanation), _effort(answer)
    if answer.failed:
        known = answer.failed in tuple(FaultKind)
        kind = FaultKind(answer.failed) if known else FaultKind.MALFORMED
        raise PolicyFailedError(kind, explanation)
    subtask = _subtask(answer.subtask, robots)
    grounded = None
    if answer.grounded is not None and subtask is not STOP:
        grounded = _grounded(answer.grounded, subtask)
    elif subtask is not STOP and not (subtask.pick and subtask.place):
        raise PolicyFailedError(
            FaultKind.UNKNOWN_NAME,
            f"The decision has no poses, and names no entity: {subtask}.",
        )
    return Decision(subtask, grounded, explanation, effort=effort)


def _subtask(subtask: object, robots: int) -> SubTask:
    if not isinstance(subtask, SubTask):
        raise _malformed(f"The sub-task is a {type(subtask).__name__}, no SubTask")
    _check_name("primitive", subtask.primitive, list(Primitive))
    primitive = Primitive(subtask.primitive)
    if primitive is Primitive.STOP:
        return STOP
    _check_name("robot", subtask.robot, robot_names(robots))
    for entity in (subtask.pick, subtask.place):
        if entity != "":
            _check_name(
                "entity",
                entity,
                (
                    *known_entities(tuple(OBJECT_KINDS)),
                    SHARED,
                    *pair_regions(robots),
                ),
            )
    return SubTask(subtask.robot, primitive, subtask.pick, subtask.place)


def _grounded(grounded: object, subtask: SubTask) -> GroundedSubTask:
    if not isinstance(grounded, GroundedSubTask):
        name = type(grounded).__name__
        raise _malformed(f"The grounded sub-task is a {name}, no GroundedSubTask")
    if (grounded.robot, grounded.primitive) != (subtask.robot, subtask.primitive):
        raise _malformed(
            f"The poses are for {grounded.robot} {grounded.primitive}, but the "
            f"decision is {subtask.robot} {subtask.primitive}"
        )
    pick, place = _pose("pick", grounded.pick), _pose("place", grounded.place)
    return GroundedSubTask(subtask.robot, subtask.primitive, pick, place)


def _pose(end: str, pose: object) -> Pose2:
    if not isinstance(pose, Pose2):
        raise _malformed(f"The {end} pose is a {type(pose).__name__}, no Pose2")
    x, y, yaw = numbers = [_number(end, n) for n in (pose.x, pose.y, pose.yaw)]
    if not all(map(math.isfinite, numbers)):
        raise _not_finite(f"The {end} pose is not finite: {numbers}.")
    if math.hypot(x, y) > FARTHEST_M:
        raise _not_finite(
            f"The {end} pose is beyond every table, at ({x:g}, {y:g}) m; poses are in "
            "metres."
        )
    return Pose2(x, y, yaw)


def _number(end: str, value: Any) -> float:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    is_real = isinstance(value, float | int | np.integer | np.floating)
    if not is_real or isinstance(value, bool):
        raise _malformed(
            f"The {end} pose holds a {type(value).__name__} where a number belongs"
        )
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _malformed(what: str) -> PolicyFailedError:
    return PolicyFailedError(FaultKind.MALFORMED, f"{what}.")


def _not_finite(what: str) -> PolicyFailedError:
    return PolicyFailedError(FaultKind.NOT_FINITE, what)


def _check_name(kind: str, name: object, valid: Sequence[str]) -> None:
    if name not in valid:
        raise PolicyFailedError(
            FaultKind.UNKNOWN_NAME,
            f"The policy names the {kind} {name!r:.60}. Valid: {', '.join(valid)}.",
        )


def _cut(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]}..."
