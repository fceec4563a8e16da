"""One episode that somebody looks at: a thread of its own that sets the table and acts.

Nothing here is shared between two plays but loaded policies: a play whose policy hangs
is left behind, and the next one begins beside it.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lemma.core.errors import LemmaError
from lemma.evaluation.run.fault_isolation import check
from lemma.evaluation.run.language_controls import LanguageControl
from lemma.evaluation.run.rollout import Player, Rollout, TakenStep, roll_out
from lemma.policies.interfaces import Composite, Decision, PolicyInput
from lemma.policies.spec import ORACLE
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.suite import load_instance
from lemma.viewer.reading import ask_reader, check_plan, parse_goal
from lemma.viewer.transport import AbandonedError, Transport
from lemma.viewer.wish import OWN_WORDS, Line, Phase, Reading, Status, Wish
from lemma.viz.recording import describe_step, describe_subtask

Load = Callable[[str], Player]
"""Returns a player by the name of its policy."""


class Play:
    """An episode in the making."""

    def __init__(
        self,
        wish: Wish,
        load: Load,
        *,
        acts: bool,
        steps: bool = False,
        speed: float = 1.0,
    ) -> None:
        """Set the table in another thread, and act there if that is wanted.

        Args:
            wish: What is asked for.
            load: Loads policies.
            acts: Whether to go on and act; else the table is set, and no more.
            steps: Whether to pause after the first sub-task.
            speed: How many times real time it is played.
        """
        self.wish, self.acts, self._steps = wish, acts, steps
        self.transport = Transport(speed)
        self.instance: Instance | None = None
        self.scene: Scene | None = None
        """Of the simulation: its model may be read, its data belong to the thread."""
        self.rollout: Rollout | None = None
        self._load = load
        self._status = Status(policy=wish.policy)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def status(self) -> Status:
        """How it stands; a new object whenever that changes."""
        return self._status

    def leave(self, wait_s: float = 0.0) -> bool:
        """Abandon it.

        Args:
            wait_s: How long to wait for its end [s].

        Returns:
            Whether it has ended; a policy that hangs keeps it alive.
        """
        self.transport.abandon()
        self._thread.join(wait_s)
        return not self._thread.is_alive()

    def wait(self, seconds: float) -> bool:
        """Wait for its end, and return whether it has come."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _tell(self, phase: Phase | None = None, **changes: Any) -> None:
        if phase is not None:
            changes["phase"] = phase
        self._status = replace(self._status, **changes)

    def _run(self) -> None:
        try:
            rollout = self._set_table()
            if self.acts:
                self._act(rollout)
            else:
                self._tell(Phase.READY)
        except AbandonedError:
            pass
        except Exception as error:
            # Whatever it is, the page is there to say it.
            what = str(error) if isinstance(error, LemmaError) else repr(error)
            self._tell(Phase.BROKEN, note=what)
        finally:
            self.transport.finish()

    def _set_table(self) -> Rollout:
        wish = self.wish
        instance = load_instance(wish.task, wish.split, wish.index)
        kind, control = wish.saying, LanguageControl()
        if kind == OWN_WORDS:
            kind, control = "high_level", LanguageControl(wish.text)
            if self.acts and wish.policy == ORACLE:
                # The expert reads no sentence: it is given the goal.
                reading = parse_goal(wish.text, instance)
                self._tell(reading=reading)
                if reading.acts and reading.pairs:
                    goal = Goal.from_pairs(reading.pairs)
                    instance = replace(instance, goal=goal)
        rollout = Rollout(instance, kind, control=control)
        simulation = rollout.episode.simulation
        transport = self.transport

        def record() -> None:
            transport.record(simulation.scene.data.qpos, simulation.time_s)

        record()
        simulation.observers.append(record)
        self.instance, self.scene = instance, simulation.scene
        self.rollout = rollout
        self._tell(said=rollout.instruction)
        return rollout

    def _act(self, rollout: Rollout) -> None:
        self._tell(Phase.LOADING)
        player = self._load(self.wish.policy)
        try:
            if not self._read(rollout, player):
                return
            told = _Told(player.policy, self._decided)
            (self.transport.step if self._steps else self.transport.play)()
            heard = Player(told, player.rig)
            for _ in roll_out([rollout], heard, on_step=self._stepped):
                pass
            self._conclude(rollout)
        finally:
            if player.rig is not None:
                player.rig.close()

    def _read(self, rollout: Rollout, player: Player) -> bool:
        """Say what is understood; return whether to act on it."""
        self._tell(Phase.READING)
        reading = self._status.reading
        if reading is None and self.wish.policy == ORACLE:
            reading = Reading(rollout.instance.goal.pairs)
        if reading is None:
            given = player.given(rollout)
            reading = ask_reader(player.policy, given, rollout.instance)
        own, knows = self.wish.saying == OWN_WORDS, self.wish.policy == ORACLE
        if own:
            scene = rollout.episode.simulation.scene
            reading = check_plan(reading, scene, needed=knows)
        self._tell(reading=reading)
        if not reading.acts:
            self._tell(Phase.FAILED)
            return False
        if own and reading.pairs and not knows:
            rollout.control = LanguageControl(self.wish.text, reading.pairs)
        return True

    def _decided(self, given: PolicyInput, decision: Decision | None) -> None:
        """Say what is about to happen; None while it is being decided."""
        if decision is None:
            self._tell(Phase.DECIDING)
            return
        assert self.rollout is not None
        if decision.stops:
            self._tell(Phase.ACTING)
            return
        words = describe_subtask(decision.subtask, self.rollout.instance)
        line = Line(words, self.rollout.episode.elapsed_s)
        self._tell(Phase.ACTING, lines=(*self._status.lines, line))

    def _stepped(self, rollout: Rollout, step: TakenStep) -> None:
        told = describe_step(step, rollout.instance)
        done = self._status.lines
        if done and done[-1].end_s is None:
            done = done[:-1]
        end_s = told.start_s + told.duration_s
        line = Line(
            told.words, told.start_s, end_s, told.outcome, told.explanation, told.ok
        )
        self._tell(lines=(*done, line))
        self.transport.mark(rollout.episode.elapsed_s)

    def _conclude(self, rollout: Rollout) -> None:
        took = f"{rollout.episode.elapsed_s:.1f} s"
        if rollout.fault is not None:
            self._tell(
                Phase.BROKEN,
                note=f"The policy failed: {rollout.fault.explanation}",
                lines=tuple(line for line in self._status.lines if line.end_s),
            )
            return
        reading, own = self._status.reading, self.wish.saying == OWN_WORDS
        if own and (reading is None or reading.pairs is None):
            self._tell(Phase.ENDED, note=f"after {took}: nobody can judge it")
            return
        asked = rollout.asked_holds
        verdict = rollout.verdict()
        holds = verdict.success if asked is None else asked
        what = (verdict.failure or "goal_not_reached").replace("_", " ")
        note = f"after {took}" if holds else f"after {took}: {what}"
        if holds and rollout.protective_stop is not None:
            note += ", though a robot was asked for what it cannot do"
        self._tell(Phase.SOLVED if holds else Phase.FAILED, note=note)


@dataclass(frozen=True)
class _Told(Composite):
    """A policy that is heard: what it decides is told before it is done."""

    policy: Any
    tell: Callable[[PolicyInput, Decision | None], None]

    @property
    def parts(self) -> tuple[object, ...]:
        return (self.policy,)

    def act(self, inputs: Sequence[PolicyInput]) -> Any:
        self.tell(inputs[0], None)
        answers = self.policy.act(inputs)
        if isinstance(answers, list) and answers:
            # What makes no sense becomes a fault elsewhere.
            decision = check(answers[0], inputs[0])
            if isinstance(decision, Decision):
                self.tell(inputs[0], decision)
        return answers
