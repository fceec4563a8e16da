"""Checks that this installation reproduces published results.

A fixed sample of each level is played and compared with published lines.
"""

import json
from collections.abc import Callable, Iterator
from functools import partial
from importlib.resources import files

import numpy as np
from gymnasium.spaces import Box
from gymnasium.wrappers import RescaleAction

from lemma.bench.checks import Check
from lemma.core.errors import LemmaError
from lemma.core.files import temporary_folder
from lemma.core.seeding import stream
from lemma.core.workers.pool import Serial
from lemma.env.config import EnvConfig
from lemma.env.control.modes import CONTROLS
from lemma.env.control_env import ControlEnv
from lemma.env.learning.flat_view import FlatView
from lemma.evaluation.experiments.reproduction import compared
from lemma.evaluation.protocol.rules import NAME, deviations
from lemma.evaluation.records import Row, key_of
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.control import load_player
from lemma.evaluation.run.evaluate import evaluate, start_of
from lemma.evaluation.run.replay import decision_of, differences, play_again
from lemma.evaluation.run.rollout import Player
from lemma.policies.spec import CONTROL, ORACLE, PolicySpec

NETWORK = "reachnet"
"""Published weights whose decisions are compared."""
ROUND_TRIP = 1e-6
"""Largest error of an action after normalisation and its inverse, as a share of its
range."""
_ACTIONS = 100


def check_evaluation() -> Iterator[Check]:
    """Yield the results of the checks; none of them raises."""
    yield _attempt("protocol", _protocol)
    yield _attempt("actions, normalised and back", _round_trip)
    yield _attempt("published decisions", _decisions)
    yield _attempt("skill level: the expert", partial(_expert, PolicySpec(ORACLE)))
    controlling = PolicySpec(ORACLE, level=CONTROL)
    yield _attempt("control level: the expert", partial(_expert, controlling))
    yield _attempt(f"plan and poses: {NETWORK}", _network, essential=False)


def published_sample() -> dict[str, list[Row]]:
    """Return some published lines by policy, from the package."""
    text = (files("lemma.bench") / "published.json").read_text("utf-8")
    found: dict[str, list[Row]] = json.loads(text)
    return found


def _attempt(
    name: str, question: Callable[[], tuple[bool, str]], *, essential: bool = True
) -> Check:
    try:
        ok, found = question()
    except ImportError as error:
        advice = "Install the extra 'learn', which brings torch."
        return Check(name, False, f"not checked: {error}", advice, essential=False)
    except LemmaError as error:
        return Check(name, False, f"not checked: {error}", essential=essential)
    advice = "Results of this installation are not comparable."
    if not essential:
        advice = "Another renderer moves a network's poses: docs/determinism.md."
    return Check(name, ok, found, "" if ok else advice, essential=essential)


def _protocol() -> tuple[bool, str]:
    found = deviations()
    return not found, "; ".join(found) or f"{NAME}, as it ships"


def _round_trip() -> tuple[bool, str]:
    """Rescale random actions of every control mode to [-1, 1] and back."""
    worst, where = 0.0, ""
    for mode in CONTROLS:
        config = EnvConfig(task="pass", control=mode, observation="state")
        env = FlatView(ControlEnv(config))
        box = env.action_space
        assert isinstance(box, Box)
        if not np.isfinite([box.low, box.high]).all():
            continue
        rescaled = RescaleAction(env, np.float32(-1.0), np.float32(1.0))
        rng = stream("round trip of actions", mode)
        drawn = rng.uniform(-1.0, 1.0, (_ACTIONS, *box.shape)).astype(np.float32)
        actions = np.array([rescaled.action(one) for one in drawn])
        middle, half = 0.5 * (box.high + box.low), 0.5 * (box.high - box.low)
        off = float(np.abs((actions - middle) / half - drawn).max())
        if off > worst:
            worst, where = off, mode
        env.close()
    return worst <= ROUND_TRIP, f"off by {worst:.1e} at most, in {where or 'no mode'}"


def _decisions() -> tuple[bool, str]:
    """Play published decisions again; everything must be equal to the bit."""
    rows = published_sample()[NETWORK]
    for row in rows:
        again = play_again(row, start_of(row), {"horizon_s": 100.0})
        for difference in differences(row, again):
            return False, f"{'/'.join(map(str, key_of(row)))}: {difference}"
    return True, f"{len(rows)} episodes, equal to the published lines to the bit"


def _expert(spec: PolicySpec) -> tuple[bool, str]:
    """Play episodes of the expert; all must be equal to the bit."""
    lines = published_sample()[spec.level or spec.name]
    pairs = [(line, _played(spec, line)) for line in lines]
    found = [one for line, now in pairs for one in differences(line, now)]
    summary = f"{len(pairs)} episodes, equal to the published lines to the bit"
    return bool(pairs) and not found, found[0] if found else summary


def _network() -> tuple[bool, str]:
    """Compare a network's decisions with published ones, in the published states.

    In an episode of its own, poses that differ by 0.1 mm would lead to other states,
    and these to larger differences of the poses.
    """
    player = load_player(PolicySpec(NETWORK))
    pairs = [(line, _asked(player, line)) for line in published_sample()[NETWORK]]
    agreement = compared(pairs)
    summary = (
        f"the decisions of {agreement.episodes} episodes, as published; poses within"
    )
    if agreement.ok:
        return True, f"{summary} {1e3 * agreement.farthest_m:.2f} mm"
    return False, "; ".join(agreement.differing)


def _asked(player: Player, line: Row) -> Row:
    """Return a line with a policy's decisions in the states of that line."""
    rollout = player.begin(start_of(line), line["instruction_kind"])
    found = []
    for step in line["subtasks"]:
        policy_input = player.policy_input(rollout)
        (now,) = player.policy.act([policy_input])
        poses = now.grounded.to_dict() if now.grounded else None
        found.append({**step, **now.subtask.to_dict(), "grounded": poses})
        rollout.carry_out(policy_input, decision_of(step))
    return {**line, "subtasks": found}


def _played(spec: PolicySpec, line: Row) -> Row:
    with temporary_folder() as folder:
        config = EvaluationConfig(
            out=folder,
            policy=spec,
            tasks=(line["task"],),
            split=line["split"],
            kinds=(line["instruction_kind"],),
            episodes=line["index"] + 1,
        )
        return evaluate(config, Serial())[line["index"]]
