"""Plays without a page: what is done, understood and said, and that nothing breaks."""

import gc
import threading
import time
import weakref
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from looked_at import (
    EVIL,
    SAID,
    STACK,
    Raises,
    Reads,
    StandsStill,
    own,
    player_of,
    reading_of,
    rollout_of,
    session_of,
    until,
    until_phase,
)

from lemma.core.errors import UnknownNameError
from lemma.core.poses import Pose
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.interfaces import Composite, Decision, PolicyInput
from lemma.policies.spec import PolicySpec
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.tasks.language.template import KINDS
from lemma.tasks.suite import SUITE, TASKS, load_instance
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.reading import SILENT, ask_reader, check_plan, weights_words
from lemma.viewer.episode.status import EpisodeRequest, Phase, Reading, say_goal
from lemma.viewer.words import reached_html
from lemma.viz.recording import judged, reached_words

INSTANCE = load_instance("stack", "test", 0)
PRESENT = next(o.color for o in INSTANCE.scene.objects if o.kind == "cube")
ABSENT = next(
    c for c in BENCHMARK_COLORS if f"{c}_cube" not in INSTANCE.scene.object_names
)


def played(request: EpisodeRequest, **policies: object) -> Play:
    play = Play(request, player_of(**policies), acts=True)
    until(lambda: play.wait(0.0), play)
    return play


@pytest.fixture(scope="module")
def solved() -> Play:
    return played(STACK)


def test_expert_solves_and_says_so(solved: Play) -> None:
    status = solved.status
    assert status.phase is Phase.SOLVED
    assert [line.outcome for line in status.lines] == ["success", "success"]
    assert all(line.ok and line.end_s for line in status.lines)
    assert status.reading is not None
    assert status.reading.pairs == INSTANCE.goal.pairs


def test_stages_and_verdicts_are_those_of_the_line(solved: Play) -> None:
    stages = solved.reached()
    assert stages == rollout_of(solved).verdict().stages
    assert {*judged(stages).values()} == {"yes"}
    assert reached_words(stages).startswith("100% of the stages; furthest: placed")
    told = reached_html(stages, over=True)
    assert told.count("yes") == 3
    assert "verdicts" not in reached_html(stages, over=False)


def test_page_changes_no_bit(solved: Play) -> None:
    alone = Rollout(INSTANCE)
    for _ in roll_out([alone], Player.load(PolicySpec())):
        pass
    looked_at = rollout_of(solved).episode.simulation.scene.state_hash()
    assert looked_at == alone.episode.simulation.scene.state_hash()


def test_states_cover_the_episode(solved: Play) -> None:
    end_s = rollout_of(solved).episode.simulation.time_s
    assert solved.transport.end_s == pytest.approx(end_s, abs=0.06)


def test_expert_follows_another_goal_that_it_can_parse() -> None:
    ((top, bottom),) = INSTANCE.goal.pairs
    said = f"Place the {bottom} on top of the {top}".replace("_", " ")
    play = Play(own(said), player_of(), acts=True)
    until(lambda: play.status.phase is Phase.ACTING)
    assert reading_of(play).pairs == ((bottom, top),)
    assert play.instance is not None
    assert play.instance.goal.pairs == ((bottom, top),)
    assert play.leave(20.0)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (own("fetch me a coffee"), "none of them"),
        (
            own(f"Place the {ABSENT} cube on top of the {PRESENT} cube"),
            "There is no",
        ),
        (own(SAID, "vague"), "could not be read"),
    ],
)
def test_unread_sentences_are_not_acted_on(asked: EpisodeRequest, says: str) -> None:
    play = played(asked, vague=Reads((("red_cube", "blue_pad"),), 0.2))
    assert play.status.phase is Phase.FAILED
    assert says in reading_of(play).note
    assert not play.status.lines
    assert rollout_of(play).episode.elapsed_s == 0.0


@pytest.mark.parametrize(
    "said",
    [
        "Do not put the red cube on the green cube",
        "don't put the red cube on the green cube",
        "Never ever",
    ],
)
def test_denials_are_not_understood(said: str) -> None:
    reader = Reads(INSTANCE.goal.pairs, 0.9, refuses=False)
    play = played(own(said, "reader"), reader=reader)
    assert play.status.phase is Phase.FAILED
    assert reading_of(play).pairs is None
    assert "negation" in reading_of(play).note


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("Where is the red cube?", "That is a question."),
        ("Put the purple cube on the red one", "There is no purple cube here."),
    ],
)
def test_a_refusal_is_said_with_its_reason(said: str, why: str) -> None:
    reader = Reads((), 0.9, refusal="That is a question.")
    play = played(own(said, "reader"), reader=reader)
    assert play.status.phase is Phase.FAILED
    assert reading_of(play).note.startswith(why)


def test_it_asks_back_when_two_readings_are_near() -> None:
    ((top, bottom),) = INSTANCE.goal.pairs
    two = {"other": ((bottom, top),), "other_certainty": 0.3}
    reading = reading_of(played(own(SAID, "r"), r=Reads(((top, bottom),), 0.5, **two)))
    assert not reading.acts
    assert reading.choices == (((top, bottom),), ((bottom, top),))
    surer = Reads(INSTANCE.goal.pairs, 0.7, **two)
    assert not reading_of(played(own(SAID, "r"), r=surer)).choices


@pytest.mark.parametrize("task", SUITE)
def test_no_sentence_of_the_benchmark_is_taken_for_a_denial(task: str) -> None:
    given = load_instance(task, "test", 1)
    bank, blind = TASKS[task].language, Rollout(INSTANCE).policy_input(None)
    for kind in KINDS:
        for template in bank.templates(kind):
            said = template.render(given.goal.pairs)
            told = replace(blind, instruction=said)
            assert ask_reader(Reads(given.goal.pairs, 0.9), told, given).acts


def test_goal_that_was_read_is_what_is_judged() -> None:
    reader = Reads(INSTANCE.goal.pairs, 0.9)
    play = played(own(SAID, "reader"), reader=reader)
    assert play.status.phase is Phase.FAILED
    assert reading_of(play).pairs == INSTANCE.goal.pairs
    assert rollout_of(play).asked_holds is False


class ReadsAndActs(Composite):
    """The expert, as a policy that says what it read."""

    def __init__(self) -> None:
        self.expert = Player.load(PolicySpec()).policy

    @property
    def parts(self) -> tuple[object, ...]:
        return (self.expert, Reads(INSTANCE.goal.pairs, 0.9))

    def act(self, inputs: Sequence[PolicyInput]) -> Any:
        return self.expert.act(inputs)


def test_a_goal_that_was_only_understood_is_not_called_solved() -> None:
    play = played(own(SAID, "reader"), reader=ReadsAndActs())
    assert play.status.phase is Phase.FOLLOWED
    assert say_goal(INSTANCE.goal.pairs) in play.status.note
    # Its stages are not those of the listed goal.
    assert not play.reached()


def test_weights_of_another_version_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("reachnet", "oracle", "http://localhost:1"):
        assert not weights_words(name)
    monkeypatch.setattr("lemma.viz.recording.BENCHMARK_VERSION", "v4")
    words = "on version 3 of the benchmark; this is version 4."
    assert weights_words("reachnet").endswith(words)
    assert not weights_words("oracle")


def test_a_sentence_of_the_benchmark_is_judged_by_what_it_asks_for() -> None:
    ((top, bottom),) = INSTANCE.goal.pairs
    said = f"Place the {bottom} on top of the {top}".replace("_", " ")
    play = played(own(said, "reader"), reader=Reads(INSTANCE.goal.pairs, 0.9))
    assert play.status.phase is Phase.FAILED
    assert f"asks for {say_goal(((bottom, top),))}" in play.status.note


def test_expert_says_when_it_knows_no_way() -> None:
    simulation = Rollout(INSTANCE).episode.simulation
    pairs = INSTANCE.goal.pairs
    assert check_plan(Reading(pairs), simulation.scene, needed=True) == Reading(pairs)
    # A cube that fell off the table is lost.
    simulation.scene.set_pose(pairs[0][0], Pose((0.0, 3.0, -0.5), (1.0, 0.0, 0.0, 0.0)))
    for needed in (True, False):
        found = check_plan(Reading(pairs), simulation.scene, needed=needed)
        assert "no plan" in found.note
        assert found.acts is not needed


def test_motor_commands_are_played_too() -> None:
    play = Play(
        replace(STACK, policy="still"), player_of(still=StandsStill()), acts=True
    )
    until(lambda: play.transport.cursor_s > 1.0, play)
    assert play.status.phase is Phase.ACTING
    assert play.status.reading == SILENT
    assert play.scene is rollout_of(play).episode.simulation.scene
    assert play.leave(20.0)


class Hangs:
    def __init__(self) -> None:
        self.asked, self.released = threading.Event(), threading.Event()

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        self.asked.set()
        self.released.wait()
        raise RuntimeError("too late")


def test_policy_that_raises_is_said_to_have_failed() -> None:
    play = played(replace(STACK, policy="raises"), raises=Raises())
    assert play.status.phase is Phase.BROKEN
    assert EVIL in play.status.note


def test_policy_that_hangs_is_left_behind() -> None:
    hangs = Hangs()
    session = session_of(replace(STACK, policy="hangs"), hangs=hangs)
    session.ask(replace(STACK, policy="hangs"), acts=True)
    assert hangs.asked.wait(60.0)
    left = session.play
    session.ask(STACK, acts=True)
    assert session.play is not left
    until(lambda: bool(session.play.status.lines), session.play)
    hangs.released.set()
    assert left.wait(20.0)
    session.close()


def test_broken_wishes_leave_the_session_alive() -> None:
    session = session_of()
    session.ask(replace(STACK, index=10**6), acts=False)
    until_phase(session.play, Phase.BROKEN)
    assert "index" in session.play.status.note
    with pytest.raises(UnknownNameError):
        session.ask(replace(STACK, policy="os:system"), acts=True)
    session.ask(STACK, acts=False)
    until_phase(session.play, Phase.READY)
    session.close()


def test_closing_ends_the_thread() -> None:
    before = threading.active_count()
    session = session_of()
    session.ask(STACK, acts=True)
    until_phase(session.play, Phase.ACTING)
    session.close()
    until(lambda: threading.active_count() <= before)


def test_tables_of_before_are_freed() -> None:
    session = session_of()
    session.ask(STACK, acts=True)
    until_phase(session.play, Phase.ACTING)
    play, transport = weakref.ref(session.play), weakref.ref(session.play.transport)
    session.ask(replace(STACK, index=1), acts=False)
    until_phase(session.play, Phase.READY)

    def are_freed() -> bool:
        gc.collect()
        return play() is None and transport() is None

    # The robot at work holds them until it hears that nobody waits any more.
    until(are_freed)
    session.close()


def test_pause_stops_the_simulation() -> None:
    play = Play(STACK, player_of(), acts=True)
    until(lambda: bool(play.status.lines), play)
    play.transport.pause()
    time.sleep(0.2)
    before = rollout_of(play).episode.elapsed_s
    play.transport.advance(5.0)
    time.sleep(0.1)
    assert rollout_of(play).episode.elapsed_s == before
    play.leave(20.0)
