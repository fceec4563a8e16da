"""Episodes of robots that act together, with orders for free robots.

The loop and the verdicts are those of episodes in turns. The policy decides at every
decision point of :class:`lemma.env.team.orders.Team`. The first order that its robot
cannot carry out is the strict end; leniently only that robot loses time. A line has the
orders and their outcomes, so an episode can be executed again without its policy.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lemma.core.errors import PhysicsError
from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.env.team.orders import Team
from lemma.env.team.records import Done
from lemma.env.view import View
from lemma.evaluation.protocol.language_controls import OWN_SENTENCE, LanguageControl
from lemma.evaluation.protocol.rules import REFUSAL_S
from lemma.evaluation.protocol.schedules import (
    executed_s,
    schedule_score,
    team_times,
    worked_in,
)
from lemma.evaluation.records import PROTECTIVE_STOP, Feedback
from lemma.evaluation.run.expert_feedback import advise, left_in, refuse
from lemma.evaluation.run.fault_isolation import Fault
from lemma.evaluation.run.rollout import (
    BLIND,
    Player,
    Rollout,
    StepRecord,
    Verdict,
    subtasks_of,
)
from lemma.evaluation.run.watches import ContactWatch
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import Decision, PastStep, is_oracle, wants_cameras
from lemma.policies.together.adapters import WithExpertPoses
from lemma.policies.together.each_asked import asks_robots
from lemma.policies.together.interfaces import (
    Doing,
    Message,
    Orders,
    TeamInput,
    TeamOracleInput,
)
from lemma.serve.faults import FaultKind
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, SubTask


@dataclass(frozen=True, slots=True)
class TeamStep(StepRecord):
    """One ended order."""

    waited_s: float = 0.0
    """Time of waiting for a sector [s]."""
    effect_s: float | None = None
    """Time at which its effect was first observed [s]."""

    def fields(self) -> dict[str, Any]:
        """Return further fields of its record in the line."""
        effect_s = None if self.effect_s is None else round(self.effect_s, 3)
        # Without super(): classes with slots are made anew.
        also = StepRecord.fields(self)
        return {"waited_s": round(self.waited_s, 3), "effect_s": effect_s, **also}


@dataclass(frozen=True, slots=True)
class _OrderRecord:
    """An order of the policy, as in lines."""

    asked: int
    subtask: SubTask
    poses: GroundedSubTask | None


@dataclass(frozen=True, slots=True)
class _Note:
    """The state at the start of an active order."""

    subtask: SubTask
    view: View
    since_s: float
    advice: Feedback
    fallen: tuple[str, ...]
    waited_s: float


@dataclass(kw_only=True)
class TeamRollout(Rollout):
    """One episode of robots that act together."""

    expert_poses: bool
    """Whether the expert grounds the orders when they begin."""
    asked: int = 0
    """Number of the policy's decisions so far, without ``stop``."""
    orders: list[_OrderRecord] = field(default_factory=list)
    messages: list[Message] = field(default_factory=list)
    notes: dict[str, _Note] = field(default_factory=dict)
    """Start states of active orders, by robot, oldest first."""

    def _begin(self) -> Episode:
        episode = super()._begin()
        self.team = Team(episode, refusal_s=REFUSAL_S)
        self.contacts = ContactWatch(episode.simulation)
        return episode

    def policy_input(self, rig: CameraRig | None, policy: object = None) -> TeamInput:
        """Return the present input of a policy; see :meth:`Rollout.policy_input`."""
        scene, free = self.episode.simulation.scene, self.team.free
        view, own = BLIND, dict[str, View]()
        if asks_robots(policy):
            own = dict.fromkeys(free, BLIND)
        if rig is not None:
            cameras = wants_cameras(policy)
            for name in own:
                own[name] = rig.capture(scene, cameras=cameras, robots=(name,))
            view = view if own else rig.capture(scene, cameras=cameras)
        waits = self.team.waits_for
        hands = self.instance.scene.other_hands
        common = (self.instruction, self._phrases, view, tuple(self.past), hands)
        team_fields: dict[str, Any] = {
            "time_s": self.episode.elapsed_s,
            "free": free,
            "doing": {
                name: Doing(note.subtask, note.since_s, waits.get(name, ()))
                for name, note in self._under_way()
            },
            "messages": tuple(self.messages),
            "own_views": own,
        }
        if is_oracle(policy):
            return TeamOracleInput(
                *common, **team_fields, episode=self.episode, team=self.team
            )
        return TeamInput(*common, **team_fields)

    def _under_way(self) -> Iterator[tuple[str, _Note]]:
        """Yield the busy robots, each with its order or that of which it is partner."""
        yield from self.notes.items()
        for name in self.instance.scene.robot_names:
            if name not in self.notes and (leader := self.team.works_on(name)):
                yield name, self.notes[leader]

    def carry_out(self, policy_input: Any, decision: Any) -> None:
        """Execute a policy's orders, or end the episode after a fault."""
        if isinstance(decision, Fault):
            self.fail(decision)
            return
        before = self.episode.snapshot(), self.team.state()
        lists: tuple[list[Any], ...] = (self.steps, self.past, self.orders)
        lengths, asked = [len(each) for each in lists], self.asked
        try:
            self.take(policy_input, decision)
        except PhysicsError as error:
            # Judge the state before the physics became unstable.
            self.episode.restore(before[0])
            self.team.restore(before[1])
            for each, length in zip(lists, lengths, strict=True):
                del each[length:]
            self.asked = asked
            self.fail(Fault(FaultKind.UNSTABLE, str(error)))

    def take(self, policy_input: Any, decision: Any) -> None:
        """Give orders, and advance to the next decision point.

        Raises:
            PhysicsError: The physics became unstable.
        """
        orders: Orders = decision
        self.efforts += [one.effort for one in orders.decisions if one.effort]
        self.efforts += orders.efforts
        self.messages += orders.messages
        stops = [one for one in orders.decisions if one.stops]
        if stops:
            self.refusal = None if self.orders else stops[0].explanation
            self.stop()
            return
        self.asked += 1
        for one in orders.decisions:
            self._order(policy_input, one)
        self._note(self.team.advance())

    def _order(self, team_input: TeamInput, decision: Decision) -> None:
        subtask, robot = decision.subtask, decision.subtask.robot
        if self.team.works_on(robot):
            # Another order of this answer has taken it as its partner.
            return
        poses = None if self.expert_poses else decision.grounded
        self.orders.append(_OrderRecord(self.asked - 1, subtask, poses))
        self.notes[robot] = _Note(
            subtask,
            team_input.own_views.get(robot, team_input.view),
            self.episode.elapsed_s,
            advise(self.episode, decision, self._expected()),
            self.episode.fallen,
            self._waited_s(robot),
        )
        if poses is None and not self.expert_poses:
            done = self.team.refuse(subtask, refuse(self.episode, decision))
            self._note((done,))
        else:
            refused = self.team.order(subtask, poses)
            self._note((refused,) if refused else ())

    def _expected(self) -> SymbolicState:
        """Return the expected state after all active orders."""
        now = self.team.observe()
        return self.team.expected(now, self.team.settled(now))

    def _waited_s(self, robot: str) -> float:
        times = self.episode.simulation.reservations.times
        return times.waited_s.get(robot, 0.0)

    def _note(self, ended: Sequence[Done]) -> None:
        """Record ended orders."""
        for done in ended:
            note, result = self.notes.pop(done.robot), done.result
            lost = self.episode.fallen
            step = TeamStep(
                note.subtask,
                done.grounded,
                result,
                done.start_s,
                note.advice,
                tuple(name for name in lost if name not in note.fallen),
                done.partner,
                self._waited_s(done.robot) - note.waited_s,
                done.effect_s,
            )
            why = "" if result.ok else result.explanation
            self.steps.append(step)
            self.past.append(
                PastStep(note.view, note.subtask, str(result.outcome), why)
            )
        if self.protective_stop is None and any(d.result.refused for d in ended):
            self.protective_stop = replace(
                self.verdict(), success=False, failure=PROTECTIVE_STOP
            )

    def stop(self) -> None:
        """Finish active orders, and end the episode."""
        self._note(self.team.stop())

    def fail(self, fault: Fault) -> None:
        """End the episode after a fault of the policy; active orders finish."""
        self.fault = fault
        self.efforts += [fault.effort] if fault.effort else []
        if fault.kind is FaultKind.UNSTABLE:
            self.episode.stop()
        else:
            self.stop()

    def left(self) -> int | None:
        """Return the length of the expert's plan after all active orders."""
        return left_in(self.episode, self._expected())

    def replans(self, decisions: range) -> int:
        """Return the number of orders not carried out; 0 without decisions."""
        return sum(not step.result.ok for step in self.steps) if decisions else 0

    def verdict(self) -> Verdict:
        """Return the present lenient verdict."""
        return replace(super().verdict(), together=self._figures())

    def _figures(self) -> dict[str, Any]:
        names = self.instance.scene.robot_names
        times = team_times(names, worked_in(subtasks_of(self.steps), len(names)))
        waits = self.episode.simulation.reservations.times
        shares = ("busy", "waiting", "thinking", "predecessor", "no_work")
        return {
            "makespan_s": round(times.makespan_s, 3),
            "concurrency": round(times.concurrency, 4),
            **{
                f"{name}_s": {
                    robot: round(seconds, 3)
                    for robot, seconds in getattr(times, f"{name}_s").items()
                }
                for name in shares
            },
            "parallel_s": round(times.parallel_s, 3),
            "retreats": waits.retreats,
            "deadlocks": waits.deadlocks,
            "contact_s": round(self.contacts.touched_s, 2),
        }

    def fields(self, strict: Verdict) -> dict[str, Any]:
        """Return what its line says beside what every line does."""
        figures = dict(strict.together or {})
        oracle_s, score = executed_s(self.instance), None
        if oracle_s is not None:
            makespan_s = figures["makespan_s"]
            success = strict.success and makespan_s > 0.0
            score = round(schedule_score(success, makespan_s, oracle_s), 4)
        return {
            "together": {
                "expert_poses": self.expert_poses,
                "asked": self.asked,
                "orders": [
                    {
                        "asked": one.asked,
                        **one.subtask.to_dict(),
                        "poses": None if one.poses is None else one.poses.to_dict(),
                    }
                    for one in self.orders
                ],
                "messages": [
                    {
                        "robot": one.robot,
                        "text": one.text,
                        "time_s": round(one.time_s, 3),
                    }
                    for one in self.messages
                ],
                "oracle_s": oracle_s,
                "schedule_score": score,
                **figures,
            }
        }


class TeamPlayer(Player):
    """A team policy with its cameras."""

    def begin(
        self, instance: Instance, kind: str, control: LanguageControl = OWN_SENTENCE
    ) -> Rollout:
        """Begin an episode."""
        poses = isinstance(self.policy, WithExpertPoses)
        return TeamRollout(instance, kind, control=control, expert_poses=poses)
