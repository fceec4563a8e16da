"""Episodes of a policy, many at once, so that it decides in batches.

There are two verdicts. *Strict*: the first sub-task that its robot cannot do ends the
episode, as a protective stop of a real arm. *Lenient*: the policy gets the outcome and
continues, after the time of the attempt. All episodes are played to their strict ends
before any continues, so later decisions cannot change strict verdicts.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import msgspec
import numpy as np

from lemma.core.errors import PhysicsError
from lemma.env.camera_rig import CameraRig
from lemma.env.episode import LEAST_STEP_S, Episode
from lemma.env.simulation import HORIZON_S
from lemma.env.view import View
from lemma.evaluation.protocol.language_controls import OWN_SENTENCE, LanguageControl
from lemma.evaluation.protocol.rules import REFUSAL_S
from lemma.evaluation.records import POLICY_ERROR, PROTECTIVE_STOP, Feedback
from lemma.evaluation.run.expert_feedback import advise, left_in, refuse
from lemma.evaluation.run.fault_isolation import Fault, IsolatedPolicy
from lemma.evaluation.run.loading import load_policy
from lemma.evaluation.run.watches import ClearanceWatch
from lemma.motion.outcome import SkillResult
from lemma.policies.interfaces import (
    Decision,
    Effort,
    OracleInput,
    PastStep,
    PolicyInput,
    is_oracle,
    wants_cameras,
)
from lemma.policies.spec import PolicySpec
from lemma.serve.faults import FaultKind
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.language.blind import instruction
from lemma.tasks.subtask import GroundedSubTask, SubTask

BLIND = View(
    np.zeros((0, 0, 3), np.uint8),
    np.zeros((0, 0), np.float32),
    np.zeros((0, 0), np.bool_),
    np.zeros((0, 6)),
    np.zeros(0),
)


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One sub-task of a policy with its result."""

    subtask: SubTask
    grounded: GroundedSubTask | None
    """The sub-task with poses; None without poses."""
    result: SkillResult
    start_s: float
    """Simulated time at which it began [s]."""
    advice: Feedback
    """The expert's judgement of it."""
    fell: tuple[str, ...] = ()
    """Names of the objects that fell off the table during it."""
    partner: str = ""
    """The second robot of a joint sub-task; empty for other sub-tasks."""

    def fields(self) -> dict[str, Any]:
        """Return further fields of its record in the line."""
        return {"partner": self.partner} if self.partner else {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The state of an episode's evaluation at one time, or its outcome at the end."""

    success: bool
    progress: float
    goal_progress: float
    stages: dict[str, Any]
    """The furthest stage and the verdicts; see :mod:`lemma.env.stages`."""
    failure: str | None
    """Reason of the failure; None after success or before the end."""
    fault: Fault | None
    """Fault of the policy, if that ended the episode."""
    asked_holds: bool | None
    """Whether the language control's other goal holds; None without one."""
    elapsed_s: float
    idle_s: dict[str, float]
    """Idle simulated time of each robot [s]."""
    clearance_m: float
    """Smallest distance between arms so far [m]."""
    steps: int
    """Number of sub-tasks so far."""
    left: int | None
    """Length of the expert's plan from here; None without a plan."""
    state_sha256: str
    """Digest of the simulator's whole state."""
    asked: int = 0
    """Number of counted efforts of the policy so far."""
    together: dict[str, Any] | None = None
    """Record of robots that act together; None for turns."""


@dataclass
class Rollout:
    """One running episode."""

    instance: Instance
    kind: str = "high_level"
    """Kind of instruction."""
    horizon_s: float = HORIZON_S
    control: LanguageControl = OWN_SENTENCE
    """Language control that replaces the instruction."""
    steps: list[StepRecord] = field(default_factory=list)
    past: list[PastStep] = field(default_factory=list)
    efforts: list[Effort] = field(default_factory=list)
    """Effort of each decision, if the policy counts it."""
    fault: Fault | None = None
    """Fault of the policy, if that ended the episode."""
    protective_stop: Verdict | None = None
    """The strict verdict, if a protective stop was the strict end."""
    refusal: str | None = None
    """The policy's explanation if its first decision was to stop; otherwise None."""

    def __post_init__(self) -> None:
        """Begin the episode."""
        self.episode = self._begin()
        self.clearance = ClearanceWatch(self.episode.simulation)
        self._phrases = robot_phrases(self.instance.scene.robots)

    def _begin(self) -> Episode:
        return Episode(self.instance, horizon_s=self.horizon_s)

    @property
    def instruction(self) -> str:
        """The instruction for the policy."""
        own = instruction(self.instance, self.kind)
        return own if self.control.sentence is None else self.control.sentence

    @property
    def success(self) -> bool:
        """Strict success; see :meth:`verdict` for the lenient one."""
        return self.protective_stop is None and self._ended_well

    @property
    def _ended_well(self) -> bool:
        return self.fault is None and self.episode.is_success

    def is_over(self, *, strict: bool) -> bool:
        """Return whether it is over; strictly also after a protective stop."""
        return self.episode.is_over or (strict and self.protective_stop is not None)

    @property
    def asked_holds(self) -> bool | None:
        """Return whether the language control's other goal holds; None without one."""
        if self.control.asks is None:
            return None
        simulation = self.episode.simulation
        asked = Goal.from_pairs(self.control.asks)
        return asked.progress(simulation.scene) == 1.0 and not simulation.held()

    @property
    def failure(self) -> str | None:
        """Reason of the strict failure; None after success or before the end."""
        return PROTECTIVE_STOP if self.protective_stop else self._failure

    @property
    def _failure(self) -> str | None:
        return self.episode.failure if self.fault is None else POLICY_ERROR

    def left(self) -> int | None:
        """Return the length of the expert's plan; None without a plan."""
        return left_in(self.episode)

    def replans(self, decisions: range) -> int:
        """Return the number of decisions after a sub-task that was not carried out.

        Args:
            decisions: Numbers of the decisions, from 0.
        """
        before = [self.steps[number - 1] for number in decisions if number > 0]
        return sum(not step.result.ok for step in before)

    def verdict(self) -> Verdict:
        """Return the present lenient verdict."""
        info = self.episode.info()
        return Verdict(
            success=self._ended_well,
            progress=info["progress"],
            goal_progress=info["goal_progress"],
            stages=info["stages"],
            failure=self._failure,
            fault=self.fault,
            asked_holds=self.asked_holds,
            elapsed_s=info["elapsed_s"],
            idle_s=info["idle_s"],
            clearance_m=self.clearance.least_m,
            steps=len(self.steps),
            left=self.left(),
            state_sha256=self.episode.simulation.scene.state_hash(),
            asked=len(self.efforts),
        )

    def policy_input(self, rig: CameraRig | None, policy: object = None) -> PolicyInput:
        """Return the present input of a policy; without cameras it has no images.

        Images are rendered at once: neither time nor errors count for the policy.

        Args:
            rig: Cameras of the policy, if it has any.
            policy: The policy; an oracle gets privileged state, too.

        Raises:
            RenderingError: OpenGL does not work here.
        """
        view, scene = BLIND, self.episode.simulation.scene
        if rig is not None:
            view = rig.capture(scene, cameras=wants_cameras(policy))
        hands = scene.spec.other_hands
        given = (self.instruction, self._phrases, view, tuple(self.past), hands)
        if is_oracle(policy):
            return OracleInput(*given, episode=self.episode)
        return PolicyInput(*given)

    def fields(self, strict: Verdict) -> dict[str, Any]:
        """Return further fields of its line.

        Args:
            strict: The strict verdict.
        """
        return {}

    def stop(self) -> None:
        """End the episode."""
        self.episode.stop()

    def fail(self, fault: Fault) -> None:
        """End the episode after a fault of the policy."""
        self.fault = fault
        self.efforts += [fault.effort] if fault.effort else []
        self.episode.stop()

    def carry_out(self, policy_input: Any, decision: Any) -> StepRecord | None:
        """Execute a decision, or end the episode after a fault; None if it is over."""
        if isinstance(decision, Fault):
            self.fail(decision)
            return None
        before = self.episode.snapshot()
        try:
            return self.take(policy_input, decision)
        except PhysicsError as error:
            # Judge the state before the physics became unstable.
            self.episode.restore(before)
            self.fail(Fault(FaultKind.UNSTABLE, str(error)))
            return None

    def take(self, policy_input: PolicyInput, decision: Decision) -> StepRecord | None:
        """Execute a decision; None for ``stop``.

        Raises:
            PhysicsError: The physics became unstable.
        """
        episode = self.episode
        self.efforts += [decision.effort] if decision.effort else []
        if decision.stops:
            self.refusal = None if self.steps else decision.explanation
            episode.stop()
            return None
        start = episode.elapsed_s
        advice = advise(episode, decision)
        lost = episode.fallen
        partner = ""
        if decision.grounded is None:
            result = refuse(episode, decision)
        else:
            partner = episode.simulation.partner_of(decision.grounded)
            result = episode.execute(decision.grounded)
        fell = tuple(name for name in episode.fallen if name not in lost)
        step = StepRecord(
            decision.subtask, decision.grounded, result, start, advice, fell, partner
        )
        self.steps.append(step)
        if result.refused and self.protective_stop is None:
            self.protective_stop = replace(
                self.verdict(), success=False, failure=PROTECTIVE_STOP
            )
        episode.linger(start, REFUSAL_S if result.refused else LEAST_STEP_S)
        why = "" if result.ok else result.explanation
        self.past.append(
            PastStep(policy_input.view, decision.subtask, str(result.outcome), why)
        )
        return step


@dataclass(frozen=True)
class Player:
    """A policy with its cameras."""

    policy: Any
    """A :class:`~lemma.policies.interfaces.Policy`, or one at control level."""
    rig: CameraRig | None = None
    """None for a policy that needs no images."""

    @classmethod
    def load(cls, spec: PolicySpec) -> "Player":
        """Load a policy by name.

        Raises:
            LemmaError: There is no such policy, or its weights are damaged.
        """
        return cls(load_policy(spec), None if spec.blind else CameraRig())

    def begin(
        self, instance: Instance, kind: str, control: LanguageControl = OWN_SENTENCE
    ) -> Rollout:
        """Begin an episode."""
        return Rollout(instance, kind, control=control)

    def policy_input(self, rollout: Rollout) -> Any:
        """Return the policy's present input in an episode."""
        return rollout.policy_input(self.rig, self.policy)


def roll_out(
    rollouts: Iterable[Rollout],
    player: Player,
    at_once: int = 8,
    on_step: Callable[[Rollout, StepRecord], None] | None = None,
    *,
    lenient: bool = True,
) -> Iterator[Rollout]:
    """Play episodes to their ends, yielding each at its end.

    If the policy raises an exception, hangs or returns an invalid decision, the
    affected episode fails, and the others continue.

    Args:
        rollouts: Episodes to play; the next one begins when one has ended.
        player: Decides for all running episodes as a batch.
        at_once: Number of episodes that run at a time.
        on_step: Called with every sub-task at its end.
        lenient: Whether episodes continue after a protective stop, after the strict
            ends of all others.

    Raises:
        PolicyUnreachableError: The policy's server does not answer.
        PlannerUnavailableError: The server of its language model does not answer.
    """
    guard = IsolatedPolicy(player.policy)

    def to_the_end(begun: Iterable[Rollout], *, strict: bool) -> Iterator[Rollout]:
        """Yield each rollout at its end; strictly also at a protective stop."""
        waiting = iter(begun)
        running = list(islice(waiting, at_once))
        while running:
            inputs = [player.policy_input(one) for one in running]
            decisions = guard.decide(inputs)
            for one, policy_input, decision in zip(
                running, inputs, decisions, strict=True
            ):
                before = len(one.steps)
                one.carry_out(policy_input, decision)
                if on_step is not None:
                    for step in one.steps[before:]:
                        on_step(one, step)
            yield from [one for one in running if one.is_over(strict=strict)]
            running = [one for one in running if not one.is_over(strict=strict)]
            running += islice(waiting, at_once - len(running))

    stopped = []
    for rollout in to_the_end(rollouts, strict=True):
        if lenient and not rollout.episode.is_over:
            stopped.append(rollout)
        else:
            yield rollout
    yield from to_the_end(stopped, strict=False)


def subtasks_of(steps: Sequence[StepRecord]) -> list[dict[str, object]]:
    """Return steps as plain data, ready for JSON."""
    return [
        {
            **step.subtask.to_dict(),
            "grounded": step.grounded.to_dict() if step.grounded else None,
            "outcome": str(step.result.outcome),
            "explanation": step.result.explanation,
            "start_s": round(step.start_s, 3),
            "duration_s": round(step.result.duration_s, 3),
            "fell": list(step.fell),
            "expert": msgspec.to_builtins(step.advice),
            **step.fields(),
        }
        for step in steps
    ]
