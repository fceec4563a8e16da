"""Compile the numerical kernels before the tests need them.

    python scripts/compile_kernels.py

It runs everything with kernels for a short time: every control mode, an episode of a
task, four robots at once, and images. Numba caches the code beside the sources.
"""

from tempfile import TemporaryDirectory

import lemma
from lemma.bench.states import fast_cases, hash_case
from lemma.cli.main import main
from lemma.core.errors import RenderingError

PLAYED = (("lemma", "hook"), ("teams", "carousel"))
"""Suite and task of each episode."""
OBSERVATIONS = ("rgbd", "map")


def compile_kernels() -> None:
    """Run the kernels; errors are left to the tests, which report more about them."""
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
        print("No renderer works here, so kernels for images are compiled later.")


def look() -> None:
    """Take one control step with each kind of image."""
    for observation in OBSERVATIONS:
        env = lemma.make("hook", observation=observation)
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.close()


if __name__ == "__main__":
    compile_kernels()
