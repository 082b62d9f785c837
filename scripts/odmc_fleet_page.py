"""Pages of what `calibrate FLIGHT...` and `fleet` wrote: tables, parameters over flights, outliers."""

import base64
import io
import os
from typing import Any, Dict, List, Optional

import jinja2
import matplotlib
import numpy as np

matplotlib.use('Agg')
from matplotlib import pyplot  # noqa: E402  pylint: disable=wrong-import-position

BLUE, RED, BAND, GREY = '#0b6fb8', '#d1495b', '#9ec9e8', '#7b8794'
MOST_LABELS, MOST_ROWS, MOST_PANELS = 25, 12, 4
UNITS = {'_rad_s': 'rad/s', '_m_s': 'm/s', '_Nm': 'N m', '_N': 'N', '_m': 'm', '_s': 's'}
HOW = ("calibrate FLIGHT --vehicle FILE --out DIR makes a flight's own report (DIR/report.html); fleet ... --reports makes "
       'those of all flights.')

TEMPLATE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{{ title }}</title>
<style>body{font:15px/1.5 sans-serif;color:#1f2933;max-width:70em;margin:2em auto;padding:0 1em}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;text-align:right;border-bottom:1px solid #dde3e9}
td:first-child,th:first-child{text-align:left}img{max-width:100%}.bad{color:#b3261e}.quiet{color:#7b8794}
code{font-size:.85em;overflow-wrap:anywhere}</style>
<h1>{{ title }}</h1>
{% if summary %}<table><tr>{% for head in summary[0] %}<th>{{ head }}</th>{% endfor %}</tr>
{% for row in summary[1:] %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>{% endif %}
{% if broken %}<h2 class="bad">Expectations broken</h2><ul>{% for text in broken %}<li>{{ text }}</li>{% endfor %}</ul>{% endif %}
{% for part in parts %}<h2>{{ part.name }}</h2>
<p>{{ part.flights }} flights, {{ part.hours }} h.{% if part.ratio %} Errors by the parameters of all other flights over
those of each flight's own fit: force {{ part.ratio.force }}, torque {{ part.ratio.torque }}.{% endif %}</p>
{% if part.notes %}<ul>{% for note in part.notes %}<li>{{ note }}</li>{% endfor %}</ul>{% else %}
<p class="quiet">No step, no trend, no outlier.</p>{% endif %}
<table><tr><th>parameter</th><th>value</th><th>sigma</th><th>between flights</th><th>a new flight's sigma</th><th>unit</th></tr>
{% for row in part.parameters %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
<img alt="parameters over flights" src="data:image/png;base64,{{ part.picture }}">
<p class="quiet">Points: each flight's own estimate with one sigma. Line: what all flights together say of it. Band: three
standard deviations between flights.</p>
{% if part.loop %}<h3>What the model lacks: {{ part.loop.verdict }}</h3>
{% if part.loop.rows %}<table><tr><th>effect</th><th>gain [nats]</th><th>flights for it</th><th>against</th><th>not told from</th></tr>
{% for row in part.loop.rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
<table><tr><th>coefficient</th><th>value</th><th>sigma</th><th>between flights</th><th>flights within two sigma</th><th>unit</th></tr>
{% for row in part.loop.coefficients %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
<img alt="coefficients over flights" src="data:image/png;base64,{{ part.loop.picture }}">
<p class="quiet">Points: what each flight says of the coefficient, the others where all flights have them, with one sigma. Line and
band: what all together say, with one sigma.</p>{% endif %}
{% for table in part.loop.errors %}<table><tr><th>{{ table.name }}</th><th>before x y z</th><th>after x y z</th><th>after/before</th></tr>
{% for row in table.rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>{% endfor %}
{% for text in part.loop.warnings %}<p class="quiet">{{ text }}</p>{% endfor %}{% endif %}
<h3>Recurrent residuals</h3>
{% if part.recurrent is none %}<p class="quiet">Not looked for: flights were not predicted by the others' parameters, or fewer
than five have been anywhere together.</p>
{% else %}<p>Measured minus predicted by the parameters of all other flights, sorted by what the vehicle did. {{ part.recurrent.said }}</p>
{% if part.recurrent.rows %}<table><tr><th>residual</th><th>where</th><th>mean</th><th>sigma</th><th>of the
error</th><th>flights with that sign</th><th>p</th></tr>
{% for row in part.recurrent.rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
<img alt="recurrent residuals" src="data:image/png;base64,{{ part.recurrent.picture }}">
<p class="quiet">Lines: mean of the flights in a bin, red where it counts. Bands: two standard deviations between flights.</p>{% endif %}
{% endif %}
<h3>Flights</h3>
<table><tr><th>flight</th><th>s</th><th>force RMSE x y z [N]</th><th>by all others [N]</th><th>largest z</th>
<th>verdict</th>{% if part.reports %}<th>report</th>{% endif %}</tr>
{% for row in part.rows %}<tr>{% for cell in row.cells %}<td>{{ cell }}</td>{% endfor %}
{% if row.report.link %}<td><a href="{{ row.report.link }}">report</a></td>
{% elif row.report.command %}<td><details><summary>how</summary><code>{{ row.report.command }}</code></details></td>{% endif %}</tr>
{% endfor %}</table>
{% if part.how %}<p class="quiet">{{ part.how }}</p>{% endif %}
{% endfor %}
{% if failed %}<h2>Not used</h2><table><tr><th>flight</th><th>why</th></tr>
{% for row in failed %}<tr><td>{{ row.file }}</td><td style="text-align:left">{{ row.why }}</td></tr>{% endfor %}</table>{% endif %}
</html>
"""


def number(value: Optional[float], digits: int = 4) -> str:
    """A number for people; a dash where there is none."""
    return '-' if value is None else f'{value:.{digits}g}'


def axes(values: Optional[List[float]]) -> str:
    """Three of them."""
    return '-' if not values else ' '.join(number(v, 3) for v in values)


def notes(report: Dict[str, Any]) -> List[str]:
    """Steps, trends and outliers in words."""
    lines = []
    for change in report['changes']:
        size = f"{number(change['size'])} ± {number(change['sigma'], 2)}"
        where = (f"from {os.path.basename(change['from_file'])} on" if change['kind'] == 'step'
                 else 'over all flights')
        lines.append(f"{change['kind']}: {change['parameter']} by {size} {where} (p = {number(change['p_value'], 1)})")
    for outlier in report['outliers']:
        lines.append(f"outlier: {os.path.basename(outlier['file'])}, {outlier['parameter']} off by "
                     f"{number(outlier['by'])} ± {number(outlier['sigma'], 2)} (p = {number(outlier['p_value'], 1)}); "
                     'not averaged in')
    return lines


def ratio(report: Dict[str, Any], figure: str) -> Optional[str]:
    """Root mean square over flights by the others' parameters, over that by the flight's own."""
    pairs = [(f['left_out'][figure], f['own_fit'][figure]) for f in report['flights']
             if f['left_out'].get(figure) and f['own_fit'].get(figure)]
    if not pairs:
        return None
    others, own = (np.sqrt(np.mean(np.square([p[k] for p in pairs]), axis=0)) for k in (0, 1))
    return ' '.join(f'{a / b:.2f}' if b > 0 else '-' for a, b in zip(others, own))


def steps(report: Dict[str, Any], name: str) -> bool:
    """True if a parameter takes steps and nothing else."""
    kinds = {change['kind'] for change in report['changes'] if change['parameter'] == name}
    return kinds == {'step'}


def encoded(figure: Any) -> str:
    """A PNG in base64; the figure is closed."""
    image = io.BytesIO()
    figure.savefig(image, format='png', dpi=85)
    pyplot.close(figure)
    return base64.b64encode(image.getvalue()).decode()


def picture(report: Dict[str, Any]) -> str:
    """Parameters over flights, those the flights show, as a PNG in base64."""
    names = [n for n, p in report['parameters'].items() if p['observable']] or list(report['parameters'])
    count = len(report['flights'])
    rows = (len(names) + 1) // 2
    figure, panels = pyplot.subplots(rows, 2, figsize=(11.0, 2.1 * rows + 0.5), sharex=True,
                                     squeeze=False, layout='constrained')
    at = np.arange(count)
    for panel, name in zip(panels.flat, names):
        own = [f['parameters'][name] for f in report['flights']]
        value = np.array([p['value'] for p in own], dtype=float)
        sigma = np.array([p['sigma'] for p in own], dtype=float)
        scatter = report['parameters'][name]['scatter'] or 0.0
        expected = np.array([p['expected'] for p in own], dtype=float)
        off = np.array([abs(p['z'] or 0.0) > 3.0 for p in own])
        panel.fill_between(at, expected - 3.0 * scatter, expected + 3.0 * scatter, color=BAND, alpha=0.6, linewidth=0,
                           step='mid' if steps(report, name) else None)
        panel.plot(at, expected, color=BLUE, linewidth=1.2, drawstyle='steps-mid' if steps(report, name) else 'default')
        for chosen, colour in ((~off, GREY), (off, RED)):
            panel.errorbar(at[chosen], value[chosen], sigma[chosen], fmt='.', color=colour, elinewidth=0.7, markersize=5)
        named = [o['flight'] for o in report['outliers'] if o['parameter'] == name]
        panel.plot(named, value[named], 'o', mfc='none', color=RED, markersize=10)
        panel.set_title(f"{name} [{report['parameters'][name]['unit']}]", fontsize=9, loc='left')
        panel.tick_params(labelsize=7)
        # Flights that show nothing of it do not set the scale.
        shown = sigma < 4.0 * np.median(sigma)
        reach = np.concatenate([(value - sigma)[shown], (value + sigma)[shown], expected])
        span = max(np.ptp(reach), 1e-12 * max(1.0, float(np.max(np.abs(reach)))))
        panel.set_ylim(reach.min() - 0.1 * span, reach.max() + 0.1 * span)
    for panel in list(panels.flat)[len(names):]:
        panel.axis('off')
    for panel in panels[-1]:
        if count <= MOST_LABELS:
            labels = [os.path.splitext(os.path.basename(f['file']))[0] for f in report['flights']]
            panel.set_xticks(at, labels, rotation=60, ha='right', fontsize=7)
        else:
            panel.set_xlabel('flight', fontsize=8)
    return encoded(figure)


def spelled(name: str) -> List[str]:
    """A quantity's name with its unit: ['air speed x', 'm/s']."""
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return [name[:-len(suffix)].replace('_', ' '), unit]
    return [name.replace('_', ' '), '']


def interval(row: Dict[str, Any]) -> str:
    """Of a quantity: 'air speed 4 to 6 m/s'."""
    words, unit = spelled(row['quantity'])
    return f"{words} {number(row['from'])} to {number(row['to'])} {unit}".strip()


def curves(report: Dict[str, Any], pairs: List[Any]) -> str:
    """Residual over a quantity for some (channel, quantity), as a PNG in base64."""
    bins, rate = (report['recurrent_residuals'][key] for key in ('bins', 'false_alarm_rate'))
    rows = (len(pairs) + 1) // 2
    figure, panels = pyplot.subplots(rows, 2, figsize=(11.0, 2.6 * rows), squeeze=False, layout='constrained')
    for panel, (channel, quantity) in zip(panels.flat, pairs):
        own = sorted((b for b in bins if (b['channel'], b['quantity']) == (channel, quantity)), key=lambda b: b['from'])
        panel.axhline(0.0, color=GREY, linewidth=0.7)
        for b in own:
            low, high = b['mean'] - 2.0 * b['scatter'], b['mean'] + 2.0 * b['scatter']
            panel.fill_between([b['from'], b['to']], low, high, color=BAND, alpha=0.6, linewidth=0)
            panel.hlines(b['mean'], b['from'], b['to'], color=RED if b['p_value'] < rate else BLUE, linewidth=2.0)
        panel.ticklabel_format(axis='y', scilimits=(-3, 4), useMathText=True)
        panel.yaxis.get_offset_text().set_fontsize(7)
        for (words, unit), label in ((spelled(channel), panel.set_ylabel), (spelled(quantity), panel.set_xlabel)):
            label(f'{words} [{unit}]' if unit else words, fontsize=8)
        panel.tick_params(labelsize=7)
    for panel in list(panels.flat)[len(pairs):]:
        panel.axis('off')
    return encoded(figure)


def recurrent(report: Dict[str, Any]) -> Optional[Dict[str, Any]]:
    """What comes back in flight after flight: table and picture of the strongest."""
    all_bins = report.get('recurrent_residuals')
    if not all_bins:
        return None
    bins, rate = all_bins['bins'], all_bins['false_alarm_rate']
    found = sorted((b for b in bins if b['p_value'] < rate), key=lambda b: -b['share_of_error'])
    said = (f'{len(found)} of {len(bins)} bins are off in the same direction on most flights' if found
            else f'None of {len(bins)} bins is off in the same direction on most flights')
    said += f' (by more than {100.0 * all_bins["least_share_of_error"]:.0f} % of the error; in {100.0 * rate:.3g} % of fleets ' \
            'without any, one is named).'
    if len(found) > MOST_ROWS:
        said += f' The {MOST_ROWS} largest beside the error; fleet.json has all.'
    pairs = list(dict.fromkeys((b['channel'], b['quantity']) for b in found))[:MOST_PANELS]
    rows = [[spelled(b['channel'])[0], interval(b), f"{number(b['mean'], 3)} {spelled(b['channel'])[1]}",
             number(b['sigma'], 2), f"{100.0 * b['share_of_error']:.0f} %",
             f"{b['same_sign']} of {b['flights']}", number(b['p_value'], 1)] for b in found[:MOST_ROWS]]
    return {'said': said, 'rows': rows, 'picture': curves(report, pairs) if pairs else ''}


def coefficients(loop: Dict[str, Any]) -> str:
    """Coefficients of the named effects over flights, as a PNG in base64."""
    chosen = [(name, spread) for effect in loop['effects'] for name, spread in effect['between_flights'].items()]
    rows = (len(chosen) + 1) // 2
    figure, panels = pyplot.subplots(rows, 2, figsize=(11.0, 2.1 * rows + 0.3), squeeze=False, layout='constrained')
    for panel, (name, spread) in zip(panels.flat, chosen):
        value, sigma = (np.array([f[key] if f[key] is not None else np.nan for f in spread['by_flight']], dtype=float)
                        for key in ('value', 'sigma'))
        at = np.arange(len(value))
        panel.axhspan(spread['mean'] - spread['sigma'], spread['mean'] + spread['sigma'], color=BAND, alpha=0.6)
        panel.axhline(spread['mean'], color=BLUE, linewidth=1.2)
        panel.axhline(0.0, color=GREY, linewidth=0.7)
        panel.errorbar(at, value, sigma, fmt='.', color=GREY, elinewidth=0.7, markersize=5)
        panel.set_title(f"{name} [{spread['unit']}]", fontsize=9, loc='left')
        panel.set_xlabel('flight', fontsize=8)
        panel.tick_params(labelsize=7)
    for panel in list(panels.flat)[len(chosen):]:
        panel.axis('off')
    return encoded(figure)


def errors_table(name: str, flights: List[Dict[str, Any]]) -> Optional[Dict[str, Any]]:
    """Errors before and after, root mean square over flights."""
    rows = []
    for label, before, after in (('force [N]', 'force_rmse_before_N', 'force_rmse_after_N'),
                                 ('torque [N m]', 'torque_rmse_before_Nm', 'torque_rmse_after_Nm')):
        pairs = [(f[before], f[after]) for f in flights if f.get(before) and f.get(after)]
        if not pairs:
            continue
        one, other = (np.sqrt(np.mean(np.square([p[k] for p in pairs]), axis=0)) for k in (0, 1))
        rows.append([label, axes(list(one)), axes(list(other)),
                     ' '.join(f'{b / a:.2f}' if a > 0 else '-' for a, b in zip(one, other))])
    return {'name': name, 'rows': rows} if rows else None


def loop_of(report: Dict[str, Any]) -> Optional[Dict[str, Any]]:
    """What `close_loop FLIGHT...` found, if the report is its."""
    loop = report.get('close_loop')
    if loop is None:
        return None
    tables = [errors_table('each flight by the parameters of all others', loop['left_out_in_turn']),
              errors_table('flights held out', loop['held_out'])]
    return {'verdict': loop['verdict'],
            'rows': [[e['name'], number(e['score'], 4), e['flights_for'], e['flights_against'], ', '.join(e['alternatives']) or '-']
                     for e in loop['effects']],
            'coefficients': [[name, number(s['mean'], 5), number(s['sigma'], 3), number(s['scatter'], 2),
                              f"{s['flights_within_2_sigma']} of {len(s['by_flight'])}", s['unit']]
                             for e in loop['effects'] for name, s in e['between_flights'].items()],
            'picture': coefficients(loop) if any(e['between_flights'] for e in loop['effects']) else '',
            'errors': [t for t in tables if t], 'warnings': loop['warnings']}


def part_of(name: str, report: Dict[str, Any], verdicts: Dict[str, str],
            reports: Optional[Dict[str, Dict[str, str]]] = None) -> Dict[str, Any]:
    """One vehicle's section of the page. reports: by flight its own report's 'link', or the 'command' that makes one."""
    reports = reports or {}
    force, torque = ratio(report, 'force_rmse_N'), ratio(report, 'torque_rmse_Nm')
    rows = []
    for flight in report['flights']:
        worst = max(flight['parameters'].items(), key=lambda item: abs(item[1]['z'] or 0.0))
        cells = [os.path.basename(flight['file']), number(flight['duration_s'], 3),
                 axes(flight['own_fit']['force_rmse_N']), axes(flight['left_out']['force_rmse_N']),
                 f"{worst[0]} {number(worst[1]['z'], 2)}", verdicts.get(flight['file'], '-')]
        rows.append({'cells': cells, 'report': reports.get(flight['file'], {})})
    how = '' if all('link' in r for r in reports.values()) and reports else HOW
    return {'name': name, 'flights': len(report['flights']),
            'hours': number(sum(f['duration_s'] for f in report['flights']) / 3600.0, 3),
            'ratio': {'force': force, 'torque': torque} if force else None, 'notes': notes(report),
            'parameters': [[n, number(p['value'], 5), number(p['sigma'], 3), number(p['scatter'], 3),
                            number(p['new_flight_sigma'], 3), p['unit']] for n, p in report['parameters'].items()],
            'picture': picture(report), 'rows': rows, 'recurrent': recurrent(report), 'loop': loop_of(report),
            'reports': bool(reports), 'how': how}


def page(title: str, parts: List[Dict[str, Any]], failed: List[Dict[str, str]],
         summary: Optional[List[List[str]]] = None, broken: Optional[List[str]] = None) -> str:
    """The whole page; it holds its pictures and needs no network."""
    environment = jinja2.Environment(autoescape=True, trim_blocks=True)
    return environment.from_string(TEMPLATE).render(title=title, parts=parts, failed=failed, summary=summary,
                                                    broken=broken)
