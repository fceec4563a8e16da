"""Verification of results by executing their recorded decisions again.

The simulator is deterministic, and lines have every sub-task with its poses. So the
outcome of an episode can be computed without the policy, and a line with a changed
outcome differs. The verification proves the outcome of the decisions, but not which
policy made them.
"""

import random
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import msgspec

from lemma.core.errors import DatasetError, LemmaError
from lemma.core.workers.pool import Engine
from lemma.env.simulation import HORIZON_S
from lemma.evaluation.analysis.result import Result, check_lines, read_result
from lemma.evaluation.experiments.catalog import EXPERIMENTS
from lemma.evaluation.lines import lines_at, lines_in, read_lines, result_beside
from lemma.evaluation.protocol.rules import GROUP, NAME, quote
from lemma.evaluation.protocol.suites import other_suites, quote_suites
from lemma.evaluation.records import SUMMARY, Row, check_about, key_of, read_about
from lemma.evaluation.run.config import VERDICTS
from lemma.evaluation.run.evaluate import start_of
from lemma.evaluation.run.loading import learned_parts
from lemma.evaluation.run.replay import differences, play_again
from lemma.policies.class_path import privileged
from lemma.policies.planners.registry import is_planner
from lemma.policies.spec import CONTROL, ORACLE, TOGETHER, parts_of
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.suite import SUITE

_MOST_NAMED = 5
_MOST_PER_EPISODE = 3
_SAME = ("benchmark", "split", "perturb_start")
"""Fields that lines share with the settings of their result."""
_MOST_SUMMARY_MB = 10.0
"""Largest size of the files beside the lines; those of a published result have 0.03
MB."""


@dataclass(frozen=True)
class Verification:
    """Outcome of the verification of a result."""

    lines: Path
    """The file of its episodes."""
    problems: tuple[str, ...]
    """Sentences about all problems; empty if the result is verified."""
    episodes: int = 0
    """Number of its episodes."""
    played: int = 0
    """Number of episodes that were executed again."""
    complete: bool = False
    """Whether it has all test episodes of the suite, with its kinds of instructions."""
    knows_truth: bool = False
    """Whether its policy has an oracle or ground-truth allocation."""
    digest: str = ""
    """SHA-256 of its lines, from its summary."""
    policy: str = ""

    @property
    def ok(self) -> bool:
        """Whether the result is verified."""
        return not self.problems

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        fields = {
            name: value for name, value in asdict(self).items() if name != "digest"
        }
        return {**fields, "lines": str(self.lines), "ok": self.ok}


@dataclass(frozen=True)
class Claim:
    """The content of a result before its verification."""

    lines: Path
    about: Mapping[str, Any]
    rows: Sequence[Row]
    result: Result | None

    @classmethod
    def read(cls, lines: Path) -> "Claim":
        """Read a result.

        Args:
            lines: The file of its episodes.

        Raises:
            DatasetError: A file is missing, damaged or too large, or the summary does
                not match the lines.
        """
        path = result_beside(lines)
        beside = (path, lines.with_name("about.json"))
        for file in filter(Path.is_file, beside):
            if file.stat().st_size > _MOST_SUMMARY_MB * 1e6:
                raise DatasetError(f"{file} is larger than {_MOST_SUMMARY_MB:g} MB.")
        about = read_about(lines)
        check_about(about, lines)
        rows = read_lines(lines)
        result = read_result(path) if path.is_file() else None
        if result is not None:
            check_lines(result, rows, path, lines)
            if path.name == SUMMARY and result.about != about:
                raise DatasetError(f"{path} is about another policy than about.json.")
        return cls(lines, about, rows, result)

    @property
    def knows_truth(self) -> bool:
        """Whether the policy may have an oracle or ground-truth allocation.

        This includes every class that ran in the process of the simulator.
        """
        policy = self.about["policy"]
        beside = ":" in policy["name"] and policy.get("timeout_s") == 0.0
        return bool(self.about.get("oracle")) or beside or _says_oracle(policy)

    @property
    def complete(self) -> bool:
        """Whether the result has all test episodes of the suite, with some kinds."""
        counted = Counter(key_of(row)[:2] for row in self.rows)
        kinds = {kind for kind, _ in counted}
        whole = {(kind, task): SPLITS["test"] for kind in kinds for task in SUITE}
        plain = self.about["split"] == "test" and self.about["language"] == "full"
        moved = self.about.get("perturb_start") or self.about.get("disturb")
        return plain and counted == whole and not moved

    def problems(self) -> Iterator[str]:
        """Yield a sentence for each contradiction, without executing episodes."""
        about, policy = self.about, self.about["policy"]
        if about["protocol"] != quote():
            yield (
                f"It follows protocol {about['protocol'][:12]}, but this installation "
                f"follows {quote()[:12]} ({NAME})."
            )
        here = quote_suites(row["task"] for row in self.rows)
        for suite in other_suites(about, here):
            yield f"Its lists of the suite {suite!r} differ from the installed ones."
        if about["benchmark"] != BENCHMARK_VERSION or about["horizon_s"] != HORIZON_S:
            yield "Its benchmark version or horizon differs from this installation's."
        if _says_oracle(policy) and not about.get("oracle"):
            yield f"{policy['name']} knows the truth, but is not marked as an oracle."
        unnamed = [part for part in learned_parts(policy["name"]) if part]
        if unnamed and not about["weights"]:
            yield f"It lists no weights of {', '.join(unnamed)}."
        if self.result is not None:
            yield from self._of_command(self.result)
        yield from self._of_lines()

    def _of_command(self, result: Result) -> Iterator[str]:
        policy = dict(self.about["policy"])
        if ("--gta" in result.command.split()) > policy["gta"]:
            yield "Its command has ground-truth allocation, but its settings do not."
        experiment = EXPERIMENTS.get(result.experiment)
        said = (policy, self.about["language"], self.about["perturb_start"])
        if experiment is not None and said != experiment.decides:
            yield f"Its policy is not that of the experiment {experiment.name}."

    def _of_lines(self) -> Iterator[str]:
        about = self.about
        control = _level(about["policy"]) == CONTROL
        own = {name: about.get(name, False) for name in _SAME}
        lenient = about["verdicts"] == VERDICTS[0]
        together = about["policy"].get("acting") == TOGETHER
        knows = bool(about.get("oracle"))
        for row in self.rows:
            odd = [name for name, value in own.items() if row[name] != value]
            commands = row.get("control") is not None
            team = row.get("together")
            if odd:
                yield f"{_named(row)} has another {odd[0]} than the result."
            elif (row["lenient"] is not None) != lenient:
                yield f"{_named(row)} has other verdicts than the result."
            elif (team is not None) != together:
                yield f"{_named(row)} has another way of acting than the result."
            elif team is not None and team["expert_poses"] > knows:
                yield f"{_named(row)} has the expert's poses, but is not an oracle's."
            elif control and not commands:
                yield f"{_named(row)} has no motor commands, but the result has."
            elif commands and not control:
                yield f"{_named(row)} is of control level, but the result is not."
            else:
                continue
            return
        if control:
            yield (
                "Motor commands are not in the lines, so results at control level "
                "cannot be verified."
            )


def _level(policy: Mapping[str, Any]) -> str:
    if policy["name"].startswith(("lerobot:", "lerobot-privileged:", "vla-eval://")):
        return CONTROL
    return str(policy.get("level", ""))


def _says_oracle(policy: Mapping[str, Any]) -> bool:
    """Return whether the name or the options of a policy imply privileged state."""
    name = policy["name"]
    alone = "+" not in name and "://" not in name and is_planner(name)
    parts = parts_of(name)
    knows_truth = policy["gta"] or alone
    return knows_truth or any(part == ORACLE or privileged(part) for part in parts)


def _named(row: Row) -> str:
    return "Episode " + "/".join(map(str, key_of(row)))


def results_in(paths: Sequence[Path]) -> list[Path]:
    """Return the files of episodes at some paths, without duplicates.

    Raises:
        DatasetError: A path has no episodes.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        for lines in lines_in(path) or [lines_at(path)]:
            found.setdefault(lines.resolve(), lines)
    return list(found.values())


def verify(
    lines: Path,
    engine: Engine,
    episodes: int | None = None,
    seed: int = 0,
    advance: Callable[[int], None] = lambda count: None,
) -> Verification:
    """Execute the decisions of a result again, and compare the lines.

    Outcomes, times, poses' errors and hashes of states must be equal to the bit. Faults
    of the policy, the effort of its decisions, and explanations are not compared.

    Args:
        lines: The file of its episodes.
        engine: Workers that run the jobs.
        episodes: Number of episodes of each task and kind, drawn at random; all if
            None.
        seed: Seed of the draw.
        advance: Called with the number of episodes played since the last call.
    """
    try:
        claim = Claim.read(lines)
        problems = list(islice(claim.problems(), _MOST_NAMED))
    except (DatasetError, msgspec.ValidationError) as error:
        return Verification(lines, (str(error),))
    chosen = [] if problems else _drawn(claim.rows, episodes, seed)
    jobs = [
        (dict(claim.about), tuple(chosen[start : start + GROUP]))
        for start in range(0, len(chosen), GROUP)
    ]
    differing: list[str] = []
    for found in engine.run(check_episodes, jobs):
        differing += [difference for difference in found if difference]
        advance(len(found))
    problems += differing[:_MOST_NAMED]
    if len(differing) > _MOST_NAMED:
        problems.append(f"In total {len(differing)} of {len(chosen)} episodes differ.")
    return Verification(
        lines,
        tuple(problems),
        len(claim.rows),
        len(chosen),
        claim.complete,
        claim.knows_truth,
        claim.result.episodes_sha256 if claim.result else "",
        claim.about["policy"]["name"],
    )


def copies(found: Sequence[Verification]) -> list[Verification]:
    """Return results; those with the same lines as an earlier policy's fail."""
    first: dict[str, Verification] = {}
    checked = []
    for one in found:
        other = first.setdefault(one.digest or str(one.lines), one)
        if other.policy != one.policy:
            problem = f"Its lines are those of {other.policy} in {other.lines}."
            one = replace(one, problems=(*one.problems, problem))
        checked.append(one)
    return checked


def _drawn(rows: Sequence[Row], episodes: int | None, seed: int) -> list[Row]:
    if episodes is None:
        return list(rows)
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault(key_of(row)[:2], []).append(row)
    draw = random.Random(seed)
    drawn = (draw.sample(each, min(episodes, len(each))) for each in groups.values())
    return list(chain.from_iterable(drawn))


def check_episodes(about: Mapping[str, Any], rows: Sequence[Row]) -> list[str]:
    """Execute episodes again; return the differences of each, ``""`` for none."""
    return [_check(about, row) for row in rows]


def _check(about: Mapping[str, Any], row: Row) -> str:
    try:
        instance = start_of(row, about)
        if (row["task"], row["index"]) != (instance.task, instance.index):
            return f"{_named(row)} does not match its instance."
        played = play_again(row, instance, about)
        again = msgspec.json.decode(msgspec.json.encode(played))
    except (LemmaError, ValueError) as error:
        return f"{_named(row)} cannot be played: {error}"
    found = list(islice(differences(row, again), _MOST_PER_EPISODE))
    return f"{_named(row)}: {'; '.join(found)}." if found else ""
