"""Tests of odmc_plot: run with /usr/bin/python3 -m unittest discover -s test/scripts."""

import math
import os
import sys
import unittest
import xml.etree.ElementTree as xml

import numpy as np

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
sys.dont_write_bytecode = True
sys.path.insert(0, os.path.join(ROOT, 'scripts'))
import odmc_plot  # noqa: E402  pylint: disable=wrong-import-position


def figure_with(*draws) -> odmc_plot.Figure:
    """A figure of one panel on which each function draws."""
    figure = odmc_plot.Figure(1, 1, 5.0, 3.0)
    for draw in draws:
        draw(figure.flat()[0])
    return figure


class Ticks(unittest.TestCase):
    """Numbers at the axes."""

    def test_ticks_are_round_and_within_the_limits(self) -> None:
        """For ranges of any size and place."""
        for low, high in ((0.0, 1.0), (-3.2e-8, 9.1e-8), (99.7, 103.1), (-1e6, 2e6)):
            ticks = odmc_plot.ticks_of(low, high, 5)
            self.assertGreaterEqual(len(ticks), 2)
            self.assertLessEqual(len(ticks), 6)
            self.assertGreaterEqual(ticks[0], low - 1e-9 * abs(low))
            self.assertLessEqual(ticks[-1], high + 1e-9 * abs(high))
            step = ticks[1] - ticks[0]
            self.assertIn(round(step / 10.0 ** math.floor(math.log10(step * 1.0001)), 6),
                          (1.0, 2.0, 2.5, 5.0))

    def test_labels_give_the_value_of_each_tick(self) -> None:
        """The power of ten is named once."""
        ticks = np.array([0.0, 2.5e-8, 5.0e-8])
        labels, power = odmc_plot.tick_labels(ticks)
        factor = float(power.replace('\N{MINUS SIGN}', '-'))
        self.assertEqual(['0', '2.5', '5.0'], labels)
        self.assertEqual(1e-8, factor)
        self.assertEqual((['\N{MINUS SIGN}1', '0', '1'], ''),
                         odmc_plot.tick_labels(np.array([-1.0, 0.0, 1.0])))


class Shapes(unittest.TestCase):
    """What is drawn."""

    def paths(self, figure: odmc_plot.Figure, colour: str):
        """Path data of one colour."""
        root = xml.fromstring(figure.svg())
        return [e.get('d') for e in root.iter() if e.get('stroke') == colour and e.get('d')]

    def test_a_line_breaks_where_a_value_is_missing(self) -> None:
        """Two pieces, each with its own start."""
        figure = figure_with(lambda p: p.line([0, 1, 2, 3, 4], [1, 2, math.nan, 2, 1], '#123456'))
        path, = self.paths(figure, '#123456')
        self.assertEqual(2, path.count('M'))
        self.assertEqual(2, path.count('L'))
        self.assertNotIn('nan', figure.svg())

    def test_points_lie_where_the_limits_say(self) -> None:
        """The corners of the data are the corners of the panel."""
        figure = figure_with(lambda p: p.line([2.0, 6.0], [10.0, 30.0], '#123456'))
        panel = figure.flat()[0]
        panel.ylim = (10.0, 30.0)
        left, top, width, height = panel.box
        path, = self.paths(figure, '#123456')
        self.assertEqual(f'M{left:.1f},{top + height:.1f}L{left + width:.1f},{top:.1f}', path)

    def test_words_of_others_are_escaped(self) -> None:
        """A parameter may have any name."""
        figure = figure_with(lambda p: p.line([0, 1], [0, 1], '#123456', label='<b>&'))
        texts = [e.text for e in xml.fromstring(figure.svg()).iter() if e.text]
        self.assertIn('<b>&', texts)

    def test_nothing_and_a_constant_can_be_drawn(self) -> None:
        """Limits are never empty, numbers never NaN."""
        for values in ([], [3.0, 3.0], [math.nan, math.nan], [0.0, 0.0]):
            svg = figure_with(lambda p, y=values: p.line(range(len(y)), y, '#123456')).svg()
            xml.fromstring(svg)
            self.assertNotIn('nan', svg)

    def test_shared_axes_have_one_range(self) -> None:
        """The widest of the column."""
        figure = odmc_plot.Figure(2, 1, 5.0, 4.0)
        upper, lower = figure.flat()
        upper.line([0.0, 1.0], [0.0, 1.0], '#123456')
        lower.line([-2.0, 0.5], [0.0, 1.0], '#123456')
        figure.share_x()
        self.assertEqual((-2.0, 1.0), upper.xlim)
        self.assertEqual(upper.xlim, lower.xlim)
        self.assertFalse(upper.shows_x)
        self.assertTrue(lower.shows_x)


if __name__ == '__main__':
    unittest.main()
