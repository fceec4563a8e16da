"""Files of pictures: their names are checked before anything is drawn."""

from pathlib import Path

from PIL import Image

from lemma.core.errors import InvalidConfigError
from lemma.core.files import write_whole

_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}


def check_picture_path(path: Path) -> None:
    """Check that a picture can be written under a name.

    Raises:
        InvalidConfigError: It is a folder, or its ending is not that of a picture.
    """
    if path.is_dir():
        raise InvalidConfigError(
            f"{path} is a folder. Name a file, such as {path / 'picture.png'}."
        )
    above = next(parent for parent in path.absolute().parents if parent.exists())
    if not above.is_dir():
        raise InvalidConfigError(f"{above} is a file, so {path} cannot be written.")
    if path.suffix.lower() not in _FORMATS:
        raise InvalidConfigError(
            f"{path} does not end like a picture. Valid endings: {', '.join(_FORMATS)}."
        )


def save_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture in the format that the ending of its name says.

    Raises:
        DatasetError: It cannot be written there.
    """
    kind = _FORMATS[path.suffix.lower()]
    write_whole(path, lambda draft: picture.save(draft, kind))
