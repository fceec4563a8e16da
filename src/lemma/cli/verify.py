"""`lemma verify`: replay of a result's decisions without its policy."""

from typing import Annotated

import tyro
from rich.text import Text

from lemma.cli.options import JsonFlag, Number, Results, output, print_json
from lemma.cli.workers import DEFAULT, WorkerOptions, progress_bar
from lemma.core.errors import InvalidConfigError

_AT_INTERRUPT = "{done} episodes were played again; nothing is saved."


def verify(
    results: Results,
    episodes: Number = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    working: WorkerOptions = DEFAULT,
    as_json: JsonFlag = False,
) -> int:
    """Play the recorded decisions of results again, and compare everything recorded.

    Needs no policy, weights or OpenGL. Outcomes, times and states must be equal to the
    bit. It cannot check that the named policy made the decisions. Exits with 1 if a
    result is refused.

    Args:
        results: Results of lemma evaluate or lemma reproduce, with their lines: files,
            or folders that contain some at any depth.
        episodes: Number of episodes of each task and kind of instruction, drawn at
            random; all by default.
        seed: Seed of the random draw of episodes.
        working: Options of the workers.
        as_json: Print one JSON object instead of text.
    """
    # Import late, so that help is fast.
    from lemma.evaluation.verification import copies, results_in
    from lemma.evaluation.verification import verify as run

    if not results:
        raise InvalidConfigError("Name a result, such as results/reachnet/seed-0.json.")
    if episodes is not None and episodes < 1:
        raise InvalidConfigError(f"--episodes is 1 or more, not {episodes}.")
    engine = working.make_engine()
    files = results_in(results)
    found = []
    with progress_bar("verify", None, _AT_INTERRUPT) as advance:
        for lines in files:
            found.append(run(lines, engine, episodes, seed, advance))
    found = copies(found)
    if as_json:
        print_json({"results": [one.to_dict() for one in found]})
        return int(not all(one.ok for one in found))
    for one in found:
        text = Text("stands" if one.ok else "REFUSED", "green" if one.ok else "red")
        text.append(f"  {one.lines}", "default")
        if one.played:
            extent = "the whole test split" if one.complete else "part of a split"
            text.append(f": {one.played:,} of its {one.episodes:,} episodes ({extent})")
        if one.knows_truth:
            text.append(", with a policy that uses privileged state")
        for problem in one.problems:
            text.append(f"\n  {problem}")
        output().print(text, soft_wrap=True)
    return int(not all(one.ok for one in found))
