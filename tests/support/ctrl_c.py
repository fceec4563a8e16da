"""Children that hear Ctrl-C, also where the tests themselves do not."""

import signal


def hear() -> None:
    """Undo what a shell does to background jobs: it has them ignore SIGINT.

    For ``preexec_fn`` of a subprocess.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
