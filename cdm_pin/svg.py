"""Small charts as SVG text: lines, points, bands, heat maps; no script, no font, nothing from the network.

Colours are those of Okabe and Ito, told apart by people with any colour vision; lines differ in dash as well. Charts
are drawn for the width of a phone and scale with the page.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

BLACK, GREY, BLUE, VERMILLION, GREEN = "#000000", "#767676", "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PURPLE = "#E69F00", "#56B4E9", "#CC79A7"

# Anchors from low to high: cividis for sizes, blue-white-orange for signed values.
SEQUENTIAL = ("#00204C", "#213D6B", "#555B6C", "#7B7A77", "#A59C74", "#D3C064", "#FFE945")
DIVERGING = ("#08519C", "#4292C6", "#B5D4E9", "#FFFFFF", "#FDCB9B", "#E6762D", "#8C3A04")

_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 12, 10, 40


@dataclass
class Chart:
    """One pair of axes to draw on.

    Attributes
    ----------
    x, y : tuple of float
        Limits, in the units of the data.
    x_label, y_label : str
    width, height : int
        In CSS pixels at full size.
    log : bool
        Both axes logarithmic.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    x_label: str = ""
    y_label: str = ""
    width: int = 440
    height: int = 260
    log: bool = False
    _parts: list[str] = field(default_factory=list)

    def line(self, x: np.ndarray, y: np.ndarray, colour: str, *, dash: str = "", width: float = 1.6) -> None:
        """Draw a line; where it has more points than pixels, its envelope."""
        x, y = envelope(np.asarray(x, float), np.asarray(y, float), 2 * self.width)
        stroke = f'stroke="{colour}" stroke-width="{width}"' + (f' stroke-dasharray="{dash}"' if dash else "")
        finite = np.isfinite(x) & np.isfinite(y)
        for part in np.split(np.arange(len(x)), np.flatnonzero(np.diff(finite)) + 1):
            if len(part) > 1 and finite[part[0]]:
                points = " ".join(f"{u:.1f},{v:.1f}" for u, v in self._pixels(x[part], y[part]))
                self._parts.append(f'<polyline fill="none" {stroke} points="{points}"/>')

    def points(self, x: np.ndarray, y: np.ndarray, colour: str, *, radius: float = 1.6, opacity: float = 0.5) -> None:
        """Draw points, at most 1500 of them, evenly chosen."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        chosen = np.unique(np.linspace(0, len(x) - 1, min(len(x), 1500)).astype(int)) if len(x) else []
        inside = [i for i in chosen if np.isfinite(x[i]) and np.isfinite(y[i])]
        path = "".join(f"M{u:.1f} {v:.1f}h0" for u, v in self._pixels(x[inside], y[inside]))
        self._parts.append(
            f'<path d="{path}" stroke="{colour}" stroke-width="{2 * radius}" stroke-linecap="round" '
            f'stroke-opacity="{opacity}" fill="none"/>'
        )

    def band(self, low: float, high: float, colour: str = "#D9D9D9") -> None:
        """Shade between two heights."""
        (_, top), (_, bottom) = self._pixels(np.array([self.x[0]] * 2), np.array([high, low]))
        self._parts.append(
            f'<rect x="{_LEFT}" y="{top:.1f}" width="{self._inner[0]}" height="{bottom - top:.1f}" fill="{colour}"/>'
        )

    def span(self, start: float, end: float, colour: str = "#FCE3C4") -> None:
        """Shade between two places along x."""
        (left, _), (right, _) = self._pixels(np.array([start, end]), np.array([self.y[0]] * 2))
        self._parts.append(
            f'<rect x="{left:.1f}" y="{_TOP}" width="{max(right - left, 1):.1f}" height="{self._inner[1]}" '
            f'fill="{colour}"/>'
        )

    def image(self, values: np.ndarray, limits: tuple[float, float], colours: Sequence[str]) -> None:
        """Fill the axes with a heat map, its first row at the top."""
        self._parts.append(
            f'<image x="{_LEFT}" y="{_TOP}" width="{self._inner[0]}" height="{self._inner[1]}" '
            f'preserveAspectRatio="none" style="image-rendering:pixelated" '
            f'href="{png_uri(paint(values, limits, colours))}"/>'
        )

    def render(self, description: str, *, y_names: Sequence[str] = (), x_names: Sequence[str] = ()) -> str:
        """Give the SVG element; names stand in the middle of equal parts of an axis, in place of its ticks."""
        w, h = self._inner
        clip = f'<svg x="{_LEFT}" y="{_TOP}" width="{w}" height="{h}" viewBox="{_LEFT} {_TOP} {w} {h}">'
        body = clip + "".join(self._parts) + "</svg>"
        frame = f'<rect x="{_LEFT}" y="{_TOP}" width="{w}" height="{h}" fill="none" stroke="#767676"/>'
        axes = self._x_axis(x_names) + self._y_axis(y_names)
        return svg(self.width, self.height, body + frame + axes, description)

    @property
    def _inner(self) -> tuple[int, int]:
        return self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM

    def _pixels(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        w, h = self._inner
        (x0, x1), (y0, y1) = self.x, self.y
        if self.log:
            with np.errstate(divide="ignore", invalid="ignore"):
                x, y = np.log10(x), np.log10(y)
            x0, x1, y0, y1 = np.log10([x0, x1, y0, y1])
        u = _LEFT + w * (x - x0) / ((x1 - x0) or 1.0)
        v = _TOP + h * (1 - (y - y0) / ((y1 - y0) or 1.0))
        return np.column_stack([u, np.clip(v, -1e4, 1e4)])

    def _x_axis(self, names: Sequence[str]) -> str:
        w, h = self._inner
        base, out = _TOP + h, []
        if names:
            places = [(_LEFT + w * (k + 0.5) / len(names), name) for k, name in enumerate(names)]
        else:
            marks = ticks(*self.x, log=self.log)
            places = list(
                zip(self._pixels(np.array(marks), np.full(len(marks), self.y[0]))[:, 0], labels(marks), strict=True)
            )
            out = [f'<path d="M{u:.1f} {base}v4" stroke="#767676"/>' for u, _ in places]
        out += [text(u, base + 15, name, anchor="middle") for u, name in places]
        return "".join(out) + text(_LEFT + w / 2, self.height - 6, self.x_label, anchor="middle")

    def _y_axis(self, names: Sequence[str]) -> str:
        h, out = self._inner[1], []
        if names:
            places = [(_TOP + h * (k + 0.5) / len(names), name) for k, name in enumerate(names)]
        else:
            marks = ticks(*self.y, log=self.log)
            places = list(
                zip(self._pixels(np.full(len(marks), self.x[0]), np.array(marks))[:, 1], labels(marks), strict=True)
            )
            out = [f'<path d="M{_LEFT} {v:.1f}h-4" stroke="#767676"/>' for v, _ in places]
        out += [text(_LEFT - 6, v + 4, name, anchor="end") for v, name in places]
        middle = _TOP + h / 2
        turned = f'transform="rotate(-90 12 {middle})"'
        return "".join(out) + text(12, middle, self.y_label, anchor="middle", extra=turned)


def svg(width: int, height: int, body: str, description: str) -> str:
    """Wrap drawing elements into a scalable, described SVG element."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{escape(description)}" style="width:100%;max-width:{width}px;height:auto" '
        f'font-family="system-ui,sans-serif" font-size="11.5">{body}</svg>'
    )


def text(x: float, y: float, words: str, *, anchor: str = "start", extra: str = "") -> str:
    """Write words at a point; anchor is start, middle or end."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {extra}>{escape(words)}</text>' if words else ""


def ticks(low: float, high: float, *, log: bool = False, count: int = 5) -> list[float]:
    """Choose round numbers between two limits; powers of ten on a logarithmic axis on which there are two of them."""
    if log and np.log10(high / low) >= 2.0:
        first, last = np.ceil(np.log10(low) - 1e-9), np.floor(np.log10(high) + 1e-9)
        step = max(1, int(np.ceil((last - first + 1) / 6)))
        return [float(10.0**k) for k in np.arange(first, last + 1, step)]
    span = high - low
    if not np.isfinite(span) or span <= 0:
        return [low]
    raw = span / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / raw)))
    return [float(step * k) for k in range(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)]


def labels(marks: Sequence[float]) -> list[str]:
    """Write tick values, all with the same number of decimals."""
    if len(marks) > 1 and all(mark > 0 for mark in marks) and marks[-1] / marks[0] >= 1e3:
        return [f"{mark:g}" for mark in marks]
    step = marks[1] - marks[0] if len(marks) > 1 else abs(marks[0]) or 1.0
    decimals = max(0, -int(np.floor(np.log10(step) + 1e-9))) if step > 0 else 0
    return [f"{mark + 0.0:.{decimals}f}" if decimals < 5 else f"{mark:g}" for mark in marks]


def limits(*arrays: np.ndarray, margin: float = 0.06) -> tuple[float, float]:
    """Give limits that hold all finite values with a margin."""
    values = np.concatenate([np.ravel(np.asarray(a, float)) for a in arrays]) if arrays else np.zeros(1)
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    pad = margin * (high - low) or 0.5 * abs(high) or 1.0
    return low - pad, high + pad


def envelope(x: np.ndarray, y: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Keep the lowest and the highest of each run of points, so that about `count` points look like all of them."""
    if len(x) <= 2 * count:
        return x, y
    size = -(-len(x) // count)
    whole = len(x) // size * size
    blocks = np.where(np.isfinite(y[:whole]), y[:whole], 0.0).reshape(-1, size)
    pair = np.sort(np.column_stack([blocks.argmin(1), blocks.argmax(1)]), axis=1)
    keep = (pair + size * np.arange(len(blocks))[:, None]).ravel()
    return x[keep], y[keep]


def paint(values: np.ndarray, limits: tuple[float, float], colours: Sequence[str]) -> np.ndarray:
    """Turn values into colours, shape (rows, columns, 3) of uint8; not-a-number becomes light grey."""
    anchors = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in colours], float)
    span = (limits[1] - limits[0]) or 1.0
    place = np.clip((np.nan_to_num(values) - limits[0]) / span, 0, 1) * (len(anchors) - 1)
    rgb = np.stack([np.interp(place, np.arange(len(anchors)), anchors[:, c]) for c in range(3)], axis=-1)
    rgb[~np.isfinite(values)] = 230
    return rgb.astype(np.uint8)


def png_uri(rgb: np.ndarray) -> str:
    """Encode colours, shape (rows, columns, 3), as the data URI of a PNG."""
    rows, columns, _ = rgb.shape
    raw = np.hstack([np.zeros((rows, 1), np.uint8), rgb.reshape(rows, -1)]).tobytes()

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    return "data:image/png;base64," + base64.b64encode(png).decode()


def colour_bar(limits: tuple[float, float], colours: Sequence[str], label: str) -> str:
    """Draw the scale of a heat map."""
    ramp = png_uri(paint(np.linspace(*limits, 64)[None], limits, colours))
    low, high = (f"{value:.3g}" for value in limits)
    body = (
        f'<image x="{_LEFT}" y="2" width="160" height="10" preserveAspectRatio="none" href="{ramp}"/>'
        + text(_LEFT - 6, 11, low, anchor="end")
        + text(_LEFT + 166, 11, f"{high}  {label}")
    )
    return svg(440, 18, body, f"colours from {low} to {high}: {label}")
