"""Policies trained on frames in memory: the same frames, and policies of LeRobot."""

import math
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import torch
from check_training import plugin
from small_recipe import TASKS, recipe

import lemma
from demonstration_film import AROUND, FIRST, FOCUS, OPEN_M, Film, film
from lemma.dataset.lerobot.frames import PRIVILEGED, SENTENCE, Style, frames
from lemma.dataset.recipe.files import read_group
from lemma.env.learning.motor_state import WAYPOINT
from lemma.evaluation.run.loading import weights_of
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.control.interfaces import ControlInput
from lemma.policies.control.lerobot import LeRobotPolicy, PrivilegedLeRobotPolicy
from lemma.policies.spec import PolicySpec
from lemma.policies.weights_file import TIME_LIMIT, read_metadata
from measure_waypoints import main as main_of_errors
from publish_weights import Fineness, pack_checkpoint
from train_lerobot_policy import POLICIES, main, make_policy

STEPS, BATCH = 2, 4


@cache
def work() -> Path:
    return Path(mkdtemp(prefix="lemma-film-"))


def style(told: str) -> Style:
    return Style(
        fps=5,
        depth=False,
        cameras=("robot_0", "robot_1") if told == SENTENCE else (),
        images=told == SENTENCE,
        environment_state=told,
        control=WAYPOINT,
        width_px=64,
        height_px=48,
    )


@cache
def filmed(told: str) -> Path:
    folder = work() / told
    film(recipe(), folder, style(told), 1)
    return folder


@pytest.mark.parametrize("told", [SENTENCE, PRIVILEGED])
def test_frames_are_those_of_an_export(told: str) -> None:
    seen = Film.load(filmed(told), "cpu")
    first = 0
    for task in TASKS:
        record = read_group(recipe() / "train" / f"{task}.parquet", 0)[0]
        rows = list(frames(record, style(told)))
        end = first + len(rows)
        for name, values in (seen.vectors | seen.images).items():
            wanted = np.stack([row[name] for row in rows])
            assert np.array_equal(values[first:end].numpy(), wanted)
        assert (seen.last[first:end] == end - 1).all()
        first = end
    assert len(seen.last) == first
    assert bool(seen.images) == (told == SENTENCE)


def test_displaced_arms_are_seen_elsewhere_with_the_same_targets() -> None:
    folder = work() / "displaced"
    film(recipe(), folder, style(SENTENCE), 1, share=1.0)
    plain, moved = (Film.load(f, "cpu") for f in (filmed(SENTENCE), folder))
    assert torch.equal(plain.vectors["action"], moved.vectors["action"])
    states = [one.vectors["observation.state"] for one in (plain, moved)]
    before, after = (rows.reshape(len(rows), 2, 10) for rows in states)
    assert torch.equal(before[..., 9], after[..., 9])
    off_m = (after - before)[..., :3].norm(dim=2)
    away = off_m > 0.0
    # One arm is busy at a time, and never moved while its gripper is not open.
    assert (away.sum(1) <= 1).all()
    assert not away[before[..., 9] < OPEN_M].any()
    assert 0.2 < away.any(1).float().mean() < 0.9
    assert 0.02 < off_m[away].median() < 0.2
    turned = after[..., 3:9].reshape(-1, 2, 2, 3)
    assert torch.allclose(turned.norm(dim=3), torch.ones(()), atol=1e-4)
    for name, images in moved.images.items():
        if "0" in name:
            seen = (images != plain.images[name]).flatten(1).any(1)
            assert seen[away[:, 0]].all()


@pytest.mark.parametrize("share", ["-0.1", "2", "nan"])
def test_a_share_is_no_more_than_all(
    share: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["film", "nowhere", "nothing", f"--displaced={share}"])
    assert "from 0 to 1" in capsys.readouterr().err


def test_what_was_filmed_otherwise_is_not_taken_for_it() -> None:
    with pytest.raises(SystemExit, match="another film"):
        film(recipe(), filmed(PRIVILEGED), style(SENTENCE), 1)


def test_policies_that_draw_answer_alike_each_time() -> None:
    folder = work() / "drawing"
    words = "--policy diffusion --steps 1 --batch 4 --points 1"
    main(["train", str(filmed(PRIVILEGED)), str(folder), *words.split()])
    policy = PrivilegedLeRobotPolicy(
        str(folder / "checkpoints/last/pretrained_model"), hz=5
    )
    env = lemma.make("stack", split="val", **policy.control_options)
    observation, _ = env.reset()
    given = [
        ControlInput(instruction="", robots=TASKS, observation=observation, step=step)
        for step in (0, 0, 3)
    ]
    state = torch.random.get_rng_state()
    one, same, other = (answer.rows for answer in policy.act(given))
    for row, answer in zip((one, same, other), policy.act(given), strict=True):
        assert np.array_equal(row, answer.rows)
    # Where in a batch it is asked shows in the last bits.
    assert np.allclose(one, same, atol=1e-4)
    assert not np.allclose(one, other, atol=1e-4)
    assert torch.equal(torch.random.get_rng_state(), state)
    # Episodes are denoised together, as if each were alone.
    assert np.shape(one)[0] == policy._config.n_action_steps
    policy._one_by_one = True
    for row, answer in zip((one, same, other), policy.act(given), strict=True):
        assert np.allclose(row, answer.rows, atol=1e-4)


def test_weights_say_that_a_time_ended_their_training() -> None:
    for long, ended in (("--steps 1", "steps"), ("--train-s 0.1", TIME_LIMIT)):
        folder = work() / ended
        words = f"--policy act {long} --batch 4 --points 1"
        main(["train", str(filmed(PRIVILEGED)), str(folder), *words.split()])
        path = folder / "packed.safetensors"
        made = folder / "checkpoints/last/pretrained_model"
        assert pack_checkpoint(made, path, words, Fineness(512.0)).ended == ended
        assert read_metadata(path).ended == ended
        played = weights_of(PolicySpec(f"lerobot:{made}"))["act"]
        assert ("ended" in played) == (ended == TIME_LIMIT)


def test_new_waypoints_are_decisive() -> None:
    seen = Film.load(filmed(PRIVILEGED), "cpu")
    found = seen.decisive()
    assert found[0]
    assert 0.1 < found.float().mean() < 0.6
    rows = seen.vectors["action"]
    gripper = (rows[1:] - rows[:-1])[:, [9, 19]].abs().amax(1) > 0.09
    assert gripper.sum() >= 4
    for frame in (gripper.nonzero().ravel() + 1).tolist():
        assert all(found[frame + step] for step in (0, *AROUND))


def test_nothing_is_learned_from_arms_that_are_home_again() -> None:
    seen = Film.load(filmed(PRIVILEGED), "cpu")
    begins, ends = seen.begins(), seen.last.unique()
    # They stand where they began, and are told to stay.
    state, action = seen.vectors["observation.state"], seen.vectors["action"]
    assert torch.allclose(state[ends], state[begins], atol=0.1)
    assert torch.allclose(state[ends], action[ends], atol=0.1)
    idle, decisive = seen.idle(), seen.decisive()
    assert idle[ends].any()
    assert 0.0 < idle.float().mean() < 0.1
    assert not decisive[ends].any()
    assert not (idle & decisive).any()
    for end in ends.tolist():
        tail = idle[seen.last == end]
        assert not tail[: len(tail) // 2].any()

    class Config:
        action_delta_indices = (0,)
        observation_delta_indices = None

    drawn = next(seen.batches(Config(), 4096, 0))["observation.state"]
    left_out = state[idle]
    assert not (drawn[:, None] == left_out[None]).all(2).any()
    # The first episode alone: what follows its end is its beginning.
    many = int(seen.last[0]) + 1
    vectors = {name: rows[:many] for name, rows in seen.vectors.items()}
    alone = Film(vectors, {}, seen.last[:many])
    assert torch.equal(alone.decisive(), decisive[:many])
    assert torch.equal(alone.idle(), idle[:many])


@pytest.mark.parametrize("policy", POLICIES)
def test_trained_policies_are_evaluated_as_they_are(
    policy: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Rollout, "horizon_s", 2.0)
    for told, kind in (
        (SENTENCE, LeRobotPolicy),
        (PRIVILEGED, PrivilegedLeRobotPolicy),
    ):
        out = work() / f"{policy}-{told}"
        words = f"--policy {policy} --steps {STEPS} --batch {BATCH} --points 2 --tell 1"
        main(["train", str(filmed(told)), str(out), *words.split()])
        lines = capsys.readouterr().out.splitlines()
        losses = [float(line.split()[-1]) for line in lines if "loss" in line]
        assert len(losses) == STEPS
        assert all(map(math.isfinite, losses))
        saved = sorted(path.name for path in (out / "checkpoints").iterdir())
        assert saved == ["000001", "000002", "last"]
        made = out / "checkpoints/last/pretrained_model"
        main_of_errors([str(filmed(told)), str(made)])
        *_, last = capsys.readouterr().out.splitlines()
        # Nothing is learned in two steps.
        quarter, half, most = map(float, last.split()[1:])
        assert 0.0 < quarter <= half <= most < 300.0
        player = kind(str(made), hz=5)
        found = lemma.evaluate(player, tasks="stack", split="val", episodes=1)
        assert not found.errors
        (row,) = found.rows
        assert row["control"]["actions"] == 10


@pytest.mark.parametrize("policy", POLICIES)
def test_chunks_have_the_asked_length(policy: str) -> None:
    seen = Film.load(filmed(SENTENCE), "cpu")
    learner, _, _ = make_policy(policy, seen, "cpu", chunk=16, executed=5)
    samples = seen.samples(torch.arange(3), learner.config)
    assert samples["action"].shape[1] == 16
    assert learner.config.n_action_steps == 5


def test_images_are_normalized_as_in_training() -> None:
    seen = Film.load(filmed(SENTENCE), "cpu")
    # One camera is dark: its own statistics are far from those of all.
    first, *others = seen.images
    images = {first: seen.images[first] // 8, **{n: seen.images[n] for n in others}}
    seen = Film(seen.vectors, images, seen.last)
    learner, before, _ = make_policy("act", seen, "cpu")
    batch = before(seen.samples(torch.arange(0, len(seen.last), 8), learner.config))
    features: list[torch.Tensor] = []

    def features_of(policy: Any) -> torch.Tensor:
        features.clear()
        hook = policy.model.encoder_img_feat_input_proj.register_forward_pre_hook(
            lambda _, inputs: features.append(inputs[0])
        )
        policy.forward(batch)
        hook.remove()
        return torch.stack(features)

    with torch.no_grad():
        learner.train()
        for _ in range(60):
            in_training = features_of(learner)
        learner.save_pretrained(work() / "normalized")
        found = features_of(type(learner).from_pretrained(work() / "normalized").eval())
    # Camera by camera it would be 0.46; this batch is small, and so is its variance.
    assert (found - in_training).norm() < 0.15 * in_training.norm()


@pytest.mark.parametrize("told", [SENTENCE, PRIVILEGED])
@pytest.mark.parametrize("policy", POLICIES)
def test_compiled_networks_have_the_same_loss_and_names(policy: str, told: str) -> None:
    seen = Film.load(filmed(told), "cpu")
    traced, found = [], []

    def backend(graph: Any, _: Any) -> Any:
        # PyTorch traced it. Kernels of it are not made, which takes a minute.
        traced.append(graph)
        return graph

    for compiled in (False, True):
        torch.manual_seed(0)
        with patch.object(torch, "compile", partial(torch.compile, backend=backend)):
            learner, before, _ = make_policy(policy, seen, "cpu", compiled=compiled)
        batch = before(next(seen.batches(learner.config, BATCH, 0)))
        loss, _ = learner.train().forward(batch)
        found.append((loss.item(), list(learner.state_dict())))
        assert bool(traced) == compiled
    assert found[0] == found[1]


@pytest.mark.parametrize("policy", POLICIES)
def test_numbers_that_never_change_may_do_so_in_use(policy: str) -> None:
    seen = Film.load(filmed(SENTENCE), "cpu")
    state, action = "observation.state", "action"
    for rows in (seen.vectors[state], seen.vectors[action]):
        rows[:, 10:] = rows[0, 10:]
    _, before, after = make_policy(policy, seen, "cpu")
    moved = {state: seen.vectors[state] + 1e-5, action: seen.vectors[action]}
    shown = before(moved)
    assert shown[state][:, 10:].abs().max() < 0.01
    assert torch.allclose(after(shown[action]), seen.vectors[action], atol=1e-5)


@pytest.mark.parametrize("policy", POLICIES)
def test_who_is_told_of_grippers_alone_does_not_see_poses(policy: str) -> None:
    seen = Film.load(filmed(SENTENCE), "cpu")
    state = "observation.state"
    shape = seen.vectors[state].shape
    noise = torch.rand(shape, generator=torch.Generator().manual_seed(0))
    grippers = torch.zeros(shape, dtype=torch.bool)
    grippers[:, [9, 19]] = True

    def shown(rows: torch.Tensor, told: str) -> torch.Tensor:
        _, before, _ = make_policy(policy, seen, "cpu", told)
        found: torch.Tensor = before({state: rows})[state]
        return found

    rows = seen.vectors[state]
    elsewhere, wider = rows + noise * ~grippers, rows + noise * grippers
    for told, alike in (("full", False), ("grippers", True)):
        plain = shown(rows, told)
        assert torch.allclose(shown(elsewhere, told), plain, atol=1e-5) == alike
        assert not torch.allclose(shown(wider, told), plain, atol=1e-2)


def test_waypoints_solve_the_task_in_lerobots_environment() -> None:
    task = TASKS[0]
    config = plugin().LemmaEnvConfig(
        task=task,
        split="train",
        fps=5,
        control=WAYPOINT,
        environment_state=PRIVILEGED,
    )
    env = config.create_envs(n_envs=1)[task][0]
    observed, _ = env.reset(
        seed=[plugin().FIRST_SEED], options={"lerobot_new_rollout": True}
    )
    seen = Film.load(filmed(PRIVILEGED), "cpu")
    states, actions = seen.vectors["observation.state"], seen.vectors["action"]
    assert np.allclose(observed["agent_pos"][0], states[0], atol=1e-5)
    end = int(seen.last[0])
    solved = False
    for number in [*range(end + 1), *[end] * 10]:
        *_, terminated, _, info = env.step(actions[number][None].numpy())
        solved = bool(info["is_success"][0])
        if terminated[0]:
            break
    env.close()
    assert solved


def test_samples_stay_in_their_episode_and_repeat() -> None:
    seen = Film.load(filmed(PRIVILEGED), "cpu")

    class Config:
        action_delta_indices = tuple(range(10))
        observation_delta_indices = None

    first, again = (next(seen.batches(Config(), 64, 7)) for _ in range(2))
    for name, values in first.items():
        assert torch.equal(values, again[name])
    assert first["action"].shape == (64, 10, 20)
    padded = first["action_is_pad"]
    assert padded.any()
    # Behind the end, the last action repeats.
    rows = first["action"][padded.any(1)]
    ends = padded[padded.any(1)].int().argmax(1)
    for row, end in zip(rows, ends.tolist(), strict=True):
        assert (row[end:] == row[end - 1]).all()
    decisive = seen.decisive()
    # Some of the other samples are decisive by chance.
    rows = seen.vectors["observation.state"]
    drawn = [
        int((rows == row).all(1).nonzero()[0]) for row in first["observation.state"]
    ]
    begin, focused = round(FIRST * 64), round(FOCUS * 64)
    assert set(drawn[:begin]) <= set(seen.begins().tolist())
    assert all(decisive[drawn[: begin + focused]])
    assert not all(decisive[drawn])
