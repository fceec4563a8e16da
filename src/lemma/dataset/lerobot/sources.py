"""Sources of an export: recipes, and episodes that were led by hand."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from shutil import copyfile

from lemma.core.errors import DatasetError
from lemma.core.files import read_json, write_json, write_whole
from lemma.dataset.files import MANIFEST, check_files
from lemma.dataset.instructions import TRAINING_KINDS, check_recorded
from lemma.dataset.lerobot.frames import Style
from lemma.dataset.recipe.files import open_table, read_group
from lemma.dataset.recipe.replay import check_versions
from lemma.dataset.recipe.schema import EpisodeRecord, perturbed_as
from lemma.dataset.teleoperation import Commanded, Teleoperation, read_record
from lemma.env.control.modes import CONTROLS
from lemma.env.control.pose_controllers import PoseController
from lemma.env.learning.motor_state import WAYPOINT
from lemma.tasks.language.template import KINDS

PARQUET = ".parquet"
"""Ending of a recipe's files."""


def read_records(
    path: Path, group: int, rows: tuple[int, ...]
) -> Sequence[EpisodeRecord]:
    """Return episodes of a file.

    Args:
        path: File of a recipe, or of an episode that was led by hand.
        group: Row group of the file.
        rows: Rows of the group.

    Raises:
        DatasetError: The file is damaged, or its replay reaches another state here.
    """
    if path.suffix != PARQUET:
        return [read_record(path)]
    found = read_group(path, group)
    return [found[row] for row in rows]


def check_source(source: Path, files: Sequence[Path], style: Style) -> None:
    """Check that episodes can be exported here, with these options.

    Args:
        source: A recipe, or episodes that were led by hand.
        files: The files to read.
        style: Options of the frames.

    Raises:
        DatasetError: They cannot be exported.
        InvalidConfigError: A file contains no episode that was led by hand.
    """
    if all(path.suffix != PARQUET for path in files):
        _check_led(files, style)
        return
    for kind in style.instructions:
        check_recorded(kind, [path.parent.name for path in files])
    for path in files:
        found = open_table(path)[1]
        check_versions(found)
        if perturbed_as(found):
            raise DatasetError(
                f"{source} contains perturbed executions, whose actions are partly "
                "wrong, so they are no demonstrations for a LeRobotDataset. Render "
                "keyframes, whose labels are the expert's, or export a recipe of "
                "demonstrations."
            )
    check_files(source, partial=True)


def _check_led(files: Sequence[Path], style: Style) -> None:
    """Check that episodes that were led by hand can be exported with these options.

    Raises:
        DatasetError: They cannot be exported.
        InvalidConfigError: A file contains no such episode.
    """
    if style.instructions != TRAINING_KINDS[:1]:
        raise DatasetError(
            "An episode that was led by hand has only the visitor's sentence. Leave "
            "out --instructions."
        )
    for path in files:
        done = Teleoperation.load(path)
        sentences = done.instance.instructions
        held_out = {sentences[kind] for kind in KINDS if kind not in TRAINING_KINDS}
        if done.instruction in held_out:
            raise DatasetError(
                f"{path}: its sentence is held out for evaluation. Record episodes for "
                "training with another sentence."
            )
        modes = {part.control for part in done.parts if isinstance(part, Commanded)}
        for mode in sorted(modes) if style.control == WAYPOINT else ():
            if not issubclass(CONTROLS[mode].controller, PoseController):
                raise DatasetError(
                    f"{path}: mode {mode} commands joints, so there are no targets of "
                    "hands. Leave out --control."
                )


def name_in_source(path: Path) -> str:
    """Return the path of a file within a recipe: ``"train/stack.parquet"``."""
    return f"{path.parent.name}/{path.name}"


def keep_source(folder: Path, files: Sequence[Path]) -> None:
    """Copy the recipe of the episodes, with instances and states of the physics.

    For episodes that were led by hand, copy their files.
    """
    if all(path.suffix != PARQUET for path in files):
        for path in files:
            write_whole(folder / path.name, partial(copyfile, path))
        return
    manifest = read_json(files[0].parents[1] / MANIFEST)
    listed = {}
    for path in files:
        name = name_in_source(path)
        write_whole(folder / name, partial(copyfile, path))
        if name in manifest["files"]:
            listed[name] = manifest["files"][name]
    write_json(folder / MANIFEST, {**manifest, "files": listed})
