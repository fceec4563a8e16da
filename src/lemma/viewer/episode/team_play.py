"""One episode on the page in which all robots act at once.

The expert leads the robots, and visitors may give orders. An order comes before the
expert's plan, which is computed again with it. A robot that a visitor has taken follows
only visitors' orders, while the expert leads the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.env.team.orders import LOOK_S, Team
from lemma.env.team.records import Done, Order
from lemma.env.team.valid_orders import valid_options
from lemma.evaluation.run.rollout import Player, Rollout
from lemma.expert.together import TeamWork
from lemma.motion.outcome import SkillResult
from lemma.planning.grounding import ground_or_refuse
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import Decision
from lemma.tasks.subtask import Primitive, SubTask
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.reading import Explanation, Paths, explain
from lemma.viewer.episode.status import Phase
from lemma.viz.recording import FRAME_S, describe_subtask, line_of

_MOST_PLANS = 4
_NOT_ORDERED = Primitive.REACH, Primitive.LIFT
"""These primitives leave an arm over the table, where it blocks the others."""


@dataclass(frozen=True, slots=True)
class Options:
    """Possible orders of a robot."""

    robot: str
    subtasks: tuple[SubTask, ...]


class TeamPlay(Play):
    """An episode in which all robots act at once; safe to use from any thread."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Start the thread, with the arguments of :class:`Play`."""
        self._visitor_led = frozenset[str]()
        self._ordered: tuple[SubTask, ...] = ()
        """Orders of visitors that have not begun."""
        self._plans_anew = False
        self._team: Team | None = None
        self._todo: tuple[SubTask, ...] = ()
        self.options: Options | None = None
        """The latest answer to :meth:`look_for_options`."""
        super().__init__(*arguments, **options)

    @property
    def can_be_taken_over(self) -> bool:
        """Whether a visitor may lead hands: never, visitors give orders instead."""
        return False

    @property
    def takes_orders(self) -> bool:
        """Whether visitors may give orders now."""
        return self._goes_on and self._team is not None

    @property
    def visitor_led(self) -> frozenset[str]:
        """Names of the robots that visitors lead."""
        return self._visitor_led

    @property
    def todo(self) -> tuple[SubTask, ...]:
        """Planned sub-tasks that have not begun."""
        return self._todo

    def take(self, robot: str) -> None:
        """Let a robot follow only visitors' orders; it first finishes its sub-task.

        Args:
            robot: Its name.
        """
        self._visitor_led |= {robot}

    def give_back(self, robot: str) -> None:
        """Let the expert lead a robot again.

        Args:
            robot: Its name.
        """
        self._visitor_led -= {robot}
        self._plans_anew = True

    def order(self, subtask: SubTask) -> None:
        """Order a sub-task; it begins once its robot is free and can do it.

        Args:
            subtask: One of its :attr:`options`.
        """

        def take_note() -> None:
            self._ordered = (*self._ordered, subtask)
            self._plans_anew = True

        self.transport.ask(take_note)

    def nudge(self, name: str, pose: Pose2) -> None:
        """Move an object while the episode runs, and plan again.

        Args:
            name: Name of the object.
            pose: New pose of the object in the world's frame.
        """
        super().nudge(name, pose)
        self._plans_anew = True

    def look_for_options(self, robot: str) -> None:
        """Compute the possible orders of a robot; the answer is in :attr:`options`.

        Args:
            robot: Its name.
        """

        def find() -> None:
            team = self._team
            if team is None:
                return
            state, _ = self._foresee(team)
            ends = (*state.poses, *state.spec.regions)
            found = (
                option.subtask
                for option in valid_options(robot, state, team.grounder)
                if option.subtask.primitive not in _NOT_ORDERED
            )
            # Sort: the expert's next order first, then places, then cubes.
            places = {*ends} - {*team.episode.simulation.scene.movable_names}
            first = self._todo
            order = sorted(found, key=lambda s: (s not in first, s.place not in places))
            self.options = Options(robot, tuple(order))

        self.transport.ask(find)

    def explanation(self) -> Explanation:
        """Return an empty explanation: the expert reports no reasons."""
        return Explanation(0.0)

    def paths(self) -> Paths:
        """Return the paths of hands in the sub-tasks at the cursor, by robot."""
        now_s = self.transport.cursor_s + FRAME_S
        running = {
            (line.subtask.robot, line.start_s)
            for line in self.status.lines
            if line.subtask is not None
            and line.start_s <= now_s
            and (line.end_s is None or now_s <= line.end_s)
        }
        return tuple(
            (each.robot, each.waypoints)
            for each in self.explanations
            if (each.robot, each.time_s) in running and each.waypoints
        )

    def _act(self, rollout: Rollout) -> None:
        if not self._read(rollout, Player(None)):
            return
        (self.transport.step if self._steps else self.transport.play)()
        self._team = Team(rollout.episode)
        self._board.tell(Phase.ACTING)
        self._lead_team(rollout.episode, self._team)
        self._todo = ()
        self._board.conclude(rollout, known=self._goal_is_known)

    def _lead_team(self, episode: Episode, team: Team) -> None:
        """Let the robots work until the goal holds or no plan and order is left."""
        simulation, work, plans = episode.simulation, self._plan(team), 1
        while not episode.is_over:
            if self._plans_anew:
                work = self._plan(team)
            before = dict(team.orders)
            work.begin_ready(self._may_begin)
            self._todo = work.todo
            self._tell_begun(episode, team.orders, before)
            now_s = simulation.time_s
            if team.orders:
                for done in work.pass_time(now_s + LOOK_S):
                    self._tell_ended(episode, done)
            elif episode.instance.goal.progress(simulation.scene) == 1.0:
                break
            elif self._visitor_led:
                # Visitors may still act.
                work = self._plan(team) if work.failed else work
                episode.rest_until(now_s + LOOK_S)
            elif plans < _MOST_PLANS:
                work, plans = self._plan(team), plans + 1
                if not work.todo:
                    break
            else:
                break
        if not episode.is_over:
            episode.stop()

    def _may_begin(self, subtask: SubTask) -> bool:
        return subtask.robot not in self._visitor_led or subtask in self._ordered

    def _foresee(self, team: Team) -> tuple[SymbolicState, tuple[SubTask, ...]]:
        """Return the state after all running and ordered sub-tasks, and the orders."""
        now = team.observe()
        state, kept = team.expected(now, team.settled(now)), []
        for subtask in self._ordered:
            option = ground_or_refuse(subtask, state, team.grounder)
            if not isinstance(option, SkillResult):
                kept.append(subtask)
                state = option.after
        return state, tuple(kept)

    def _plan(self, team: Team) -> TeamWork:
        """Return the work to do: first visitors' orders, then the expert's plan."""
        self._plans_anew = False
        state, kept = self._foresee(team)
        instance, now_s = team.episode.instance, team.episode.simulation.time_s
        for subtask in self._ordered:
            if subtask not in kept:
                refused = ground_or_refuse(subtask, state, team.grounder)
                if isinstance(refused, SkillResult):
                    words = describe_subtask(subtask, instance)
                    self._board.insert(line_of(words, now_s, refused))
        self._ordered = kept
        plan = find_plan(state, instance.goal, team.grounder)
        steps: Sequence[SubTask] = () if plan is None else plan.subtasks
        return TeamWork(team, (*kept, *steps), patient=True)

    def _tell_begun(
        self, episode: Episode, orders: dict[str, Order], before: dict[str, Order]
    ) -> None:
        """Report sub-tasks that have just begun."""
        for robot, order in orders.items():
            if order is before.get(robot) or order.subtask is None:
                continue
            subtask, now_s = order.subtask, order.start_s
            self._ordered = tuple(one for one in self._ordered if one != subtask)
            decision = Decision(subtask, order.grounded)
            why = explain(episode.simulation, now_s, decision, None)
            self.explanations = (*self.explanations, why)
            words = describe_subtask(subtask, episode.instance)
            self._board.begin(Phase.ACTING, words, now_s, subtask)

    def _tell_ended(self, episode: Episode, done: Done) -> None:
        """Report a sub-task that has just ended."""
        assert done.subtask is not None
        assert self.watch is not None
        words = describe_subtask(done.subtask, episode.instance)
        line = line_of(words, done.start_s, done.result, done.subtask)
        now_s = episode.simulation.time_s
        self._board.replace_robots(line.watched(self.watch, now_s))
        self.transport.mark(now_s)
