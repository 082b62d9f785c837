"""How one run of calibrate is judged against that on the unspoiled flight."""

import re
from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional, Tuple

from .catalogue import Fault

RIGHT, REFUSED, NAMED = 'right', 'refused', 'named'
GROWN, VAGUE, SILENT = 'grown', 'vague', 'silent'
CRASHED, TIMEOUT = 'crashed', 'timeout'
OUTCOMES = (RIGHT, REFUSED, NAMED, GROWN, VAGUE, SILENT, CRASHED, TIMEOUT)
GOOD = (RIGHT, REFUSED, NAMED)

K_F = 'thrust.k_f'
DRAG = ('drag.d_x', 'drag.d_y', 'drag.d_z')
K_F_TOLERANCE = 0.03
SIGMAS = 3.0
MARGIN_S = 0.5  # a finding's span may miss the fault's by so much


@dataclass
class Run:
    """What a run of calibrate left: its exit status (negative: a signal; None: ran out of time),
    what it said on stderr, and report.json."""
    status: Optional[int]
    error: str
    report: Optional[Dict[str, Any]]
    seconds: float = 0.0


@dataclass
class Score:
    """The judgement of one case."""
    outcome: str
    k_f_percent: Optional[float] = None
    k_f_sigmas: Optional[float] = None
    worst: str = ''  # parameter, beside k_f, that is off most, with both values
    worst_sigmas: Optional[float] = None
    trust: str = ''
    said: List[str] = field(default_factory=list)  # findings and new warnings
    unrelated: bool = False  # something that costs trust was found, but not the cause


def gist(sentence: str) -> str:
    """A warning without its figures and the axes they belong to, to tell new ones from old."""
    text = re.sub(r'(?:(?<=: )|(?<=, )|(?<=against )|(?<=in N m ))[xyz] (?=[-+\d])', '', sentence)
    text = re.sub(r'[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?', '#', text)
    return re.sub(r'#(?:, #)+', '#', text)


def new_warnings(report: Dict[str, Any], unspoiled: Dict[str, Any]) -> List[str]:
    """Warnings the unspoiled flight does not have."""
    old = {gist(w) for w in unspoiled.get('warnings', [])}
    return [w for w in report.get('warnings', []) if gist(w) not in old]


def new_findings(report: Dict[str, Any], unspoiled: Dict[str, Any]) -> List[Dict[str, Any]]:
    """Findings the unspoiled flight does not have."""
    old = {(f['check'], gist(f['what'])) for f in unspoiled.get('findings', [])}
    return [f for f in report.get('findings', []) if (f['check'], gist(f['what'])) not in old]


def is_other(finding: Dict[str, Any], unspoiled: Dict[str, Any]) -> bool:
    """Whether the unspoiled flight lacks a finding, or has it with other figures (an offset of 8 ms
    where it is 58 now): one of them differs by more than a quarter."""
    for old in unspoiled.get('findings', []):
        if (old['check'], gist(old['what'])) != (finding['check'], gist(finding['what'])):
            continue
        pairs = zip(numbers(old['what']), numbers(finding['what']))
        alike = all(abs(a - b) <= 0.25 * abs(a) for a, b in pairs)
        if alike and old['leaves'] == finding['leaves']:
            return False
    return True


def numbers(text: str) -> List[float]:
    """The figures in a sentence."""
    return [float(x) for x in re.findall(r'[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?', text)]


def names_cause(finding: Dict[str, Any], fault: Fault, span: Optional[Tuple[float, float]]) -> bool:
    """Whether a finding is about the fault: by its check or its words and, where both have a time,
    at that time."""
    if finding['check'] == 'stream_doubt':  # what is not excluded, in a sigma: not what is wrong
        return False
    words = f"{finding['what']} {finding.get('mend', '')}"
    if finding['check'] not in fault.checks and not re.search(fault.words, words, re.IGNORECASE):
        return False
    if span is None or 'from_s' not in finding:
        return True
    return finding['from_s'] < span[1] + MARGIN_S and finding['to_s'] > span[0] - MARGIN_S


def is_named(run: Run, fault: Fault, unspoiled: Dict[str, Any],
             span: Optional[Tuple[float, float]]) -> bool:
    """Whether a finding, a new warning or the error names the cause."""
    if run.report is None:
        return bool(re.search(fault.words, run.error, re.IGNORECASE))
    findings = run.report.get('findings', [])
    if any(names_cause(f, fault, span) and is_other(f, unspoiled) for f in findings):
        return True
    return any(re.search(fault.words, w, re.IGNORECASE)
               for w in new_warnings(run.report, unspoiled)
               if not any(f['what'] in w for f in findings))


def difference(name: str, report: Dict[str, Any], unspoiled: Dict[str, Any],
               scale: float) -> Tuple[float, float]:
    """Difference of a parameter to `scale` times the unspoiled one, and its sigma: the root of the
    sum of both sigmas' squares."""
    a, b = report['parameters'][name], unspoiled['parameters'][name]
    sigma = (a['sigma'] ** 2 + (scale * b['sigma']) ** 2) ** 0.5
    return a['value'] - scale * b['value'], sigma


def compared(name: str, report: Dict[str, Any], unspoiled: Dict[str, Any]) -> bool:
    """Whether a parameter is estimated and observable in both runs."""
    both = [r['parameters'].get(name) for r in (report, unspoiled)]
    return all(p is not None and p['state'] == 'estimated' and p['observable'] for p in both)


def judge(run: Run, fault: Fault, scale: float, unspoiled: Dict[str, Any],
          span: Optional[Tuple[float, float]]) -> Score:
    """The outcome of a case."""
    if run.status is None:
        return Score(TIMEOUT)
    if run.status < 0 or run.status >= 128:
        return Score(CRASHED, said=[run.error])
    named = is_named(run, fault, unspoiled, span)
    if run.report is None:
        refused = run.status == 1 and named
        return Score(REFUSED if refused else VAGUE, said=[f'exit {run.status}: {run.error}'])
    score = figures(run.report, fault, scale, unspoiled)
    findings = new_findings(run.report, unspoiled)
    warnings = new_warnings(run.report, unspoiled)
    score.said = [f"[{f['check']}] {f['what']}" for f in findings] + \
        [w for w in warnings if not any(f['what'] in w for f in findings)]
    score.trust = run.report.get('trust', '')
    score.unrelated = not named and any(f['leaves'] != 'good' for f in findings)
    score.outcome = outcome(score, named, bool(score.said) or score.trust != 'good')
    return score


def figures(report: Dict[str, Any], fault: Fault, scale: float,
            unspoiled: Dict[str, Any]) -> Score:
    """How far k_f and the worst other parameter are off."""
    score = Score('')
    off, sigma = difference(K_F, report, unspoiled, scale)
    score.k_f_percent = 100.0 * off / (scale * unspoiled['parameters'][K_F]['value'])
    score.k_f_sigmas = off / sigma if sigma > 0.0 else 0.0
    score.worst_sigmas = 0.0
    for name in DRAG + fault.also:
        if not compared(name, report, unspoiled):
            continue
        factor = scale if name in DRAG else 1.0
        off, sigma = difference(name, report, unspoiled, factor)
        if abs(off) > abs(score.worst_sigmas) * sigma:
            score.worst_sigmas = off / sigma
            a, b = report['parameters'][name], unspoiled['parameters'][name]
            score.worst = f"{name} {a['value']:.3g}, unspoiled {factor * b['value']:.3g}"
    return score


def outcome(score: Score, named: bool, warned: bool) -> str:
    """The outcome by figures and by what was said."""
    others = abs(score.worst_sigmas or 0.0) <= SIGMAS
    inside = abs(score.k_f_sigmas or 0.0) <= SIGMAS
    close = abs(score.k_f_percent or 0.0) <= 100.0 * K_F_TOLERANCE
    if others and inside and close:
        return RIGHT
    if named:
        return NAMED
    if others and inside:
        return GROWN
    return VAGUE if warned else SILENT
