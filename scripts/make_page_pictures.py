"""Make the documentation's pictures of `lemma play`, in a headless Chromium.

    .venv/bin/python scripts/make_page_pictures.py docs/images [NAME ...]

Each is a page as a visitor sees it, at a frozen instance of the test split.
"""

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from browser import Page as Browser
from browser import page_in_chromium
from looked_at import seen_at, until

from lemma.core.poses import Pose2
from lemma.viewer.episode.request import EpisodeRequest
from lemma.viewer.episode.session import Session
from lemma.viewer.episode.status import Phase
from lemma.viewer.failures import FailurePage
from lemma.viewer.page import Page
from lemma.viewer.recording.sources import cases_in
from lemma.viewer.scene.pictures import MAP
from lemma.viewer.server import open_server

RESULTS = Path(__file__).parents[1] / "results"
HOST, PORT = "127.0.0.1", 18280
SETTLES_S = 3.0
"""For how long browsers draw on after the last change [s]."""
LATER_S = 3.0
"""Simulated time in the picture of a failure [s]."""
COLORS = 256
DESK, PHONE = (1100, 640), (390, 760)
_CANVAS = "document.querySelector('canvas').getBoundingClientRect()"
_INNER = "document.querySelector('.replay iframe').contentDocument"
_NO_NOTICES = (
    "document.querySelectorAll('.mantine-Notification-root')"
    ".forEach(notice => notice.remove()); 0"
)
_SCROLL = (
    "[...document.querySelectorAll('*')]"
    ".filter(one => one.textContent.trim() == {!r})"
    ".pop().scrollIntoView({{block: 'start'}}); 0"
)


@dataclass(frozen=True)
class Shot:
    """One picture."""

    request: EpisodeRequest
    show: Callable[[Page, Browser], None]
    """Does what a visitor would."""
    size: tuple[int, int] = DESK
    """Of the window [px]."""
    scroll_to: str = ""
    """Words that the panel is scrolled to; it is not scrolled if empty."""
    overlays: tuple[str, ...] = ("names",)


def play_until(page: Page, time_s: float, then: Callable[[], None]) -> None:
    """Act at real time up to a moment, and do something there."""
    page.panel.act()
    until(lambda: page.session.play.transport.cursor_s >= time_s)
    then()


def pause_at(time_s: float) -> Callable[[Page, Browser], None]:
    """Return what acts, and pauses at a time [s]."""

    def show(page: Page, browser: Browser) -> None:
        play_until(page, time_s, lambda: page.session.play.transport.pause())

    return show


def take_over(page: Page, browser: Browser) -> None:
    """Take over in the middle of the second sub-task."""
    play_until(page, 6.8, page.panel.teleoperation.take_over)
    until(lambda: page.session.play.transport.cursor_s > 8.0)
    page.session.play.transport.pause()


def change_table(page: Page, browser: Browser) -> None:
    """Drag the red cube to where it should not lie, and click it."""
    page.session.move("red_cube", Pose2(0.1, 0.35, 0.3))
    until(lambda: page.session.play.status.phase is Phase.READY)
    time.sleep(SETTLES_S)
    (visitor,) = page.visitors()
    size = browser.run(f"[{_CANVAS}.width, {_CANVAS}.height]")
    at = seen_at(visitor, (0.1, 0.35, 0.03), size)
    browser.drag(at, at)


def show_map(page: Page, browser: Browser) -> None:
    """Show the map in the panel."""
    page.panel.picture.value = MAP


STACK = EpisodeRequest("stack", "test", 0)
HOOKS = EpisodeRequest("hook_stack", "test", 3)
POKES = EpisodeRequest("poke_stack", "test", 2, "human")
SHOTS = {
    "play": Shot(POKES, pause_at(13.6), (1280, 760), overlays=("names", "reach")),
    "play_table": Shot(STACK, change_table, scroll_to="Table"),
    "play_by_hand": Shot(STACK, take_over, scroll_to="Episode"),
    "play_reach": Shot(HOOKS, show_map, scroll_to="Table", overlays=("names", "reach")),
    "play_why": Shot(
        replace(STACK, policy="reachnet"),
        pause_at(7.5),
        scroll_to="Speed",
        overlays=("names", "perceived", "path"),
    ),
    "play_phone": Shot(HOOKS, lambda page, browser: None, PHONE),
}
FAILURES = "failures"


@contextmanager
def running(page: Page | FailurePage) -> Iterator[None]:
    """Let a page go on, and close it afterwards."""
    loop = threading.Thread(target=page.run)
    loop.start()
    try:
        yield
    finally:
        page.close()
        loop.join()


def take(browser: Browser, path: Path, scroll_to: str = "") -> None:
    """Save what is seen."""
    if scroll_to:
        browser.run(_SCROLL.format(scroll_to))
    browser.run(_NO_NOTICES)
    time.sleep(SETTLES_S)
    with TemporaryDirectory() as folder:
        found = Path(folder) / "found.png"
        browser.screenshot(found)
        image = Image.open(BytesIO(found.read_bytes())).convert("RGB")
    image.quantize(COLORS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def shoot(shot: Shot, browser: Browser, path: Path) -> None:
    """Open a page, do what a visitor would, and save what is seen."""
    page = Page(Session(shot.request, ("oracle", "reachnet")), open_server(HOST, PORT))
    with running(page):
        browser.resize(*shot.size)
        browser.open(page.address)
        browser.wait_for("document.body.innerText.includes('Ready')")
        for name, box in page.panel.overlays.items():
            box.value = name in shot.overlays
        # The scene fades in.
        time.sleep(SETTLES_S)
        shot.show(page, browser)
        take(browser, path, shot.scroll_to)


def shoot_failures(browser: Browser, path: Path) -> None:
    """Open a failure of a result that ships, and save what is seen."""
    cases = cases_in(RESULTS / "et-cliport-single-step")
    page = FailurePage(cases, HOST, PORT)
    with running(page):
        browser.resize(1240, 900)
        browser.open(f"{page.address}/#failures?task=stack")
        browser.wait_for("document.querySelector('.case .replay button')")
        browser.run("document.querySelector('.case .replay button').click()")
        browser.wait_for(f"{_INNER}?.body?.dataset.at > {LATER_S}")
        # The scene fades in, slowly where software draws it.
        time.sleep(4.0 * SETTLES_S)
        browser.run("document.querySelector('.case').scrollIntoView(); 0")
        take(browser, path)


def main(folder: Path, names: Sequence[str] = ()) -> None:
    """Write pictures into a folder: all, or those that are named."""
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as place, page_in_chromium(Path(place)) as browser:
        for name in names or (*SHOTS, FAILURES):
            path = folder / f"{name}.png"
            if name == FAILURES:
                shoot_failures(browser, path)
            else:
                shoot(SHOTS[name], browser, path)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(f"{__doc__}\nPictures: {', '.join((*SHOTS, FAILURES))}")
    main(Path(sys.argv[1]), sys.argv[2:])
