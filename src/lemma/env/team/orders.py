"""Orders to the free robots of a team, and prediction of their effects.

The expert, environments and evaluation use this module. An order is grounded in the
state expected after all orders in progress. If an earlier order involves the same
objects, the robot waits for the effect of that order: the object lies at its place, and
the arm that moved it retreats. Sectors of busy arms are reserved by
:mod:`lemma.motion.reservations`.
"""

import math
from collections.abc import Collection
from dataclasses import replace

from lemma.core.arguments import known
from lemma.core.errors import InvalidActionError
from lemma.env.episode import LEAST_STEP_S, Episode, ExecutedSubTask
from lemma.env.team.records import Done, Order, TeamState, works_on
from lemma.motion.leaving import ROOM_M
from lemma.motion.outcome import SkillResult
from lemma.planning.grounding import (
    GeometricGrounder,
    GroundedOption,
    at_poses,
    ground_or_refuse,
    is_as_predicted,
)
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.scene.build import TIME_STEP_S
from lemma.scene.objects.entity import STICK
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask
from lemma.tasks.teams.dependencies import predecessors

LOOK_S = 0.05
"""Time between two checks for effects [s]."""
PAUSE_S = 1.0
"""Longest time between two decisions where the goal is about times and a robot is free
[s]."""


class Team:
    """The robots of an episode, each free or with an order.

    A robot whose order was refused or ended at once becomes free after ``refusal_s`` or
    ``least_s``, so that every episode ends.
    """

    def __init__(
        self,
        episode: Episode,
        grounder: GeometricGrounder | None = None,
        *,
        least_s: float = LEAST_STEP_S,
        refusal_s: float = LEAST_STEP_S,
    ) -> None:
        """Take over the robots of an episode, none of which is busy.

        Args:
            episode: The episode in progress.
            grounder: Grounder of the same scene; a new one if None.
            least_s: Minimum simulated time of an order [s].
            refusal_s: The same, for an order that its robot cannot carry out [s].
        """
        self.episode = episode
        self.grounder = grounder or GeometricGrounder(episode.instance.scene)
        self.orders: dict[str, Order] = {}
        """Orders by robot, including those that wait for an effect."""
        self._rests: dict[str, float] = {}
        self._effects: dict[str, float] = {}
        self._least_s, self._refusal_s = least_s, refusal_s

    @property
    def free(self) -> tuple[str, ...]:
        """Robots that can be given an order, in the order of the team."""
        now = self.episode.simulation.time_s + 0.5 * TIME_STEP_S
        return tuple(
            name
            for name in self.episode.simulation.arms
            if not self.works_on(name) and self._rests.get(name, 0.0) <= now
        )

    def works_on(self, robot: str) -> str:
        """Return the robot with whose order a robot is busy; see :func:`works_on`."""
        return works_on(robot, self.orders)

    @property
    def waits_for(self) -> dict[str, tuple[str, ...]]:
        """Robots that each waiting robot waits for: for an effect, or for a sector."""
        waits = self.episode.simulation.reservations.waits
        found = {}
        for name, order in self.orders.items():
            held = waits[name].holders if name in waits else ()
            if order.waits_for or held:
                found[name] = tuple(sorted(order.waits_for)) or held
        return found

    def observe(self) -> SymbolicState:
        """Return the present symbolic state."""
        return SymbolicState.observe(self.episode.simulation.scene)

    def settled(self, now: SymbolicState) -> set[str]:
        """Return the robots whose orders have had their effect.

        Args:
            now: The present state.
        """
        simulation, found = self.episode.simulation, set[str]()
        for robot, order in self.orders.items():
            if order.waits_for or not simulation.reservations.is_going_home(robot):
                continue
            if order.own_poses or order.option is None or order.before is None:
                # A retreating robot also goes home, with its load.
                if robot not in simulation.held():
                    found.add(robot)
            elif is_as_predicted(now, order.option, order.before):
                found.add(robot)
        for robot in found:
            self._effects.setdefault(robot, simulation.time_s)
        return found

    def expected(
        self, now: SymbolicState, settled: Collection[str] = ()
    ) -> SymbolicState:
        """Return the state expected after all orders in progress.

        Args:
            now: The present state.
            settled: Robots whose effects ``now`` already contains.
        """
        for robot, order in self.orders.items():
            if robot in settled or order.option is None or order.before is None:
                continue
            for name, pose in order.option.after.poses.items():
                if pose != order.before.poses[name]:
                    after = order.option.after
                    support = after.supports.get(name, TABLE)
                    now = now.moved(
                        *(name, pose, support, after.labels[name]),
                        after.seconds.get(name),
                    )
        return now

    def begin(self, option: GroundedOption, before: SymbolicState) -> None:
        """Let a free robot begin an option that was grounded in a state.

        Raises:
            InvalidActionError: The robot is busy.
        """
        robot, now_s = option.grounded.robot, self.episode.simulation.time_s
        self.episode.begin(option.grounded, self._leaving(option.grounded, option))
        self.orders[robot] = Order(
            *(option.subtask, option.grounded, now_s, option, before),
            partner=option.partner,
        )

    def order(
        self, subtask: SubTask | None, grounded: GroundedSubTask | None = None
    ) -> Done | None:
        """Give an order to a free robot.

        Args:
            subtask: Symbolic sub-task; None if only poses are known.
            grounded: Sub-task with the policy's own poses; poses of the expert if None.

        Returns:
            None; or the result, if the order cannot be carried out.

        Raises:
            InvalidActionError: The robot is not free, or both arguments are None.
            ResetNeededError: The episode is over.
            UnknownNameError: There is no such robot in this scene.
        """
        commanded = grounded or subtask
        if commanded is None:
            raise InvalidActionError("There is neither a sub-task nor poses to order.")
        robot = commanded.robot
        self._check_free(robot)
        now = self.observe()
        settled = self.settled(now)
        expected = self.expected(now, settled)
        found = self._ground(subtask, expected)
        start_s = self.episode.simulation.time_s
        if isinstance(found, SkillResult) and grounded is None:
            return self._end(Done(robot, subtask, None, found, start_s))
        option = found if isinstance(found, GroundedOption) else None
        if grounded is not None and option is not None:
            option = at_poses(option, grounded)
        poses = grounded or (option.grounded if option else None)
        assert poses is not None
        partner = self.episode.simulation.partner_of(poses)
        busy = self.works_on(partner)
        needs = frozenset(self._needs(subtask) - settled) | ({busy} if busy else set())
        self.orders[robot] = Order(
            *(subtask, poses, start_s, option, expected, needs, grounded is not None),
            partner,
        )
        if not needs:
            self.episode.begin(poses, self._leaving(poses, option))
        return None

    def _leaving(
        self, grounded: GroundedSubTask, option: GroundedOption | None
    ) -> dict[str, str]:
        """Return the objects at a robot's place, and the robots that take them away."""
        if option is None or option.subtask.primitive is not Primitive.MOVE:
            return {}
        scene, found = self.episode.simulation.scene, dict[str, str]()
        for robot, order in self.orders.items():
            other = order.subtask
            if robot == grounded.robot or other is None or other.pick in scene.fallen:
                continue
            moves = other.primitive is Primitive.MOVE and other.pick != STICK
            if moves and other.pick not in (option.subtask.pick, option.subtask.place):
                near_m = scene.pose2(other.pick).distance(grounded.place)
                found |= {other.pick: robot} if near_m < ROOM_M else {}
        return found

    def refuse(self, subtask: SubTask, result: SkillResult) -> Done:
        """Refuse a free robot's order, which has no poses.

        Raises:
            LemmaError: As :meth:`order`.
        """
        self._check_free(subtask.robot)
        start_s = self.episode.simulation.time_s
        return self._end(Done(subtask.robot, subtask, None, result, start_s))

    def _check_free(self, robot: str) -> None:
        self.episode.check_running()
        known("robot in this scene", robot, self.episode.simulation.arms)
        if robot not in self.free:
            raise InvalidActionError(
                f"{robot} is busy. Orders are for free robots: "
                f"{', '.join(self.free) or 'there is none now'}."
            )

    def _ground(
        self, subtask: SubTask | None, state: SymbolicState
    ) -> GroundedOption | SkillResult | None:
        if subtask is None:
            return None
        return ground_or_refuse(subtask, state, self.grounder)

    def _needs(self, subtask: SubTask | None) -> set[str]:
        """Return the robots whose orders involve the same objects."""
        if subtask is None:
            return set()
        regions = tuple(self.episode.instance.scene.regions)
        return {
            robot
            for robot, order in self.orders.items()
            if order.subtask is not None
            and predecessors((order.subtask, subtask), regions)[1]
        }

    def advance(self) -> tuple[Done, ...]:
        """Let time pass until the next decision.

        A decision is due when a robot becomes free, and when an order has its effect
        while a robot is free. If no robot has an order, it is due after ``least_s``.
        While a robot is free, it is due after :data:`PAUSE_S` where the goal's rule is
        about times.

        Returns:
            The orders that ended meanwhile.
        """
        episode, done = self.episode, list[Done]()
        free, settled = set(self.free), self.settled(self.observe())
        end_s = math.inf
        if not self.orders and not self._resting():
            end_s = episode.simulation.time_s + self._least_s
        elif free and not episode.instance.goal.in_turns:
            end_s = episode.simulation.time_s + PAUSE_S
        while not episode.is_over:
            done += self._begin_ready()
            done += self._pass_a_moment(end_s, looks=bool(free))
            effects = self.settled(self.observe()) - settled if free else set()
            if set(self.free) - free or effects or self._is_past(end_s):
                break
        if episode.is_over:
            self.orders.clear()
        # Begin waiting orders now: they must not wait for later orders of freed robots.
        return (*done, *self._begin_ready())

    def _pass_a_moment(self, end_s: float, *, looks: bool) -> list[Done]:
        """Let time pass to the next moment at which an order may end or take effect."""
        episode = self.episode
        until_s = min([end_s, *self._resting().values()])
        if looks or any(order.waits_for for order in self.orders.values()):
            until_s = min(until_s, episode.simulation.time_s + LOOK_S)
        if not episode.simulation.busy:
            episode.rest_until(until_s)
            return []
        return self.pass_time(until_s)

    def pass_time(self, until_s: float = math.inf) -> list[Done]:
        """Let time pass until an order ends or a time [s]; return the ended orders."""
        return [self._ended(one) for one in self.episode.advance(until_s)]

    def _ended(self, one: ExecutedSubTask) -> Done:
        order = self.orders.pop(one.grounded.robot)
        if order.partner:
            self._rests[order.partner] = one.start_s + self._least_s
        return self._end(
            Done(
                one.grounded.robot,
                order.subtask,
                one.grounded,
                one.result,
                one.start_s,
                self._effects.pop(one.grounded.robot, None),
                order.partner,
            )
        )

    def _end(self, done: Done) -> Done:
        least_s = self._refusal_s if done.result.refused else self._least_s
        self._rests[done.robot] = done.start_s + least_s
        return done

    def _resting(self) -> dict[str, float]:
        now = self.episode.simulation.time_s + 0.5 * TIME_STEP_S
        return {name: end for name, end in self._rests.items() if end > now}

    def _is_past(self, end_s: float) -> bool:
        return self.episode.simulation.time_s > end_s - 0.5 * TIME_STEP_S

    def _begin_ready(self) -> list[Done]:
        """Begin the orders whose awaited effects have occurred."""
        waiting = [name for name, order in self.orders.items() if order.waits_for]
        if not waiting:
            return []
        done, now = [], self.observe()
        settled = self.settled(now)
        for robot in waiting:
            order = self.orders[robot]
            left = order.waits_for & (self.orders.keys() - settled)
            # A partner must have ended, and not only had its effect.
            busy = self.works_on(order.partner)
            left |= {busy} if busy else set()
            if left:
                self.orders[robot] = replace(order, waits_for=left)
                continue
            # Orders that still wait were given later, or involve other objects.
            begun = settled.union(n for n, o in self.orders.items() if o.waits_for)
            refused = self._begin_waiting(order, self.expected(now, begun))
            done += [refused] if refused else []
        return done

    def _begin_waiting(self, order: Order, state: SymbolicState) -> Done | None:
        """Begin an order that has waited, grounded in the present state."""
        found = self._ground(order.subtask, state)
        robot, now_s = order.grounded.robot, self.episode.simulation.time_s
        if not order.own_poses and isinstance(found, SkillResult):
            del self.orders[robot]
            return self._end(Done(robot, order.subtask, None, found, now_s))
        if not order.own_poses and isinstance(found, GroundedOption):
            order = replace(order, option=found, grounded=found.grounded, before=state)
            order = replace(order, partner=found.partner)
        self.episode.begin(order.grounded, self._leaving(order.grounded, order.option))
        self.orders[robot] = replace(order, waits_for=frozenset())
        return None

    def stop(self) -> tuple[Done, ...]:
        """Let busy robots finish, and end the episode.

        Returns:
            The orders that ended meanwhile; orders that have not begun are dropped.
        """
        done = list[Done]()
        while self.episode.simulation.busy:
            done += self.pass_time()
        self.orders.clear()
        if not self.episode.is_over:
            self.episode.stop()
        return tuple(done)

    def state(self) -> TeamState:
        """Return the state of the team beside that of the episode."""
        return TeamState(dict(self.orders), dict(self._rests), dict(self._effects))

    def restore(self, state: TeamState) -> None:
        """Restore what :meth:`state` returned, after restoring the episode."""
        self.orders, self._rests = dict(state.orders), dict(state.rests)
        self._effects = dict(state.effects)
