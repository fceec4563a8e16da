"""Replay of an episode from the decisions in its line, without the policy."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from lemma.env.episode import Episode
from lemma.evaluation.protocol.disturbances import disturb
from lemma.evaluation.protocol.language_controls import FULL, control_of
from lemma.evaluation.records import STATE, WALL_CLOCK, Row
from lemma.evaluation.run.evaluate import line_of
from lemma.evaluation.run.fault_isolation import Fault, check
from lemma.evaluation.run.rollout import Rollout
from lemma.evaluation.run.together import TeamRollout
from lemma.policies.interfaces import Decision
from lemma.serve.faults import FaultKind
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, SubTask

Watcher = Callable[[Episode, int], None]
"""Called with the episode and the number of sub-tasks before each one and at the
end."""

_FREE = (*WALL_CLOCK, "planning", "policy_error", "explanation", "messages")
"""Fields that depend on the machine or on the policy, and explanations."""


def play_again(
    row: Row,
    instance: Instance,
    about: Mapping[str, Any],
    watch: Watcher = lambda episode, number: None,
    *,
    strictly: bool = False,
) -> Row:
    """Execute the decisions of a line again, and return the resulting line.

    Physics is deterministic, so both lines are equal with the same versions.

    Args:
        row: A line of ``episodes.jsonl``, not of a policy at control level.
        instance: The instance of the episode.
        about: Settings, as in ``about.json``, with the horizon and the language
            control.
        watch: Called with the episode before each sub-task; for robots that act
            together before each decision, with the number of ended sub-tasks.
        strictly: Whether to end at the strict verdict.
    """
    rollout = _set_table(row, instance, about)
    lenient = None if strictly else row["lenient"]
    if isinstance(rollout, TeamRollout):
        count = _order_again(rollout, row["together"], watch, strict=lenient is None)
    else:
        subtasks = [*row["subtasks"], *(lenient["subtasks"] if lenient else ())]
        count = len(subtasks)
        for number, step in enumerate(subtasks):
            if rollout.is_over(strict=lenient is None):
                break
            watch(rollout.episode, number)
            policy_input = rollout.policy_input(None)
            # The check rejects forged lines; an evaluation writes valid decisions only.
            rollout.carry_out(policy_input, check(decision_of(step), policy_input))
    fault = (lenient or row)["policy_error"]
    if not rollout.is_over(strict=lenient is None):
        if fault is None:
            rollout.refusal = _refusal_in(row)
            rollout.stop()
        else:
            rollout.fail(Fault(FaultKind(fault["kind"]), fault["explanation"]))
    watch(rollout.episode, count)
    return line_of(rollout, moved=row["perturb_start"], lenient=lenient is not None)


def _refusal_in(row: Row) -> str | None:
    """Return the words of a policy that refused, where a line has some."""
    pair, together = row.get("pair"), row.get("together")
    acted = row["subtasks"] or (together is not None and together["orders"])
    return pair["reason"] if pair and pair["refused"] and not acted else None


def _set_table(row: Row, instance: Instance, about: Mapping[str, Any]) -> Rollout:
    """Return the episode of a line at its start."""
    kind, together = row["instruction_kind"], row.get("together")
    control = control_of(about.get("language", FULL), instance, kind)
    arguments = (instance, kind, about["horizon_s"], control)
    if together is None:
        rollout = Rollout(*arguments)
    else:
        rollout = TeamRollout(*arguments, expert_poses=together["expert_poses"])
    if about.get("disturb"):
        disturb(rollout.episode, about["disturb"])
    return rollout


def _order_again(
    rollout: TeamRollout, together: Row, watch: Watcher, *, strict: bool
) -> int:
    """Give the orders of a line again; return their number."""
    orders: dict[int, list[Decision]] = {}
    for order in together["orders"]:
        poses = order["poses"]
        found = None if poses is None else GroundedSubTask.from_dict(poses)
        decision = Decision(SubTask.from_dict(order), found)
        orders.setdefault(order["asked"], []).append(decision)
    for number in range(together["asked"]):
        if rollout.is_over(strict=strict):
            break
        watch(rollout.episode, len(rollout.steps))
        policy_input = rollout.policy_input(None)
        rollout.carry_out(policy_input, check(orders.get(number, []), policy_input))
    return len(rollout.steps)


def decision_of(step: dict[str, Any]) -> Decision:
    """Return the decision of a sub-task of a line."""
    subtask = SubTask.from_dict(step)
    poses = step["grounded"]
    found = None if poses is None else GroundedSubTask.from_dict(poses)
    return Decision(subtask, found, step["explanation"])


def differences(row: Row, again: Row, *, strictly: bool = False) -> Iterator[str]:
    """Yield texts of the differences between a line and its replay.

    Args:
        row: The line.
        again: The line that :func:`play_again` returned.
        strictly: Whether the replay ended at the strict verdict.
    """
    skipped = {"lenient"} if strictly else set()
    said, found = (
        {name: value for name, value in line.items() if name not in skipped}
        for line in (row, again)
    )
    for place, (one, other) in _unequal(said, found, ""):
        yield f"{place} is {_short(one)}, and {_short(other)} when played again"


def _unequal(
    said: Any, found: Any, place: str
) -> Iterator[tuple[str, tuple[Any, Any]]]:
    if isinstance(said, Mapping) and isinstance(found, Mapping):
        for name in dict.fromkeys([*said, *found]):
            # Lines of earlier releases have no hash of the state.
            old = name == STATE and said.get(name) is None
            if name not in _FREE and not old:
                inner = f"{place}.{name}" if place else str(name)
                yield from _unequal(said.get(name), found.get(name), inner)
    elif isinstance(said, list) and isinstance(found, list):
        if len(said) != len(found):
            yield f"the number of {place}", (len(said), len(found))
        for number, (one, other) in enumerate(zip(said, found, strict=False), 1):
            yield from _unequal(one, other, f"{place}[{number}]")
    elif said != found or type(said) is not type(found):
        yield place, (said, found)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


_LONGEST = 60
