"""From a recipe to a LeRobotDataset v3.0: videos, states and actions for everyone.

Every episode is first filmed into a part of its own, whole or not at all, by as many
workers as there are. When all parts are there, they are put together in order: videos
are joined without encoding anything anew. ``meta/info.json`` comes last. A run that was
killed loses what was being worked on; the next one goes on there, and the result is the
same bytes.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from shutil import rmtree
from time import perf_counter

import av

from lemma.core.errors import DatasetError
from lemma.core.parallel import Engine
from lemma.dataset.files import (
    check_files,
    clear_drafts,
    only_writer,
    open_table,
    read_json,
    sha256_of,
    versions,
    write_json,
)
from lemma.dataset.instructions import check_recorded
from lemma.dataset.lerobot.assembly import assemble, name_in_recipe
from lemma.dataset.lerobot.episode import Source, is_whole, write_part
from lemma.dataset.lerobot.layout import EXTRAS, INFO, Style
from lemma.dataset.lerobot.video import DEPTH, RGB
from lemma.dataset.recipe.replay import check_versions
from lemma.dataset.recipe.schema import perturbed_as
from lemma.dataset.rendered.render import (
    RenderConfig,
    RenderSummary,
    check_made_alike,
    refusal,
)
from lemma.scene.rendering.gl_backend import choose_backend
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.names import task_rank

_PARTS = ".parts"
_EXPORT = f"{EXTRAS}/export.json"


@dataclass(frozen=True, kw_only=True)
class LeRobotConfig:
    """What to export."""

    source: RenderConfig
    """Which episodes of which recipe, and the folder to write."""
    style: Style = field(default_factory=Style)
    """How to film them."""

    @property
    def out(self) -> Path:
        """Folder of the data set."""
        return self.source.out

    def sources(self) -> list[Source]:
        """Return the episodes: training first, tasks in the order of the suite.

        Raises:
            DatasetError: There is no recipe.
            UnknownNameError: It has no such task or split.
        """
        groups = sorted(self.source.groups(), key=lambda group: _rank(*group[:2]))
        return [
            Source(path, group, row) for path, group, rows in groups for row in rows
        ]

    def part(self, number: int) -> Path:
        """Return where an episode is until all are there."""
        return self.out / _PARTS / f"{number:06d}"


def _rank(path: Path, group: int) -> tuple[int, tuple[int, str], str, int]:
    splits = list(SPLITS)
    split, task = path.parent.name, path.stem
    return (
        splits.index(split) if split in splits else len(splits),
        task_rank(task),
        path.as_posix(),
        group,
    )


def write_dataset(
    order: LeRobotConfig,
    engine: Engine,
    advance: Callable[[int], None] = lambda count: None,
) -> RenderSummary:
    """Write what is missing of a LeRobotDataset.

    Args:
        order: What is wanted.
        engine: Where to work.
        advance: Told how many episodes were there at the beginning, and then of every
            one that is done.

    Returns:
        What it came to.

    Raises:
        DatasetError: The recipe cannot be read here, what is there was made from
            another one or otherwise, something cannot be written, or sentences that
            are held out would be those of training.
        UnknownNameError: The recipe has no such task or split.
        RenderingError: OpenGL does not work here.
    """
    start = perf_counter()
    RGB.check()
    if order.style.depth:
        DEPTH.check()
    sources = order.sources()
    files = list(dict.fromkeys(source.path for source in sources))
    check_recorded(order.style.instruction, [path.parent.name for path in files])
    for path in files:
        found = open_table(path)[1]
        check_versions(found)
        if perturbed_as(found):
            raise DatasetError(refusal(order.source.recipe, "lerobot"))
    check_files(order.source.recipe, partial=True)
    with only_writer(order.out):
        clear_drafts(order.out)
        _begin(order, files)
        made = 0
        if (order.out / INFO).exists():
            advance(len(sources))
        else:
            made = _film(order, sources, engine, advance)
            parts = [order.part(number) for number in range(len(sources))]
            assemble(order.out, order.style, parts, files)
        rmtree(order.out / _PARTS, ignore_errors=True)
    frames = read_json(order.out / INFO)["total_frames"]
    size = sum(path.stat().st_size for path in order.out.rglob("*") if path.is_file())
    return RenderSummary(len(sources), frames, made, perf_counter() - start, size / 1e6)


def _begin(order: LeRobotConfig, files: Sequence[Path]) -> None:
    """Note what is written into the folder, or check that it is the same.

    Raises:
        DatasetError: Something else was begun there.
    """
    about = {
        "form": "lerobot",
        "versions": {**versions(BENCHMARK_VERSION), "av": av.__version__},
        "renderer": choose_backend().renderer,
        **asdict(order.style),
        "recipe": {name_in_recipe(path): sha256_of(path) for path in files},
    }
    path = order.out / _EXPORT
    if path.exists():
        check_made_alike(order.out, read_json(path), about)
    elif any(not name.name.startswith(".") for name in order.out.iterdir()):
        raise DatasetError(
            f"{order.out} holds something that this export did not begin. Choose a new "
            "folder, or delete this one."
        )
    else:
        write_json(path, about)


def _film(
    order: LeRobotConfig,
    sources: Sequence[Source],
    engine: Engine,
    advance: Callable[[int], None],
) -> int:
    """Film the episodes that are not there yet; return how many."""
    missing = [
        # Absolute, because a worker may be at home elsewhere.
        (
            replace(source, path=source.path.absolute()),
            order.part(number).absolute(),
            order.style,
        )
        for number, source in enumerate(sources)
        if not is_whole(order.part(number))
    ]
    advance(len(sources) - len(missing))
    for episodes in engine.run(write_part, missing):
        advance(episodes)
    return len(missing)
