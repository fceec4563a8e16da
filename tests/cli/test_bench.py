import json
import sys
from functools import partial

import pytest
from command import run

from lemma.bench.episodes import Trial, expert_figures, run_trials
from lemma.bench.speed import (
    measure_expert_loop,
    measure_speed,
    record_loop,
    time_loop,
)
from lemma.cli import bench as bench_verb
from lemma.core.errors import PhysicsError
from lemma.scene.build import TIME_STEP_S
from lemma.tasks.suite import load_instance


@pytest.mark.slow
@pytest.mark.render
def test_bench_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Everything is measured, a few times each.
    few = partial(measure_speed, repeats=5)
    monkeypatch.setattr(bench_verb, "measure_speed", few)
    twice = partial(measure_expert_loop, turns=2)
    monkeypatch.setattr(bench_verb, "measure_expert_loop", twice)
    words = "bench stack --expert --episodes 1 --workers 1 --json"
    assert run(*words.split()) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) == {"machine", "speed", "loop", "control", "expert"}
    assert set(report["loop"]) == set(bench_verb._LOOP_TARGETS)
    assert 0.0 < report["loop"]["lowest_ratio"] <= report["loop"]["ratio"]
    assert set(report["control"]) == set(bench_verb._CONTROL_TARGETS)
    assert 0.0 < report["control"]["ee_pose_ratio"] < 1.0
    assert 0.0 < report["control"]["joint_position_ratio"] < 1.0
    assert set(report["speed"]) == set(bench_verb._TARGETS)
    assert all(value > 0 for value in report["speed"].values())
    assert report["speed"]["peak_mb"] > 50
    assert set(report["expert"]) == {"stack"}
    assert set(report["expert"]["stack"]) == set(bench_verb._EXPERT_FORMS)
    assert report["expert"]["stack"]["episodes"] == 1
    assert report["machine"]["cores"] >= 1


def test_figures_keep_frozen_and_fresh_apart() -> None:
    trials = [
        Trial("stack", False, True, 10.0, 0),
        Trial("stack", False, True, 20.0, 0),
        Trial("stack", True, True, 99.0, 0),
        Trial("stack", True, False, 99.0, 3),
    ]
    figures = expert_figures(trials)["stack"]
    assert figures == {
        "episodes": 2,
        "success_rate": 1.0,
        "raw_success_rate": 0.5,
        "mean_sim_s": 15.0,
        "max_sim_s": 20.0,
        # Five tables were set for two fresh instances, and three were refused.
        "rejection_rate": pytest.approx(3 / 5),
    }


@pytest.mark.slow
def test_bare_physics_must_do_the_work_of_the_expert() -> None:
    instance = load_instance("pass", "test", 0)
    recorded = record_loop(instance)
    assert len(recorded.commands) == round(recorded.simulated_s / TIME_STEP_S)
    times = time_loop(instance, recorded)
    # Two sub-tasks, and the look that finds the goal reached.
    assert len(times) >= 3
    assert all(loop > 0.0 for loop, _ in times)
    changed = recorded.commands.copy()
    changed[len(changed) // 2, 0] += 1e-6
    with pytest.raises(PhysicsError, match="another state"):
        time_loop(instance, recorded._replace(commands=changed))


@pytest.mark.slow
def test_trials_are_the_same_in_several_processes() -> None:
    alone = list(run_trials(["pass"], 2, workers=1))
    assert list(run_trials(["pass"], 2, workers=2)) == alone
    assert [trial.fresh for trial in alone] == [False, False, True, True]


@pytest.mark.slow
@pytest.mark.render
def test_figures_of_a_policy(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("bench", "pass", "--episodes", "1", "--policy", "oracle", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) == {"machine", "policy"}
    found = report["policy"]
    assert found["decisions"] >= 2
    assert 0 < found["decision_ms"] <= found["slowest_ms"]
    assert found["look_ms"] == 0.0
    assert found["success_rate"] == 1.0
    assert found["peak_mb"] > 50


def test_many_tables_need_an_extra_and_their_number_needs_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "lemma.bench.worlds", raising=False)
    monkeypatch.setitem(sys.modules, "warp", None)
    assert run("bench", "--gpu") == 2
    assert "--gpu needs warp: pip install 'lemma-bench[warp]'" in one_line(capsys)
    assert run("bench", "--worlds", "8") == 2
    assert "--worlds needs --gpu" in one_line(capsys)
    assert run("bench", "--gpu", "--worlds", "0") == 2
    assert "at least 1, not 0" in one_line(capsys)


def test_the_memory_for_images_needs_a_training(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run("bench", "--images", "device") == 2
    assert "--images needs --training" in one_line(capsys)


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    return " ".join(capsys.readouterr().err.split())
