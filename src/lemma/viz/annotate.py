"""Text, arrows and circles on pictures, in one style."""

import math
from functools import cache

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Color = tuple[int, int, int]
Point = tuple[float, float]
Box = tuple[Point, Point]
"""Upper left and lower right corner."""

INK: Color = (24, 28, 34)
FAINT: Color = (104, 112, 122)
PAPER: Color = (250, 250, 249)
LIGHT: Color = (255, 255, 255)
GOOD: Color = (46, 160, 90)
BAD: Color = (214, 60, 52)
ROBOT_INK: dict[str, Color] = {
    "red": (205, 30, 30),
    "white": (245, 245, 240),
    "blue": (40, 90, 205),
    "green": (30, 140, 60),
}
ENTITY_INK: dict[str, Color] = {
    "pink": (226, 90, 150),
    "red": (200, 30, 30),
    "white": (245, 245, 240),
    "blue": (36, 84, 204),
    "green": (28, 140, 60),
    "stick": (236, 178, 20),
}


@cache
def font(size_px: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return the font that Pillow includes, which exists on every machine."""
    return ImageFont.load_default(size_px)


def text_width(text: str, size_px: float) -> float:
    """Return the width of a line of text [px]."""
    return float(font(size_px).getlength(text))


def fitting_size(text: str, size_px: float, width_px: float) -> float:
    """Return the largest size up to ``size_px`` at which a line fits a width."""
    return min(size_px, size_px * width_px / max(1.0, text_width(text, size_px)))


def wrap(text: str, size_px: float, width_px: float) -> list[str]:
    """Break a text into lines that fit a width [px]."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(longer, size_px) <= width_px:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def label_plate(
    near: Point,
    text: str,
    size: float,
    away: float,
    occupied: list[Box],
    within: Point,
) -> Box:
    """Return a free place for a label: above a point, else below, right or left of it.

    Args:
        near: Point of the labelled thing.
        text: The word.
        size: Height of the letters [px].
        away: Distance from the point to the plate's middle [px].
        occupied: Boxes to keep free if possible.
        within: Width and height of the picture [px]; labels stay inside.
    """
    half_width, half_height = (text_width(text, size) + 2.0 * size) / 2, 0.78 * size
    sideways = half_width + away - half_height
    boxes = []
    for dx, dy in ((0, -away), (0, away), (sideways, 0), (-sideways, 0)):
        x = min(max(near[0] + dx, half_width), max(within[0] - half_width, half_width))
        y = near[1] + dy
        y = min(max(y, half_height), max(within[1] - half_height, half_height))
        low, high = (x - half_width, y - half_height), (x + half_width, y + half_height)
        boxes.append((low, high))

    def is_free(box: Box) -> bool:
        return not any(
            all(box[0][i] < other[1][i] and other[0][i] < box[1][i] for i in range(2))
            for other in occupied
        )

    return next(filter(is_free, boxes), boxes[0])


class Canvas:
    """A picture to draw on; it is drawn enlarged and then reduced, for smooth edges."""

    def __init__(self, picture: Image.Image, oversampling: int = 2) -> None:
        """Start from a picture; its pixels are the unit of all lengths."""
        self._factor = oversampling
        size = (picture.width * oversampling, picture.height * oversampling)
        self._image = picture.convert("RGB").resize(size, Image.Resampling.BICUBIC)
        self._draw = ImageDraw.Draw(self._image, "RGBA")

    def picture(self) -> Image.Image:
        """Return the finished picture."""
        return self._image.reduce(self._factor)

    def _scaled(self, points: list[Point]) -> list[Point]:
        return [(x * self._factor, y * self._factor) for x, y in points]

    def line(self, points: list[Point], color: Color, width: float) -> None:
        """Draw a line through points."""
        self._draw.line(
            self._scaled(points),
            fill=color,
            width=max(1, round(width * self._factor)),
            joint="curve",
        )

    def disc(self, centre: Point, radius: float, color: Color) -> None:
        """Fill a circle."""
        self._draw.circle(self._scaled([centre])[0], radius * self._factor, fill=color)

    def circle(
        self,
        centre: Point,
        radius: float,
        color: Color,
        width: float,
        dash: float | None = None,
    ) -> None:
        """Draw a circle, dashed if ``dash``, the length of a dash, is given."""
        pieces = max(24, round(2 * math.pi * radius / (dash or 2.0)))
        angles = np.linspace(0.0, 2 * math.pi, 2 * (pieces // 2) + 1)
        around = [
            (centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a))
            for a in angles
        ]
        if dash is None:
            self.line(around, color, width)
        else:
            for i in range(0, len(around) - 1, 2):
                self.line(around[i : i + 2], color, width)

    def arrow(
        self, start: Point, end: Point, color: Color, width: float, bend: float = 0.18
    ) -> None:
        """Draw a curved arrow with a pale edge; it bends to the left."""
        a, c = np.array(start), np.array(end)
        along = c - a
        b = (a + c) / 2 + bend * np.array([along[1], -along[0]])
        ahead = (c - b) / (math.hypot(*(c - b)) or 1.0)
        aside, head = np.array([-ahead[1], ahead[0]]), 4.2 * width
        neck = c - head * ahead
        s = np.linspace(0.0, 1.0, 24)[:, None]
        curve = (1 - s) ** 2 * a + 2 * s * (1 - s) * b + s**2 * neck
        for edge, ink in ((0.8 * width, LIGHT), (0.0, color)):
            self.line([(x, y) for x, y in curve.tolist()], ink, width + 2 * edge)
            side = (0.5 * head + edge) * aside
            tip, back = c + edge * ahead, neck - edge * ahead
            corners = np.stack([tip, back + side, back - side])
            points = self._scaled([(x, y) for x, y in corners.tolist()])
            self._draw.polygon(points, fill=ink)

    def text(
        self,
        at: Point,
        text: str,
        size: float,
        color: Color = INK,
        anchor: str = "la",
    ) -> None:
        """Write one line; ``anchor`` is the point of it at ``at``, as in Pillow."""
        self._draw.text(
            self._scaled([at])[0],
            text,
            font=font(size * self._factor),
            fill=color,
            anchor=anchor,
        )

    def label(
        self,
        near: Point,
        text: str,
        size: float,
        mark: Color,
        away: float,
        occupied: list[Box],
    ) -> None:
        """Write a word on a white plate, with a colored dot before it.

        Args:
            near: Point of the labelled thing.
            text: The word.
            size: Height of the letters [px].
            mark: Color of the dot.
            away: Distance from the point to the plate's middle [px].
            occupied: Boxes to keep free if possible; the plate's box is appended.
        """
        within = self._image.width / self._factor, self._image.height / self._factor
        plate = label_plate(near, text, size, away, occupied, within)
        occupied.append(plate)
        (left, top), (_, bottom) = plate
        corners, round_px = self._scaled([*plate]), 0.4 * size * self._factor
        self._draw.rounded_rectangle(corners, round_px, fill=(255, 255, 255, 225))
        y = (top + bottom) / 2
        self.disc((left + 0.85 * size, y), 0.40 * size, FAINT)
        self.disc((left + 0.85 * size, y), 0.33 * size, mark)
        self.text((left + 1.45 * size, y), text, size, INK, "lm")


def false_color(
    values: NDArray[np.float32], low: float, high: float
) -> NDArray[np.uint8]:
    """Return colors for values, smaller ones brighter.

    Args:
        values: Shape (H, W).
        low: Value of the brightest color.
        high: Value of the darkest color.

    Returns:
        RGB, shape (H, W, 3).
    """
    colors = colormaps["viridis_r"]((values - low) / (high - low), bytes=True)
    near_to_far: NDArray[np.uint8] = colors[..., :3]
    return near_to_far
