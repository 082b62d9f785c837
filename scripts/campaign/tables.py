"""Results of a campaign as tables and lists."""

import csv
import json
import os
from typing import Any, Dict, List, Optional

from .catalogue import Fault
from .scoring import GOOD, OUTCOMES, SILENT, VAGUE

Row = Dict[str, Any]
HEADINGS = {'right': 'right', 'refused': 'refused', 'named': 'named', 'grown': 'in a grown sigma',
            'vague': 'wrong, vague', 'silent': 'wrong, silent', 'crashed': 'crashed',
            'timeout': 'timed out'}


def badness(row: Row) -> float:
    """How far off a case is, to find the worst: percent of k_f, and one per ten sigma."""
    percent, sigmas = abs(row.get('k_f_percent') or 0.0), abs(row.get('worst_sigmas') or 0.0)
    return percent + 0.1 * sigmas


def figures(row: Row) -> str:
    """k_f, and the worst other parameter."""
    if row.get('k_f_percent') is None:
        return row['said'][0] if row.get('said') else ''
    text = f"k_f {row['k_f_percent']:+.2g} % ({row['k_f_sigmas']:+.1f} sigma)"
    if row['worst'] and abs(row['worst_sigmas']) > 3.0:
        text += f"; {row['worst']} ({row['worst_sigmas']:+.1f} sigma)"
    return text


def count(rows: List[Row], outcome: str) -> int:
    """Cases with an outcome."""
    return sum(r.get('outcome') == outcome for r in rows)


def cells(title: str, rows: List[Row], worst: str) -> str:
    """One line of the table."""
    good = sum(count(rows, o) for o in GOOD)
    numbers = [str(count(rows, o) or '') for o in OUTCOMES]
    share = f'{100.0 * good / len(rows):.0f} %' if rows else ''
    return f"| {title} | {len(rows)} | {' | '.join(numbers)} | {share} | {worst} |"


def by_class(faults: List[Fault], rows: List[Row]) -> List[str]:
    """The table by class; the control is not in its sum."""
    lines = ['| class | cases | ' + ' | '.join(HEADINGS[o] for o in OUTCOMES)
             + ' | right, refused or named | worst of the wrong |',
             '|---' * (len(OUTCOMES) + 4) + '|']
    for fault in faults:
        mine = [r for r in rows if r['class'] == fault.name and 'outcome' in r]
        if mine:
            bad = [r for r in mine if r['outcome'] not in GOOD]
            worst = max(bad, key=badness, default=None)
            text = f"{short(worst)}: {figures(worst)}" if worst else ''
            lines.append(cells(fault.title, mine, text.replace('|', '/').replace('\n', ' ')))
    counted = [r for r in rows if 'outcome' in r and r['class'] != 'control']
    return lines + [cells('**all but the control**', counted, '')]


def short(row: Row) -> str:
    """A case's name without its class."""
    return f"`{row['case'].split('/', 1)[1]}`"


def by_base(rows: List[Row]) -> List[str]:
    """The table by base flight."""
    lines = ['| flight | cases | ' + ' | '.join(HEADINGS[o] for o in OUTCOMES)
             + ' | right, refused or named |', '|---' * (len(OUTCOMES) + 3) + '|']
    for base in dict.fromkeys(r['base'] for r in rows):
        mine = [r for r in rows if r['base'] == base and 'outcome' in r and r['class'] != 'control']
        lines.append(cells(base, mine, '').rsplit('|', 2)[0] + '|')
    return lines


def classes(faults: List[Fault]) -> List[str]:
    """What names the cause of each class, and what is right where that isn't obvious."""
    lines = ['| class | what | checks that name it | words that name it | right |',
             '|---|---|---|---|---|']
    for f in faults:
        words = f.words.replace('|', '\\|')
        lines.append(f"| {f.name} | {f.title} | {', '.join(f.checks)} | `{words}` | {f.right} |")
    return lines


def listed(rows: List[Row], outcome: str, limit: Optional[int] = None) -> List[str]:
    """The cases of an outcome, the worst first, with figures and what was said."""
    chosen = sorted((r for r in rows if r.get('outcome') == outcome), key=badness, reverse=True)
    lines = []
    for r in chosen[:limit]:
        lines.append(f"{r['case']}: {figures(r)}")
        if outcome == VAGUE:
            lines += [f'    {said}' for said in r['said'][:4]]
    return lines


def summary(rows: List[Row]) -> List[str]:
    """The targets' figures in sentences."""
    counted = [r for r in rows if 'outcome' in r and r['class'] != 'control']
    if not counted:
        return []
    good = sum(count(counted, o) for o in GOOD)
    share = 100.0 / len(counted)
    false = sum(bool(r.get('unrelated')) and r['outcome'] == 'right' for r in counted)
    return [f'{len(counted)} cases in {len({r["class"] for r in counted})} classes: '
            f'{good} ({share * good:.1f} %) right, refused or named; '
            f'{count(counted, SILENT)} ({share * count(counted, SILENT):.1f} %) wrong without a '
            f'word; {count(counted, VAGUE)} ({share * count(counted, VAGUE):.1f} %) wrong beside '
            f'something unrelated; {false} right, with a finding that is not their cause']


def write(folder: str, rows: List[Row]) -> None:
    """Writes cases.csv and cases.json."""
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, 'cases.json'), 'w', encoding='utf-8') as file:
        json.dump(rows, file, indent=1)
    names = ['case', 'class', 'base', 'outcome', 'k_f_percent', 'k_f_sigmas', 'worst',
             'worst_sigmas', 'trust', 'unrelated', 'seconds', 'said', 'not_made']
    with open(os.path.join(folder, 'cases.csv'), 'w', encoding='utf-8', newline='') as file:
        writer = csv.DictWriter(file, names, extrasaction='ignore')
        writer.writeheader()
        for r in rows:
            writer.writerow({**r, 'said': ' // '.join(r.get('said', []))})
