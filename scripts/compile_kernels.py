"""Compile the numerical kernels now, so that the tests do not wait for them.

    python scripts/compile_kernels.py

Plays a little of whatever uses kernels of its own: every mode of control, an episode of
a task, four robots at once, and pictures. Numba keeps the code beside the sources.
"""

from tempfile import TemporaryDirectory

import lemma
from lemma.bench.states import fast_cases, hash_case
from lemma.cli.main import main
from lemma.core.errors import RenderingError

PLAYED = (("lemma", "hook"), ("teams", "carousel"))
"""Suites and tasks."""
OBSERVATIONS = ("rgbd", "map")


def compile_kernels() -> None:
    """Play; what fails here fails in the tests, which say more about it."""
    for case in fast_cases():
        hash_case(case)
    for suite, task in PLAYED:
        with TemporaryDirectory() as out:
            words = f"evaluate --suite {suite} --tasks {task} --episodes 1 --workers 1"
            try:
                main([*words.split(), "--policy", "oracle", "--out", out])
            except SystemExit as end:
                if end.code:
                    raise
    try:
        look()
    except RenderingError:
        print("Nothing renders here, so kernels for pictures are compiled later.")


def look() -> None:
    """Take one control step with each kind of picture."""
    for observation in OBSERVATIONS:
        env = lemma.make("hook", observation=observation)
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.close()


if __name__ == "__main__":
    compile_kernels()
