"""A faulty policy pays with its own episode; the others do not notice."""

import errno
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiers import slow_but

from lemma.core.errors import (
    DatasetError,
    LemmaError,
    RenderingError,
    WeightsError,
)
from lemma.core.poses import Pose2
from lemma.core.workers.pool import Serial
from lemma.env.simulation import Simulation
from lemma.env.view import View
from lemma.evaluation.records import EPISODES, POLICY_ERROR
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.evaluation.run.fault_isolation import (
    Fault,
    IsolatedPolicy,
    check,
)
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.motion.outcome import SkillResult
from lemma.policies.compose import PlannerWithGrounder
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.oracle import OracleGrounder, OraclePlanner
from lemma.policies.spec import PolicySpec
from lemma.serve.conversation import Conversation, ProtocolMode, remote
from lemma.serve.faults import (
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
)
from lemma.serve.session import Session
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import load_instance

HERE = Pose2(0.1, -0.2, 0.3)
MOVE = SubTask("robot_0", Primitive.MOVE, "red_cube", "blue_pad")
GROUNDED = GroundedSubTask("robot_0", Primitive.MOVE, HERE, HERE)
GOOD = Decision(MOVE, GROUNDED)
BLIND = View(
    np.zeros((0, 0, 3), np.uint8),
    np.zeros((0, 0), np.float32),
    np.zeros((0, 0), np.bool_),
    np.zeros((0, 6)),
    np.zeros(0),
)


def given(instruction: str = "go") -> PolicyInput:
    return PolicyInput(instruction, ("red robot", "white robot"), BLIND)


def posed(**pose: Any) -> Decision:
    return Decision(MOVE, replace(GROUNDED, place=replace(HERE, **pose)))


def named(**names: Any) -> Decision:
    subtask = replace(MOVE)
    for name, value in names.items():
        # Past the checks of the class, as what was unpickled or made by hand.
        object.__setattr__(subtask, name, value)
    return Decision(subtask, None)


WRONG: dict[str, tuple[Any, FaultKind, str]] = {
    "nothing": (None, FaultKind.MALFORMED, "NoneType"),
    "a map": ({"robot": "robot_0"}, FaultKind.MALFORMED, "dict"),
    "text": (Decision("move", GROUNDED), FaultKind.MALFORMED, "str"),  # type: ignore[arg-type]
    "no grounded": (Decision(MOVE, HERE), FaultKind.MALFORMED, "Pose2"),  # type: ignore[arg-type]
    "list as pose": (
        Decision(MOVE, replace(GROUNDED, pick=[0, 0, 0])),  # type: ignore[arg-type]
        FaultKind.MALFORMED,
        "pick pose is a list",
    ),
    "array in pose": (posed(x=np.zeros(2)), FaultKind.MALFORMED, "ndarray"),
    "text in pose": (posed(x="0.1"), FaultKind.MALFORMED, "str"),
    "complex": (posed(x=np.complex64(1j)), FaultKind.MALFORMED, "complex64"),
    "truth": (posed(x=True), FaultKind.MALFORMED, "bool"),
    "NaN": (posed(yaw=math.nan), FaultKind.NOT_FINITE, "nan"),
    "NumPy's NaN": (posed(x=np.float32("nan")), FaultKind.NOT_FINITE, "nan"),
    "infinite": (posed(y=-math.inf), FaultKind.NOT_FINITE, "inf"),
    "too large": (posed(y=10**400), FaultKind.NOT_FINITE, "inf"),
    "millimetres": (posed(x=451.0), FaultKind.NOT_FINITE, "metres"),
    "robot": (named(robot="robot_2"), FaultKind.UNKNOWN_NAME, "robot_0, robot_1"),
    "robot's phrase": (named(robot="red robot"), FaultKind.UNKNOWN_NAME, "red robot"),
    "primitive": (named(primitive="throw"), FaultKind.UNKNOWN_NAME, "prehook"),
    "entity": (named(pick="purple_cube"), FaultKind.UNKNOWN_NAME, "purple_cube"),
    "number": (named(place=3), FaultKind.UNKNOWN_NAME, "3"),
    "no entity, no poses": (named(pick=""), FaultKind.UNKNOWN_NAME, "no entity"),
    "two robots": (
        Decision(MOVE, replace(GROUNDED, robot="robot_1")),
        FaultKind.MALFORMED,
        "robot_1 move",
    ),
    "stop with poses for a move": (
        Decision(MOVE, replace(GROUNDED, primitive=Primitive.STOP)),
        FaultKind.MALFORMED,
        "stop",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_no_decision_is_named(what: str) -> None:
    answer, kind, words = WRONG[what]
    fault = check(answer, given())
    assert isinstance(fault, Fault)
    assert fault.kind is kind
    assert words in fault.explanation
    json.dumps(fault.to_dict())


@pytest.mark.parametrize(
    "decision",
    [
        GOOD,
        Decision(STOP, None),
        Decision(MOVE, None, "not seen"),
        # A model that acts from end to end names no entities.
        Decision(SubTask("robot_0", Primitive.MOVE), GROUNDED),
        # Far away, but a number: the robot will say that it is out of reach.
        posed(x=50.0),
    ],
)
def test_a_decision_stays_as_it_is(decision: Decision) -> None:
    assert check(decision, given()) == decision


def test_other_spellings_become_plain_types() -> None:
    number = np.float32(0.3)
    pose = Pose2(number, np.asarray(0.5), 2)  # type: ignore[arg-type]
    loose = Decision(
        replace(MOVE, primitive="move"),  # type: ignore[arg-type]
        GroundedSubTask("robot_0", "move", pose, pose),  # type: ignore[arg-type]
    )
    found = check(loose, given())
    assert isinstance(found, Decision)
    assert found.grounded is not None
    assert found.subtask.primitive is Primitive.MOVE
    assert found.grounded.pick == Pose2(float(number), 0.5, 2.0)
    assert {type(v) for v in (found.grounded.pick.x, found.grounded.pick.y)} == {float}
    assert check(Decision(replace(STOP, robot="robot_0"), GROUNDED), given()) == (
        Decision(STOP, None)
    )


class Answers:
    """Answers what a function says of all inputs, and keeps how many they were."""

    def __init__(self, answer: Callable[[Sequence[PolicyInput]], Any]) -> None:
        self.answer, self.asked = answer, list[int]()

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        self.asked.append(len(inputs))
        answers: list[Decision] = self.answer(inputs)
        return answers


def raises(error: Exception) -> Callable[[Sequence[PolicyInput]], Any]:
    def answer(inputs: Sequence[PolicyInput]) -> Any:
        if any(one.instruction == "bad" for one in inputs):
            raise error
        return [GOOD] * len(inputs)

    return answer


INPUTS = [given("a"), given("bad"), given("b")]


@pytest.mark.parametrize(
    ("answer", "kind", "words"),
    [
        (raises(KeyError("x\ny")), FaultKind.RAISED, r"KeyError: 'x\ny'"),
        (raises(RecursionError()), FaultKind.RAISED, "RecursionError"),
        (
            raises(PolicyFailedError(FaultKind.DIED, "It died.")),
            FaultKind.DIED,
            "It died.",
        ),
        (
            lambda inputs: [GOOD for one in inputs if one.instruction != "bad"],
            FaultKind.MALFORMED,
            "0 decisions for 1",
        ),
        (
            lambda inputs: (
                None
                if any(i.instruction == "bad" for i in inputs)
                else [GOOD] * len(inputs)
            ),
            FaultKind.MALFORMED,
            "NoneType",
        ),
    ],
)
def test_only_the_guilty_one_pays(answer: Any, kind: FaultKind, words: str) -> None:
    policy = Answers(answer)
    good, bad, other = IsolatedPolicy(policy).decide(INPUTS)
    assert good == other == GOOD
    assert isinstance(bad, Fault)
    assert bad.kind is kind
    assert words in bad.explanation
    assert policy.asked == [3, 1, 1, 1]


def test_after_a_hang_everybody_is_asked_alone() -> None:
    policy = Answers(raises(PolicyFailedError(FaultKind.TIMEOUT, "Too long.")))
    guard = IsolatedPolicy(policy)
    assert [isinstance(a, Fault) for a in guard.decide(INPUTS)] == [False, True, False]
    assert guard.decide([INPUTS[0], INPUTS[2]]) == [GOOD, GOOD]
    assert policy.asked == [3, 1, 1, 1, 1, 1]


def test_whoever_is_gone_has_made_no_mistake() -> None:
    guard = IsolatedPolicy(Answers(raises(PolicyUnreachableError("gone"))))
    for inputs in (INPUTS, INPUTS[1:2]):
        with pytest.raises(PolicyUnreachableError):
            guard.decide(inputs)


def test_interrupts_are_not_faults() -> None:
    def interrupt(inputs: Sequence[PolicyInput]) -> Any:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        IsolatedPolicy(Answers(interrupt)).decide(INPUTS)


class Expert(PlannerWithGrounder):
    """The expert, but for one instruction, from its second decision on."""

    def __init__(self, bad: str, spoil: Callable[[Decision], Any]) -> None:
        super().__init__(OraclePlanner(), OracleGrounder())
        object.__setattr__(self, "spoil", spoil)
        object.__setattr__(self, "bad", bad)

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        spoil, bad = vars(self)["spoil"], vars(self)["bad"]
        return [
            spoil(decision) if one.past and one.instruction == bad else decision
            for one, decision in zip(inputs, super().act(inputs), strict=True)
        ]


def division(decision: Decision) -> Decision:
    raise ZeroDivisionError


def not_a_number(decision: Decision) -> Decision:
    assert decision.grounded is not None
    pose = Pose2(math.nan, 0.0, 0.0)
    return replace(decision, grounded=replace(decision.grounded, place=pose))


@pytest.mark.parametrize(
    ("spoil", "kind"),
    slow_but(
        [(division, FaultKind.RAISED), (not_a_number, FaultKind.NOT_FINITE)],
        (not_a_number, FaultKind.NOT_FINITE),
    ),
)
def test_the_others_solve_their_tasks(spoil: Any, kind: FaultKind) -> None:
    plays = [
        Rollout(load_instance(task, "test", 0)) for task in ("stack", "pass", "poke")
    ]
    policy = Expert(plays[1].instruction, spoil)
    assert len(list(roll_out(plays, Player(policy)))) == 3
    assert [play.success for play in plays] == [True, False, True]
    assert plays[1].failure == POLICY_ERROR
    assert plays[1].fault is not None
    assert plays[1].fault.kind is kind
    assert len(plays[1].steps) == 1
    assert plays[0].failure is None
    assert plays[0].fault is None


def test_unstable_physics_cost_one_episode_and_are_judged_as_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    execute = Simulation.execute
    rollouts = [Rollout(load_instance("stack", "test", i)) for i in range(2)]
    broken = rollouts[0].episode.simulation

    def diverging(self: Simulation, *args: Any, **kwargs: Any) -> SkillResult:
        if self is broken and self.time_s > 0.0:
            self.scene.data.qvel[:] = math.nan
        return execute(self, *args, **kwargs)

    monkeypatch.setattr(Simulation, "execute", diverging)
    after: dict[int, float] = {}
    player = Player.load(PolicySpec("oracle"))
    for _ in roll_out(
        rollouts,
        player,
        on_step=lambda one, _: after.update({id(one): one.episode.elapsed_s}),
    ):
        pass
    fault = rollouts[0].fault
    assert fault is not None
    assert fault.kind is FaultKind.UNSTABLE
    assert "unstable" in fault.explanation
    verdict = rollouts[0].verdict()
    assert (verdict.success, verdict.steps) == (False, 1)
    assert verdict.elapsed_s == pytest.approx(after[id(rollouts[0])], abs=1.1)
    assert np.isfinite(broken.scene.data.qpos).all()
    assert rollouts[1].success


class Confused:
    """Somebody's class: raises at half of the instructions, and stops at the others."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        for one in inputs:
            if len(one.instruction) % 2:
                raise LookupError(one.instruction)
        return [Decision(STOP, None)] * len(inputs)


@pytest.mark.render
def test_a_run_goes_on_and_names_the_faults(tmp_path: Path) -> None:
    spec = PolicySpec(f"{Path(__file__).stem}:Confused")
    order = EvaluationConfig(out=tmp_path, policy=spec, tasks=("stack",), episodes=12)
    rows = evaluate(order, Serial())
    assert len(rows) == 12
    wrong = [row for row in rows if row["policy_error"]]
    assert 0 < len(wrong) < 12
    for row in rows:
        confused = len(row["instruction"]) % 2 == 1
        assert (row["policy_error"] is not None) == confused
        assert row["failure"] == (POLICY_ERROR if confused else "goal_not_reached")
        assert row["success"] is False
    assert wrong[0]["policy_error"] == {
        "kind": "raised",
        "explanation": f"LookupError: {wrong[0]['instruction']}",
    }
    lines = (tmp_path / EPISODES).read_text().splitlines()
    assert [json.loads(line) for line in lines] == rows


def wrapped(cause: Exception) -> Exception:
    error = ValueError("no decision")
    error.__cause__ = cause
    return error


TROUBLE: dict[str, tuple[Exception, type[LemmaError]]] = {
    "cassette": (DatasetError("Line 2 cannot be read."), DatasetError),
    "weights": (WeightsError("They are damaged."), WeightsError),
    "pictures": (RenderingError("No OpenGL."), RenderingError),
    "disk": (OSError(errno.ENOSPC, "No space left"), PolicyUnreachableError),
    "files": (OSError(errno.EMFILE, "Too many open files"), PolicyUnreachableError),
    "memory": (MemoryError(), PolicyUnreachableError),
    "allocator": (
        RuntimeError("DefaultCPUAllocator: can't allocate memory"),
        PolicyUnreachableError,
    ),
    "wrapped": (wrapped(MemoryError()), PolicyUnreachableError),
    "gpu": (type("OutOfMemoryError", (RuntimeError,), {})(), PolicyUnreachableError),
}


class InTrouble:
    def __init__(self, error: Exception) -> None:
        self.error = error

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        raise self.error


@pytest.mark.parametrize("what", TROUBLE)
@pytest.mark.parametrize("served", [False, True])
def test_trouble_of_the_machine_is_no_fault_of_the_policy(
    what: str, served: bool
) -> None:
    error, kind = TROUBLE[what]
    policy: Any = InTrouble(error)
    if served:
        channel = Straight(Session(policy))
        policy = remote(Conversation("there", lambda: channel, ProtocolMode(9.0)))
        kind = PolicyUnreachableError
    with pytest.raises(kind):
        IsolatedPolicy(policy).decide([given(), given()])


class Straight:
    """A channel to a session in this process."""

    def __init__(self, session: Session) -> None:
        self.session, self.answers = session, list[bytes]()

    def send(self, message: bytes) -> None:
        self.answers.append(self.session.answer(message))

    def receive(self, timeout_s: float) -> bytes:
        return self.answers.pop(0)

    def close(self) -> None:
        pass
