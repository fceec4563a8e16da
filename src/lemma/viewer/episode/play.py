"""One episode on the page; its own thread sets the table and acts.

The thread goes through the phases of ``Phase`` to an end. Other threads request changes
in three ways, which the simulation carries out between two ticks: the transport lets it
continue or wait, :meth:`Play.nudge` moves an object, and :meth:`Play.take_over`
interrupts a sub-task, so that a visitor leads.

Two plays share only loaded policies. If a policy hangs, its play is abandoned, and the
next one runs in another thread.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal

from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.core.poses import Pose2
from lemma.dataset.teleoperation import Teleoperation, nudge
from lemma.evaluation.protocol.language_controls import LanguageControl
from lemma.evaluation.run.control import ControlPlayer
from lemma.evaluation.run.rollout import Player, Rollout, StepRecord, roll_out
from lemma.policies.control.interfaces import Actions
from lemma.policies.interfaces import Decision, Insight
from lemma.scene.objects.entity import entity_named
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.viewer.episode.reading import (
    NOTHING,
    SILENT,
    Explanation,
    ObservedPolicy,
    Paths,
    ask_reader,
    check_plan,
    explain,
    parse_goal,
    weights_words,
)
from lemma.viewer.episode.status import (
    KNOWING,
    OWN_WORDS,
    EpisodeRequest,
    Moved,
    Phase,
    Reading,
    Status,
    StatusBoard,
)
from lemma.viewer.episode.teleoperator import EpisodeLog, Teleoperator
from lemma.viewer.episode.transport import (
    AbandonedError,
    InterruptedEpisodeError,
    Transport,
)
from lemma.viz.recording import FRAME_S, Line, describe_step, describe_subtask
from lemma.viz.team_watch import TeamWatch


class Play:
    """An episode of the page; safe to use from any thread."""

    def __init__(
        self,
        request: EpisodeRequest,
        load: Callable[[str], Player],
        *,
        acts: bool,
        steps: bool = False,
        speed: float = 1.0,
    ) -> None:
        """Start the thread.

        Args:
            request: Table, sentence and policy.
            load: Function that loads a policy by its name.
            acts: Whether to act; otherwise only the table is set.
            steps: Whether to pause after the first sub-task.
            speed: Speed of playback, as a multiple of real time.
        """
        self.request, self.acts, self._steps = request, acts, steps
        self.transport = Transport(speed)
        self.instance: Instance | None = None
        self.scene: Scene | None = None
        """The simulation's scene; other threads may read its model, not its data."""
        self.rollout: Rollout | None = None
        self.watch: TeamWatch | None = None
        """The simulation's instance."""
        self.explanations: tuple[Explanation, ...] = ()
        """Reasons and path of each sub-task, oldest first."""
        self.teleoperator: Teleoperator | None = None
        """The visitor's commands, of the present or last takeover; None without one."""
        self._log = EpisodeLog()
        self._controls = False
        """Whether the policy sends motor commands, so that nobody can take over."""
        self._taking = threading.Lock()
        self._leader: Literal["policy", "asked", "visitor"] = "policy"
        """Source of decisions. After a request to take over, the policy leads until the
        simulation next checks."""
        self.led_first = ""
        """Name of the robot that was acting when a visitor took over."""
        self._goal_is_known = True
        self.moved: Moved | None = None
        """Result of the latest :meth:`nudge` during the episode."""
        self._load = load
        self._board = StatusBoard()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def status(self) -> Status:
        """The status; a new object whenever it changes."""
        return self._board.status

    def leave(self, wait_s: float = 0.0) -> bool:
        """Abandon the episode.

        Args:
            wait_s: Longest time to wait for the end of its thread [s].

        Returns:
            Whether the thread has ended; it runs while a policy hangs.
        """
        self.transport.abandon()
        return self.wait(wait_s)

    def wait(self, seconds: float) -> bool:
        """Return whether its thread ends within a time [s]."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    @property
    def is_led(self) -> bool:
        """Whether a visitor leads the robots."""
        hand = self.teleoperator
        leads = self._leader == "visitor"
        return leads and hand is not None and not hand.is_done

    @property
    def _goes_on(self) -> bool:
        going = Phase.DECIDING, Phase.ACTING, Phase.LED
        return self.status.phase in going and not self.transport.over

    @property
    def can_be_taken_over(self) -> bool:
        """Whether a visitor may take over now."""
        return self._goes_on and self._leader == "policy" and not self._controls

    @property
    def can_hand_back(self) -> bool:
        """Whether a visitor leads and there is a policy to continue."""
        return self.is_led and not self._controls

    @property
    def was_led(self) -> bool:
        """Whether a visitor did something that can be saved."""
        return self._log.by_hand

    def take_over(self) -> None:
        """Let a visitor lead from now on; interrupt the running sub-task.

        Raises:
            InvalidConfigError: No episode runs, or a visitor or motor commands lead.
        """
        if self._goes_on and self._controls:
            raise InvalidConfigError(
                "This policy sends motor commands, so nobody can take over. Choose the "
                "policy 'by hand' to lead from the beginning."
            )
        with self._taking:
            # If two visitors press at the same time, one of them leads.
            if not self.can_be_taken_over:
                raise InvalidConfigError(
                    "You can take over while an episode runs and no visitor leads."
                )
            self._leader, self.teleoperator = "asked", Teleoperator()
            self.transport.interrupt()

    def hand_back(self) -> None:
        """Let the policy continue from the present state."""
        if self.teleoperator is not None and self.can_hand_back:
            self.teleoperator.is_done = True
            self.transport.play()

    def kept(self) -> Teleoperation:
        """Return the log of the policy's and the visitor's actions so far.

        Raises:
            InvalidConfigError: No visitor acted, or the policy sends motor commands.
        """
        if self._controls and self.teleoperator is None:
            raise InvalidConfigError("Motor commands of policies are not kept.")
        # Keep visitors from changing the state between reading it and the log.
        with self.transport.changing:
            latest = self.transport.latest
            if self.instance is None or latest is None or not self._log.by_hand:
                raise InvalidConfigError("Nothing was done by hand yet.")
            return self._log.kept(self.instance, self.status.said, latest)

    def nudge(self, name: str, pose: Pose2) -> None:
        """Move an object while the episode runs, and pause.

        The result is in :attr:`moved`.

        Args:
            name: Name of the object.
            pose: New pose of the object in the world's frame.
        """
        rollout = self.rollout
        assert rollout is not None

        def change() -> None:
            try:
                nudge(rollout.episode.simulation, name, pose)
            except LemmaError as error:
                self.moved = Moved(str(error))
                return
            self.moved = Moved()
            words = f"You moved the {entity_named(name).phrase}"
            now_s = rollout.episode.simulation.time_s
            self._log.move(name, pose, now_s)
            self._board.insert(Line(words, now_s, now_s, "by hand"))

        self.transport.change(change)

    def _run(self) -> None:
        try:
            rollout = self._set_table()
            if self.acts:
                self._act(rollout)
            else:
                self._board.tell(Phase.READY)
        except AbandonedError:
            pass
        except Exception as error:
            # The page reports any error and continues.
            what = str(error) if isinstance(error, LemmaError) else repr(error)
            self._board.tell(Phase.BROKEN, note=what)
        finally:
            self._leader = "policy"
            self.transport.finish()

    def _set_table(self) -> Rollout:
        request = self.request
        instance = request.instance()
        kind, control = request.saying, LanguageControl()
        if kind == OWN_WORDS:
            kind, control = "high_level", LanguageControl(request.text)
            # For a sentence of the benchmark, the goal is known with any policy.
            reading = parse_goal(request.text, instance)
            self._goal_is_known = reading.acts
            if reading.acts and reading.pairs:
                instance = replace(instance, goal=Goal.from_pairs(reading.pairs))
            if self.acts and request.policy in KNOWING:
                self._board.tell(reading=reading)
        rollout = Rollout(instance, kind, control=control)
        self._watch(rollout)
        self._board.tell(said=rollout.instruction)
        return rollout

    def _watch(self, rollout: Rollout) -> None:
        """Record an episode from its first state on."""
        simulation, transport = rollout.episode.simulation, self.transport

        def record() -> None:
            transport.record(simulation.scene.data.qpos, simulation.time_s)

        record()
        self.watch = TeamWatch(simulation)
        simulation.observers.append(record)
        self.instance, self.scene = rollout.instance, simulation.scene
        self.rollout = rollout

    def _act(self, rollout: Rollout) -> None:
        self._board.tell(Phase.LOADING)
        player = self._load(self.request.policy)
        self._board.tell(trained=weights_words(self.request.policy))
        controls = self._controls = isinstance(player, ControlPlayer)
        if controls:
            # Set the same table in the environment that this policy needs.
            rollout = player.begin(rollout.instance, rollout.kind, rollout.control)
            self._watch(rollout)
        if isinstance(player.policy, Teleoperator):
            self.teleoperator, self._leader = player.policy, "visitor"
            self._log.lead(self.teleoperator, rollout.episode.elapsed_s)
        try:
            if not self._read(rollout, player):
                return
            policy = ObservedPolicy(player.policy, self._decided)
            (self.transport.step if self._steps else self.transport.play)()
            observed = ControlPlayer(policy) if controls else Player(policy, player.rig)
            while not (rollout.episode.is_over or rollout.fault):
                try:
                    for _ in roll_out([rollout], observed, on_step=self._stepped):
                        pass
                except InterruptedEpisodeError:
                    if not rollout.episode.is_over:
                        self._lead(rollout)
                    # The episode is over, so it is judged.
                    rollout.episode.conclude()
            self._board.conclude(rollout, known=self._goal_is_known)
        finally:
            if player.rig is not None:
                player.rig.close()

    def _lead(self, rollout: Rollout) -> None:
        """Let a visitor lead until they hand back or the episode is over."""
        episode, teleoperator = rollout.episode, self.teleoperator
        assert teleoperator is not None
        now_s = episode.simulation.time_s
        acted = (each.robot for each in reversed(self.explanations) if each.robot)
        self.led_first = next(acted, "")
        self._log.end(until_s=now_s)
        self._log.lead(teleoperator, now_s)
        self.explanations = (*self.explanations, Explanation(now_s))
        self._board.end(now_s, "taken over")
        self._board.begin(Phase.LED, "You lead the robots", now_s)
        self._leader = "visitor"
        try:
            teleoperator.take_over(episode)
        finally:
            self._leader = "policy"
        end_s = episode.elapsed_s
        self._board.end(end_s, "by hand")
        self.transport.mark(end_s)

    def _read(self, rollout: Rollout, player: Player) -> bool:
        """Report the reading of the sentence; return whether to act on it."""
        self._board.tell(Phase.READING)
        reading, knows = self.status.reading, self.request.policy in KNOWING
        if reading is None and knows:
            reading = Reading(rollout.instance.goal.pairs)
        elif reading is None and isinstance(player, ControlPlayer):
            reading = SILENT
        elif reading is None:
            policy_input = player.policy_input(rollout)
            reading = ask_reader(player.policy, policy_input, rollout.instance)
        if self.request.saying == OWN_WORDS:
            scene = rollout.episode.simulation.scene
            reading = check_plan(reading, scene, needed=knows)
        self._board.tell(reading=reading)
        if not reading.acts:
            self._board.tell(Phase.FAILED)
            return False
        if reading.pairs and not self._goal_is_known:
            rollout.control = LanguageControl(self.request.text, reading.pairs)
        return True

    def _decided(
        self, decision: Decision | Actions | None, insight: Insight | None
    ) -> None:
        """Report a decision before its execution; None while the policy decides."""
        if decision is None:
            self._board.tell(Phase.DECIDING)
            return
        assert self.rollout is not None
        if isinstance(decision, Actions):
            if self.status.phase is not Phase.ACTING:
                self._board.tell(Phase.ACTING)
            return
        episode = self.rollout.episode
        now_s = episode.elapsed_s
        self._log.begin(decision, now_s)
        explanation = explain(episode.simulation, now_s, decision, insight)
        self.explanations = (*self.explanations, explanation)
        if decision.stops:
            self._board.tell(Phase.ACTING)
        else:
            words = describe_subtask(decision.subtask, self.rollout.instance)
            self._board.begin(Phase.ACTING, words, now_s, decision.subtask)

    def reached(self) -> Mapping[str, Any]:
        """Return the stages of the episode, as in lines of results.

        They are empty before the first action, and if the sentence has another goal.
        """
        rollout = self.rollout
        if rollout is None or not (self.acts and self._goal_is_known):
            return {}
        return rollout.episode.stages.record()

    def paths(self) -> Paths:
        """Return the paths of hands in the sub-tasks at the cursor, by robot."""
        why = self.explanation()
        return ((why.robot, why.waypoints),) if why.waypoints else ()

    def explanation(self) -> Explanation:
        """Return reasons and path of the sub-task at the cursor."""
        now_s = self.transport.cursor_s + FRAME_S
        before = (each for each in reversed(self.explanations) if each.time_s <= now_s)
        return next(before, NOTHING)

    def _stepped(self, rollout: Rollout, step: StepRecord) -> None:
        self._log.end()
        assert self.watch is not None
        now_s = rollout.episode.elapsed_s
        line = describe_step(step, rollout.instance).watched(self.watch, now_s)
        self._board.replace_running(line)
        self.transport.mark(now_s)
