"""Line plots as SVG pictures, drawn in milliseconds: what the report needs of a plotting library.

A figure is a grid of panels. Each keeps what is drawn on it in data units and is written once, when
its limits are known."""

import base64
import html
import math
from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

POINTS_PER_INCH = 72.0
INK, TICKS, EDGE, GRID = '#1f2933', '#52606d', '#9aa5b1', '#e4e7eb'
FONT = 'DejaVu Sans, Verdana, Helvetica, Arial, sans-serif'
SIZE = 8.5  # of letters [pt]
LETTER = 0.6  # mean width of one, of its size


class Legend(NamedTuple):
    """An entry of a legend: a line, or a patch where it has no width."""

    label: str
    colour: str
    width: float


def text(x: float, y: float, words: str, colour: str = INK, size: float = SIZE,
         anchor: str = 'start', weight: str = '', turn: bool = False) -> str:
    """Words at a place, turned a quarter to the left on request."""
    turned = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turn else ''
    bold = f' font-weight="{weight}"' if weight else ''
    return (f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" font-size="{size}" text-anchor="{anchor}"'
            f'{bold}{turned}>{html.escape(words)}</text>')


def nice_step(span: float, count: int) -> float:
    """A step of 1, 2, 2.5 or 5 times a power of ten that fits at most so often into the span."""
    rough = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    return next(power * m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if power * m >= rough * (1.0 - 1e-9))


def ticks_of(low: float, high: float, count: int) -> np.ndarray:
    """Round numbers between the limits."""
    step = nice_step(high - low, count)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.arange(first, last + 1) * step


def tick_labels(ticks: np.ndarray) -> Tuple[List[str], str]:
    """Texts of ticks, and the power of ten that they are to be multiplied by ('' for one)."""
    largest = float(np.abs(ticks).max(initial=0.0))
    power = math.floor(math.log10(largest)) if largest > 0.0 else 0
    power = 0 if -3 <= power <= 4 else power
    scaled = ticks / 10.0 ** power
    step = abs(scaled[1] - scaled[0]) if len(scaled) > 1 else 1.0
    decimals = next((d for d in range(8) if abs(step * 10 ** d - round(step * 10 ** d)) < 1e-6), 7)
    labels = [f'{value:.{decimals}f}' if abs(value) > 1e-12 else '0' for value in scaled]
    labels = [label.replace('-', '\N{MINUS SIGN}') for label in labels]
    return labels, f'1e{power}'.replace('-', '\N{MINUS SIGN}') if power else ''


class Panel:
    """One pair of axes: takes data, writes itself into its box [pt]."""

    def __init__(self, box: Tuple[float, float, float, float]) -> None:
        """@param box left, top, width, height"""
        self.box = box
        self.xlabel = self.ylabel = self.title = ''
        self.xlim: Optional[Tuple[float, float]] = None
        self.ylim: Optional[Tuple[float, float]] = None
        self.from_zero = False
        self.hidden = False
        self.shows_x = self.shows_y = True
        self.y_names: List[Tuple[float, str]] = []  # in place of numbers
        self.legend: List[Legend] = []
        self.legend_place = 'inside'  # or 'above'
        self.shapes: List[Tuple[str, np.ndarray, np.ndarray, str]] = []  # kind, x, y, attributes

    def line(self, x: Sequence[float], y: Sequence[float], colour: str, width: float = 1.1,
             label: str = '', alpha: float = 1.0) -> None:
        """A line; it breaks where a value is missing."""
        self.shapes.append(('line', np.asarray(x, float), np.asarray(y, float),
                            f'fill="none" stroke="{colour}" stroke-width="{width}" '
                            f'stroke-linejoin="round" stroke-opacity="{alpha}"'))
        if label:
            self.legend.append(Legend(label, colour, width))

    def dots(self, x: Sequence[float], y: Sequence[float], colour: str, size: float = 2.0,
             alpha: float = 1.0) -> None:
        """Points of a size [pt]."""
        self.shapes.append(('dots', np.asarray(x, float), np.asarray(y, float),
                            f'fill="none" stroke="{colour}" stroke-width="{size}" '
                            f'stroke-linecap="round" stroke-opacity="{alpha}"'))

    def band(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: str,
             alpha: float = 1.0) -> None:
        """The area between two lines; it does not widen the limits."""
        good = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        x, low, high = x[good], low[good], high[good]
        self.shapes.append(('area', np.concatenate([x, x[::-1]]), np.concatenate([low, high[::-1]]),
                            f'fill="{colour}" fill-opacity="{alpha}"'))

    def span(self, first: float, last: float, colour: str) -> None:
        """A band over the whole height, behind everything."""
        self.shapes.insert(0, ('span', np.array([first, last]), np.empty(0), f'fill="{colour}"'))

    def level(self, y: float, colour: str, width: float = 0.8) -> None:
        """A line over the whole width."""
        self.shapes.append(('level', np.empty(0), np.array([y]),
                            f'stroke="{colour}" stroke-width="{width}"'))

    def box_of(self, x0: float, x1: float, y0: float, y1: float, colour: str,
               alpha: float = 1.0) -> None:
        """A filled rectangle."""
        self.shapes.append(('rect', np.array([x0, x1]), np.array([y0, y1]),
                            f'fill="{colour}" fill-opacity="{alpha}"'))

    def words(self, x: float, y: float, words: str, colour: str, size: float) -> None:
        """A remark that starts at a place."""
        self.shapes.append(('words', np.array([x]), np.array([y]), f'{size}|{colour}|{words}'))

    def limits(self) -> Tuple[Tuple[float, float], Tuple[float, float]]:
        """Limits of x and y: those given, or what is drawn, with a margin above and below."""
        def around(values: List[np.ndarray]) -> Tuple[float, float]:
            every = np.concatenate(values) if values else np.empty(0)
            every = every[np.isfinite(every)]
            return (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)

        drawn = [s for s in self.shapes if s[0] not in ('words', 'area')]
        x = self.xlim or around([s[1] for s in drawn])
        y = self.ylim
        if y is None:
            low, high = around([s[2] for s in drawn])
            margin = 0.05 * (high - low) or 0.5 * abs(high) or 0.5
            y = (0.0 if self.from_zero else low - margin, high + margin)
        if not x[1] > x[0]:
            x = (x[0] - 0.5, x[0] + 0.5)
        return x, y

    def svg(self, name: str) -> str:
        """The panel as elements of SVG; `name` is one that no other panel has."""
        if self.hidden:
            return ''
        left, top, width, height = self.box
        (x0, x1), (y0, y1) = self.limits()

        def at_x(x: np.ndarray) -> np.ndarray:
            return left + (x - x0) * (width / (x1 - x0))

        def at_y(y: np.ndarray) -> np.ndarray:
            return top + height - np.clip((y - y0) / (y1 - y0), -2.0, 3.0) * height

        parts = [f'<clipPath id="{name}"><rect x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" '
                 f'height="{height:.1f}"/></clipPath>']
        inside = [self._shape(shape, at_x, at_y) for shape in self.shapes]
        spans = len([s for s in self.shapes if s[0] == 'span'])
        parts.append(f'<g clip-path="url(#{name})">{"".join(inside[:spans])}</g>')
        parts += self._ticks(at_x, at_y, (x0, x1), (y0, y1))
        parts.append(f'<g clip-path="url(#{name})">{"".join(inside[spans:])}</g>')
        parts.append(f'<path d="M{left:.1f},{top:.1f}V{top + height:.1f}H{left + width:.1f}" '
                     f'fill="none" stroke="{EDGE}" stroke-width="0.8"/>')
        parts += self._labels()
        return ''.join(parts)

    def _shape(self, shape: Tuple[str, np.ndarray, np.ndarray, str], at_x, at_y) -> str:
        left, top, width, height = self.box
        kind, x, y, look = shape
        if kind == 'span':
            first, last = at_x(x)
            return (f'<rect x="{first:.1f}" y="{top:.1f}" width="{max(last - first, 0.0):.1f}" '
                    f'height="{height:.1f}" {look}/>')
        if kind == 'level':
            return f'<path d="M{left:.1f},{at_y(y)[0]:.1f}h{width:.1f}" {look}/>'
        if kind == 'rect':
            (first, last), (low, high) = at_x(x), at_y(y)
            return (f'<rect x="{min(first, last):.1f}" y="{min(low, high):.1f}" '
                    f'width="{abs(last - first):.1f}" height="{abs(high - low):.1f}" {look}/>')
        if kind == 'words':
            size, colour, words = look.split('|', 2)
            return text(at_x(x)[0], at_y(y)[0] + 0.35 * float(size), words, colour, float(size))
        return f'<path d="{self._path(kind, at_x(x), at_y(y))}" {look}/>'

    @staticmethod
    def _path(kind: str, x: np.ndarray, y: np.ndarray) -> str:
        """Path data of a line, an area or dots."""
        good = np.isfinite(x) & np.isfinite(y)
        if not good.any():
            return ''
        starts = good & ~np.concatenate([[False], good[:-1]])
        # One formatting for the whole path: a report has 200,000 points.
        places = tuple(np.column_stack([x[good], y[good]]).ravel().tolist())
        if kind == 'dots':
            return 'M%.1f,%.1fh0' * int(good.sum()) % places
        path = ''.join(np.where(starts[good], 'M%.1f,%.1f', 'L%.1f,%.1f').tolist()) % places
        return path + 'Z' if kind == 'area' else path

    def _ticks(self, at_x, at_y, xlim: Tuple[float, float], ylim: Tuple[float, float]) -> List[str]:
        left, top, width, height = self.box
        parts = []
        ticks = ticks_of(*xlim, max(2, int(width / 55.0)))
        labels, power = tick_labels(ticks)
        for x, label in zip(at_x(ticks).tolist(), labels):
            parts.append(f'<path d="M{x:.1f},{top:.1f}v{height:.1f}" stroke="{GRID}" stroke-width="0.7"/>')
            if self.shows_x:
                parts.append(text(x, top + height + 11.0, label, TICKS, anchor='middle'))
        if power and self.shows_x:
            parts.append(text(left + width, top + height + 21.0, power, TICKS, anchor='end'))
        ticks = ticks_of(*ylim, max(2, min(7, int(height / 20.0))))
        labels, power = tick_labels(ticks)
        if self.y_names:
            ticks, labels, power = np.array([y for y, _ in self.y_names]), [n for _, n in self.y_names], ''
        for y, label in zip(at_y(ticks).tolist(), labels):
            if not self.y_names:
                parts.append(f'<path d="M{left:.1f},{y:.1f}h{width:.1f}" stroke="{GRID}" '
                             'stroke-width="0.7"/>')
            if self.shows_y:
                parts.append(text(left - 4.0, y + 3.0, label, TICKS, anchor='end'))
        if power and self.shows_y:
            parts.append(text(left, top - 3.0, power, TICKS))
        return parts

    def _labels(self) -> List[str]:
        left, top, width, height = self.box
        parts = []
        if self.title:
            parts.append(text(left, top - 13.0, self.title, weight='bold', size=9.0))
        if self.xlabel and self.shows_x:
            parts.append(text(left + 0.5 * width, top + height + 23.0, self.xlabel, anchor='middle'))
        if self.ylabel:
            parts.append(text(left - 40.0, top + 0.5 * height, self.ylabel, anchor='middle', turn=True))
        above = self.legend_place == 'above'
        x, y = left + width, top + (-6.0 if above else 12.0)
        for entry in reversed(self.legend):
            x -= LETTER * SIZE * len(entry.label)
            parts.append(text(x, y, entry.label))
            x -= 20.0
            thick = entry.width or 7.0
            parts.append(f'<path d="M{x:.1f},{y - 3.0:.1f}h15" stroke="{entry.colour}" '
                         f'stroke-width="{max(thick, 1.2)}"/>')
            x -= 10.0
        return parts


class Figure:
    """A grid of panels; sizes in inches."""

    def __init__(self, rows: int, columns: int, width: float, height: float, top: float = 0.3,
                 gap: float = 0.18, ratios: Sequence[float] = (), left: float = 0.72,
                 column_gap: float = 0.65) -> None:
        self.width, self.height = POINTS_PER_INCH * width, POINTS_PER_INCH * height
        unit = POINTS_PER_INCH
        bottom, right = 0.45 * unit, 0.12 * unit
        panel = (self.height - top * unit - bottom - gap * unit * (rows - 1)) / rows
        ratios = list(ratios) or [1.0] * columns
        free = self.width - left * unit - right - column_gap * unit * (columns - 1)
        widths = [free * ratio / sum(ratios) for ratio in ratios]
        lefts = [left * unit + sum(widths[:c]) + column_gap * unit * c for c in range(columns)]
        self.panels = [[Panel((lefts[c], top * unit + r * (panel + gap * unit), widths[c], panel))
                        for c in range(columns)] for r in range(rows)]

    def flat(self) -> List[Panel]:
        """All panels, row by row."""
        return [panel for row in self.panels for panel in row]

    def share_x(self) -> None:
        """One range for each column; numbers below its lowest panel only."""
        for column in zip(*self.panels):
            shown = [panel for panel in column if not panel.hidden]
            limits = [panel.limits()[0] for panel in shown if panel.shapes]
            for panel in shown:
                panel.shows_x = panel is shown[-1]
                if limits:
                    panel.xlim = (min(low for low, _ in limits), max(high for _, high in limits))

    def share_y(self) -> None:
        """One range for each row; numbers beside its first panel only."""
        for row in self.panels:
            limits = [panel.limits()[1] for panel in row if panel.shapes]
            for panel in row:
                panel.shows_y = panel is row[0]
                if limits:
                    panel.ylim = (min(low for low, _ in limits), max(high for _, high in limits))

    def svg(self) -> str:
        """The picture as SVG."""
        panels = ''.join(panel.svg(f'p{i}') for i, panel in enumerate(self.flat()))
        return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:.1f} '
                f'{self.height:.1f}" font-family="{FONT}">'
                f'<rect width="100%" height="100%" fill="#fff"/>{panels}</svg>')

    def address(self) -> str:
        """The address of the picture, embedded."""
        return 'data:image/svg+xml;base64,' + base64.b64encode(self.svg().encode()).decode('ascii')
