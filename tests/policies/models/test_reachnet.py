"""ReachNet as a whole: it trains, decides, and shows how right it is."""

import math
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch
from batches import RASTER, drawn_batch, gradients, inputs_of, labels_of, total
from tiny_models import tiny as tiny_model

import measure_reading
from lemma.core.errors import InvalidConfigError
from lemma.policies.batch import STOP
from lemma.policies.entities import BENCHMARK
from lemma.policies.interfaces import Grounder, PastStep, Planner, Policy
from lemma.policies.models.base import MODELS
from lemma.policies.models.reachnet.goal_reader import ReaderConfig
from lemma.policies.models.reachnet.model import ReachNet, ReachNetConfig
from lemma.policies.models.reachnet.scene_table import true_table
from lemma.policies.models.reachnet.understanding import lessons_of
from lemma.policies.weights import find_weights, load_model
from lemma.policies.weights_file import read_metadata, write_weights
from lemma.scene.objects.entity import ENTITIES
from lemma.tasks.subtask import Primitive, SubTask

tiny = partial(tiny_model, "reachnet")


def trained(model: ReachNet, steps: int, frames: int = 3) -> float:
    batch = drawn_batch(frames)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-2, fused=True)
    loss = math.inf
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = 1e-2 * min(1.0, 2 * (1 - step / steps))
        optimizer.zero_grad()
        term = total(model.loss(batch))
        term.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        loss = float(term.detach())
    return loss


@pytest.fixture(scope="module")
def expert() -> ReachNet:
    """A model that knows an episode by heart: 16 s."""
    model = tiny()
    trained(model, 200)
    return model


@pytest.fixture(scope="module")
def novice() -> ReachNet:
    """A model that was trained for a moment."""
    model = tiny()
    trained(model, 10)
    return model


def test_it_is_a_policy_a_planner_and_a_grounder() -> None:
    model = tiny()
    assert isinstance(model, Policy)
    assert isinstance(model, Planner)
    assert isinstance(model, Grounder)
    assert MODELS["reachnet"] == (ReachNet, ReachNetConfig)


@pytest.mark.slow
def test_it_overfits_one_episode(expert: ReachNet) -> None:
    batch = drawn_batch(3)
    scores = expert.score(batch)
    for name in ("plan", "present", "reading"):
        assert scores[name].tolist() == [1.0] * 3
    assert scores["place_pose"][:2].tolist() == [1.0] * 2
    assert scores["reach"].min() > 0.95
    labels = labels_of(batch)
    decisions = expert.act(inputs_of(batch))
    assert decisions[2].subtask.primitive is Primitive.STOP
    assert decisions[2].grounded is None
    assert decisions[2].explanation == ""
    for i, decision in enumerate(decisions[:2]):
        assert decision.grounded is not None
        for pose, wanted in (
            (decision.grounded.pick, labels.pick_pose[i]),
            (decision.grounded.place, labels.place_pose[i]),
        ):
            assert math.dist(pose.xy, wanted[:2].tolist()) < 0.02


@pytest.mark.parametrize(
    ("similar", "orders", "count"), [(0.0, 0.0, 0), (0.15, 0.0, 1), (0.9, 0.6, 7)]
)
def test_lessons_for_the_reader(similar: float, orders: float, count: int) -> None:
    reader = ReaderConfig(lessons=similar, orders=orders)
    lessons = lessons_of(reader, BENCHMARK, 4)
    if not count:
        assert lessons is None
        return
    assert lessons is not None
    batch = replace(drawn_batch(4), lesson=lessons.draw(0, 7))
    told = tiny().text_tensors(batch)
    assert len(told["goal"]) == len(told["reasons"]) == 4 + count
    assert told["words"].shape[1] == 4 + count
    ordered = 4 + count - math.ceil(4 * orders)
    assert (told["reasons"][ordered:] == -1).all()
    assert (told["goal"][ordered:, 0] >= 0).all()


@pytest.mark.parametrize("unread", [{"refuses": False}, {"guesses": True}])
def test_some_readers_have_no_lessons(unread: dict[str, bool]) -> None:
    assert lessons_of(ReaderConfig(**unread), BENCHMARK, 4) is None


def test_instructions_are_read_as_orders_with_the_goals_of_the_frames() -> None:
    batch = drawn_batch(4)
    told = tiny().text_tensors(batch)
    assert told["words"].shape[1] == len(told["goal"]) == 4
    assert told["reasons"].tolist() == [-1] * 4
    ((top, bottom),) = batch.labels.goals[0] if batch.labels else ()
    assert told["goal"][0, 0].tolist() == [
        batch.entities.number(name) for name in (top, bottom)
    ]


@pytest.mark.parametrize(("seen", "used"), [(0.1, True), (0.01, False)])
def test_a_hardly_visible_thing_counts_if_the_instruction_names_it(
    seen: float, used: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, batch = tiny(), drawn_batch(1)
    marks, coarse = model.eye(batch)
    points = torch.full_like(marks.points, -30.0)
    named, other, cell = ENTITIES.index("red_cube"), ENTITIES.index("blue_cube"), 77
    points[:, :, -1] = 0.0
    points[:, [named, other], cell] = math.log(seen)
    points[:, [named, other], -1] = math.log(1.0 - seen)
    marks = replace(marks, points=points, offsets=torch.zeros_like(marks.offsets))
    monkeypatch.setattr(model.eye, "forward", lambda batch: (marks, coarse))
    goal = torch.tensor([[[named, ENTITIES.index("red_pad")], [-1, -1]]])
    monkeypatch.setattr(
        model.reader, "read", lambda texts, present: (goal, torch.tensor([-1]))
    )
    (insight,) = model.explain(inputs_of(batch))
    assert [thing.name for thing in insight.objects] == ["red_cube"] * used


@pytest.mark.slow
def test_it_says_why_it_decides(novice: ReachNet) -> None:
    inputs = inputs_of(drawn_batch(3))
    read = [found.goal for found in novice.understand(inputs)]
    decided = [decision.subtask for decision in novice.act(inputs)]
    for insight, subtask, pairs in zip(
        novice.explain(inputs), decided, read, strict=True
    ):
        assert insight.options[0][0] == subtask
        shares = [share for _, share in insight.options]
        assert shares == sorted(shares, reverse=True)
        assert 0.0 < sum(shares) <= 1.0 + 1e-5
        assert insight.goal == pairs
        assert len(insight.robots) == 2


@pytest.mark.parametrize("reach", ["demonstrations", "none"])
def test_losses_are_finite_and_reach_what_they_shall(reach: str) -> None:
    model = tiny(reach=reach)
    terms = model.loss(drawn_batch(4))
    assert all(term.isfinite() for term in terms.values())
    total(terms).backward()
    found = gradients(model)
    assert all(grad is not None and grad.isfinite().all() for grad in found.values())
    # Nothing is dragged in these frames, and no stick is laid down.
    idle = ("grounding", "planner.numbers")
    still = [
        name
        for name, grad in found.items()
        if grad is not None and not grad.any() and not name.startswith(idle)
    ]
    blind = ("eye.ring", "planner.reach") if reach == "none" else ()
    assert [name for name in still if not name.startswith(blind)] == []


@pytest.mark.slow
def test_demonstrations_alone_tell_who_reached() -> None:
    model = tiny(reach="demonstrations")
    batch = drawn_batch(4)
    first = float(model.loss(batch)["reach"].detach())
    trained(model, 25)
    assert float(model.loss(batch)["reach"].detach()) < first


def test_demonstrations_need_no_arm_types() -> None:
    batch = drawn_batch(3)
    labels = replace(labels_of(batch), arms=torch.full((3, 2), 999))
    model = tiny(reach="demonstrations")
    assert total(model.loss(replace(batch, labels=labels))).isfinite()


@pytest.mark.slow
def test_it_grounds_what_another_planner_wants(expert: ReachNet) -> None:
    batch = drawn_batch(3)
    labels = labels_of(batch)
    given = inputs_of(batch)[:1]
    present = true_table(labels, torch.ones(3, 2, 3), RASTER).present[0]
    cubes = ("pink", "red", "white", "blue", "green")
    seen = next(c for i, c in enumerate(cubes) if present[i])
    missing = next(c for i, c in enumerate(cubes) if not present[i])
    move = Primitive.MOVE
    wanted = [
        SubTask("robot_0", move, f"{seen}_cube", "shared"),
        SubTask("robot_1", move, f"{missing}_cube", "shared"),
        SubTask("robot_1", Primitive.HOOK, f"{seen}_cube", "stick"),
        SubTask("robot_9", move, f"{seen}_cube", "shared"),
        SubTask("robot_0", move, f"{seen}_cube", f"{seen}_cube"),
        SubTask("robot_0", move, "teapot", "shared"),
    ]
    found = expert.ground(given * len(wanted), wanted)
    assert found[0] is not None
    assert found[0].robot == "robot_0"
    assert found[0].pick.x == pytest.approx(float(labels.pick_pose[0, 0]), abs=0.05)
    assert found[1:] == [None] * 5


def test_what_cannot_be_grounded_is_explained() -> None:
    model = tiny()
    with torch.no_grad():
        model.eye.nowhere.fill_(50.0)
        model.get_parameter("planner.stop.2.bias").fill_(-500.0)
    [decision] = model.act(inputs_of(drawn_batch(1, stop_last=False)))
    assert decision.grounded is None
    assert decision.subtask.primitive is not Primitive.STOP
    assert "not seen" in decision.explanation


@pytest.mark.slow
def test_what_keeps_failing_is_tried_less(novice: ReachNet) -> None:
    given = inputs_of(drawn_batch(3))[0]
    [wanted] = novice.plan([given])
    failed = PastStep(given.view, wanted, "unreachable")
    [other] = novice.plan([given.with_past((failed,) * 40)])
    assert other != wanted
    # Failures before the last success do not count.
    done = PastStep(given.view, wanted)
    [again] = novice.plan([given.with_past((*(failed,) * 40, *(done,) * 12))])
    assert [again] == novice.plan([given.with_past((done,) * 12)])


def test_stop_frames_score_only_what_counts() -> None:
    batch = drawn_batch(3)
    assert labels_of(batch).decision[-1, 1] == STOP
    scores = tiny().score(batch)
    assert scores["pick_2cm"][-1].isnan()
    assert not scores["plan"].isnan().any()


@pytest.mark.parametrize("wrong", [{"draws": 0}, {"robots": 1}])
def test_impossible_options_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(InvalidConfigError, match="or more"):
        ReachNetConfig(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--teach", "reachnet"], "has no weights.safetensors"),
        (["--teach", ".", "--start", "reachnet"], "no others"),
        (["--teach", ".", "--weights", "reader.pt"], "no others"),
    ],
)
def test_published_weights_are_not_taught(
    words: list[str],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights.safetensors").touch()
    monkeypatch.setattr(sys, "argv", ["measure_reading.py", *words])
    with pytest.raises(SystemExit):
        measure_reading.main()
    assert reason in capsys.readouterr().err


@pytest.mark.slow
def test_its_reader_is_taught_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, shipped = tmp_path / "weights.safetensors", find_weights("reachnet")
    about = replace(read_metadata(shipped), packed={})
    write_weights(path, load_model("reachnet").state_dict(), about)
    before = load_model(str(path)).state_dict()
    words = ["--teach", str(tmp_path), "--steps", "8", "--batch", "2", "--draws", "1"]
    monkeypatch.setattr(sys, "argv", ["measure_reading.py", *words])
    measure_reading.main()
    after = load_model(str(path)).state_dict()
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert changed
    assert all(name.startswith("reader.") for name in changed)
    command = read_metadata(path).command
    assert command.endswith(f"; python scripts/measure_reading.py {' '.join(words)}")
