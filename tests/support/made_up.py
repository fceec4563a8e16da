"""Lines of episodes that nobody played, for tests of what is made of them."""

from collections.abc import Iterable, Sequence
from typing import Any

from lemma.evaluation.analysis.result import Result, summarise
from lemma.evaluation.records import PROTOCOL_VERSION, WALL_CLOCK, Row
from lemma.evaluation.run.expert_feedback import count_steps
from lemma.tasks.instance import BENCHMARK_VERSION

STEP = {
    "robot": "robot_0",
    "primitive": "move",
    "pick": "red_cube",
    "place": "white_pad",
}
ABOUT = {
    "policy": {"name": "oracle", "planning": "single-step", "gta": False},
    "weights": {},
    "language": "full",
    "perturb_start": False,
    "split": "test",
    "protocol": "5" * 64,
    "horizon_s": 100.0,
    "protocol_version": PROTOCOL_VERSION,
    "verdicts": "both",
    "benchmark": BENCHMARK_VERSION,
    "format": "1",
    "lemma": "0.1.0",
    "mujoco": "3.17.0",
}


def timeless(rows: Iterable[Row]) -> list[Row]:
    """Return lines without what depends on the machine."""
    return [{k: v for k, v in row.items() if k not in WALL_CLOCK} for row in rows]


def step(
    left: int | None = 1,
    departure: str = "",
    outcome: str = "success",
    pick_mm: float | None = None,
    place_mm: float | None = None,
    *,
    able: bool | None = True,
) -> dict[str, Any]:
    """Return one sub-task of an episode, before which the expert needed so many."""
    feedback = {
        "expected": STEP,
        "left": left,
        "departure": departure,
        "able": able,
        "pick_error_mm": pick_mm,
        "place_error_mm": place_mm,
    }
    return {
        **STEP,
        "grounded": None,
        "outcome": outcome,
        "explanation": "",
        "start_s": 0.0,
        "duration_s": 1.0,
        "fell": [],
        "expert": feedback,
    }


def row(
    task: str = "stack",
    index: int = 0,
    *,
    success: bool = False,
    steps: Sequence[dict[str, Any]] = (),
    left: int | None = 0,
    failure: str | None = "goal_not_reached",
    **more: Any,
) -> dict[str, Any]:
    """Return the line of an episode; without more, it went on after no stop."""
    judged = {
        "success": success,
        "progress": float(success),
        "goal_progress": float(success),
        "stages": {
            "progress": float(success),
            "subtask": 1 if success else None,
            "stage": "placed" if success else "",
            "time_s": 20.0,
            "moved": "red_cube",
            "by": "robot_0",
            "understood": success,
            "allocated": True,
            "executed": success,
        },
        "failure": None if success else failure,
        "policy_error": None,
        "asked_holds": None,
        "elapsed_s": 30.0,
    }
    return {
        "protocol": PROTOCOL_VERSION,
        "benchmark": BENCHMARK_VERSION,
        "task": task,
        "split": "test",
        "index": index,
        "team": "ur5+ur10",
        "distractors": 1,
        "perturb_start": False,
        "instruction_kind": "high_level",
        "instruction": "Place the red cube on top of the blue cube",
        "asked": None,
        **judged,
        "idle_s": {"robot_0": 5.0, "robot_1": 25.0},
        "coordination": {
            "expert_s": 20.0,
            **count_steps(steps, left),
            "clearance_mm": 80.0,
        },
        "subtasks": list(steps),
        "left": left,
        "lenient": {**judged, "subtasks": []},
        "wall_s": 0.1,
        **more,
    }


def result(
    successes: int,
    episodes: int = 10,
    *,
    seed: int = 0,
    experiment: str = "reachnet",
    tasks: Sequence[str] = ("pass", "stack"),
    kind: str = "high_level",
) -> Result:
    """Return a result in which so many episodes of each task succeeded."""
    rows = [
        row(
            task,
            i,
            success=i < successes,
            instruction_kind=kind,
            steps=[step(2, "robot")],
            left=0 if i < successes else 2,
        )
        for task in tasks
        for i in range(episodes)
    ]
    weights = {"reachnet": {"sha256": "f" * 64, "seed": seed, "data": {}}}
    return summarise(
        rows, {**ABOUT, "weights": weights}, "lemma reproduce reachnet", experiment
    )
