"""The protocol: everything that affects a result, in one frozen file with a hash.

It includes the paper's suite; :mod:`lemma.evaluation.protocol.suites` has the others.
The package has the file ``protocol.json``. The protocol in force is computed from the
code, the data and the versions. Results quote its hash, which equals that of the file
unless something differs. Results of different protocols are never combined.
"""

import json
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from typing import Any

from lemma.core.errors import DatasetError
from lemma.core.workers.resumable import flat
from lemma.env.episode import LEAST_STEP_S, STILL_S
from lemma.env.simulation import HORIZON_S
from lemma.env.stages import LOOK_TICKS
from lemma.evaluation.protocol.expert_times import times_sha256
from lemma.evaluation.protocol.language_controls import LANGUAGES
from lemma.evaluation.protocol.perturbed_starts import (
    APART_M,
    FROM_STICK_M,
    SHIFT_M,
    TURN_RAD,
)
from lemma.evaluation.protocol.suites import lists_of, other_suites, sha256_of
from lemma.evaluation.records import (
    POSE_TOLERANCE_MM,
    PROTOCOL_VERSION,
    RESULT_VERSION,
)
from lemma.motion.outcome import REFUSED, Outcome
from lemma.scene.build import TICK_S, TIME_STEP_S
from lemma.scene.coasting import COAST_M, FLIGHT_S
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.pad import PAD
from lemma.scene.raster import RASTER
from lemma.tasks.goal import REST_M_S, REST_RAD_S, TILT_RAD
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.language.blind import author_sha256
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE

PROTOCOL = "protocol.json"
"""File in the package."""
NAME = "lemma-v3"
REFUSAL_S = 5.0
"""Smallest simulated duration of a sub-task that its robot cannot do [s]: the time of
the motion to the grasp and back. The expert's fingers close 2.2 s after the start of a
sub-task (1.7 to 2.9 s in 30 sub-tasks)."""
GROUP = 10
"""Number of episodes that are played together."""


@cache
def in_force() -> dict[str, Any]:
    """Return the protocol that an evaluation follows here and now."""
    return {
        "name": NAME,
        "version": PROTOCOL_VERSION,
        "benchmark": BENCHMARK_VERSION,
        "tasks": list(SUITE),
        "episodes_per_task": dict(SPLITS),
        "lists_sha256": lists_of(SUITE),
        "instructions": {
            "kinds": list(EVALUATION_KINDS),
            "source": "the frozen lists: one sentence of each kind per instance; blind "
            "ones are drawn by the key of the instance",
            "blind_sha256": author_sha256(),
            "language": dict(LANGUAGES),
        },
        "episode": {
            "horizon_s": HORIZON_S,
            "least_step_s": LEAST_STEP_S,
            "end": "the policy says stop, fails itself, something is thrown, or the "
            "horizon is reached",
            "thrown": {"coast_m": COAST_M, "flight_s": FLIGHT_S},
            "look_ticks": LOOK_TICKS,
            # On tables of the paper's suite nothing is too heavy for a robot.
            "refused": sorted(REFUSED - {Outcome.OVERLOAD}),
            "strict": "also the first refused sub-task ends it: protective_stop",
            "lenient": "the policy is told what was refused, and goes on",
            "refusal_s": REFUSAL_S,
            "group": GROUP,
        },
        "success": _success(),
        "view": {
            "rows": RASTER.rows,
            "columns": RASTER.columns,
            "cell_m": RASTER.cell_m,
        },
        "perturbed_start": {
            "shift_m": SHIFT_M,
            "turn_rad": round(TURN_RAD, 6),
            "apart_m": APART_M,
            "from_stick_m": FROM_STICK_M,
        },
        "diagnosis": {"pose_tolerance_mm": POSE_TOLERANCE_MM},
        "expert_times_sha256": times_sha256(),
        "physics": {
            "mujoco": version("mujoco"),
            "time_step_s": TIME_STEP_S,
            "servo_tick_s": TICK_S,
        },
        "results": RESULT_VERSION,
    }


def _success() -> dict[str, Any]:
    """Return the criteria of success."""
    return {
        "judged": "when the robots have stood still after the end of the episode",
        "still_s": STILL_S,
        "holds": "every On of the goal, and no gripper holds anything",
        "on": "the bottom alone carries the top, by contact; both level, at rest",
        "on_pad_m": round(PAD.support_m or 0.0, 6),
        "on_cube_m": CUBE.support_m,
        "rest_m_s": REST_M_S,
        "rest_rad_s": REST_RAD_S,
        "tilt_rad": round(TILT_RAD, 6),
    }


@cache
def frozen() -> dict[str, Any]:
    """Return the protocol in the package."""
    text = (files("lemma.evaluation.protocol") / PROTOCOL).read_text("utf-8")
    protocol: dict[str, Any] = json.loads(text)
    return protocol


def quote() -> str:
    """Return the hash of the protocol in force, which results quote."""
    return sha256_of(in_force())


def deviations() -> list[str]:
    """Return the differences of the protocol in force from the one in the package.

    Usually there are none; a common cause is another release of MuJoCo.
    """
    ours, theirs = dict(flat(in_force())), dict(flat(frozen()))
    return [
        f"{name} {ours.get(name)} instead of {theirs.get(name)}"
        for name in sorted({*ours, *theirs})
        if ours.get(name) != theirs.get(name)
    ]


def check_protocol(
    about: Mapping[str, Any], other: Mapping[str, Any], where: object, there: object
) -> None:
    """Check that two results follow one protocol.

    Args:
        about: Settings of one result, as in ``about.json``.
        other: Settings of the other result.
        where: Path or description of the first result.
        there: Path or description of the other result.

    Raises:
        DatasetError: Their protocols or lists differ.
    """
    mine, others = about.get("protocol"), other.get("protocol")
    if mine != others:
        raise DatasetError(
            f"{where} follows protocol {_short(mine)}, and {there} follows "
            f"{_short(others)}, so they cannot be compared. Evaluate one of them again "
            "with the version of the other; this installation follows "
            f"{_short(quote())} ({NAME})."
        )
    for suite in other_suites(about, other.get("suites", {})):
        raise DatasetError(
            f"{where} and {there} have different lists of the suite {suite!r}. "
            "Evaluate one of them again with the version of the other."
        )


def _short(sha256: object) -> str:
    return "none" if sha256 is None else str(sha256)[:12]
