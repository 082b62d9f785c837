"""Runs calibrate on faulty recordings, in temporary folders, with bounds on time and memory."""

import concurrent.futures
import contextlib
import json
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from typing import Any, Dict, List, Optional

import numpy as np
import yaml

from .bases import Base
from .catalogue import Case
from .recording import Recording
from .scoring import Run, Score, judge

TIMEOUT_S = 120.0
MEMORY_BYTES = 4 << 30
ERROR_LENGTH = 600


@dataclass
class Setting:
    """What is the same for all cases of a campaign."""
    calibrate: List[str]
    seed: int
    keep: Optional[str]
    bases: Dict[str, Base]
    unspoiled: Dict[str, Dict[str, Any]]
    cases: List[Case]


SETTING: Optional[Setting] = None  # of the worker processes, which are forked


def folder_name(case_name: str) -> str:
    """A case's name as the name of a folder."""
    return ''.join(c if c.isalnum() or c in '._+-@=' else '_' for c in case_name)


def write(folder: str, rec: Recording, vehicle: Dict[str, Any], rng: np.random.Generator) -> None:
    """Writes flight.csv and vehicle.yaml."""
    rec.write(folder, rng)
    with open(os.path.join(folder, 'vehicle.yaml'), 'w', encoding='utf-8') as file:
        yaml.safe_dump(vehicle, file, default_flow_style=None)


def bounded() -> None:
    """Bounds the memory of a child process."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))


def calibrate(command: List[str], folder: str) -> Run:
    """Runs calibrate on a folder with flight.csv and vehicle.yaml."""
    out = os.path.join(folder, 'out')
    begin = time.monotonic()
    with subprocess.Popen(command + [os.path.join(folder, 'flight.csv'), '--vehicle',
                                     os.path.join(folder, 'vehicle.yaml'), '--no-report', '--out',
                                     out],
                          stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                          errors='replace', start_new_session=True, preexec_fn=bounded) as child:
        try:
            _, error = child.communicate(timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.communicate()
            return Run(None, '', None, TIMEOUT_S)
    report = None
    path = os.path.join(out, 'report.json')
    if child.returncode == 0 and os.path.exists(path):
        with open(path, encoding='utf-8') as file:
            report = json.load(file)
    return Run(child.returncode, error.strip()[-ERROR_LENGTH:], report, time.monotonic() - begin)


def run_unspoiled(command: List[str], base: Base) -> Run:
    """calibrate on an unspoiled flight, written as faulty ones are."""
    with tempfile.TemporaryDirectory(prefix='fault_campaign_') as folder:
        write(folder, base.rec, base.vehicle, np.random.default_rng(0))
        return calibrate(command, folder)


def one(index: int) -> Dict[str, Any]:
    """Makes, runs and judges a case of the setting; in a worker process."""
    assert SETTING is not None
    case = SETTING.cases[index]
    folder = tempfile.mkdtemp(prefix='fault_campaign_')
    try:
        return run_case(case, SETTING, folder)
    except Exception:  # a fault of ours must not end the campaign, but must be seen
        return {'case': case.name, 'class': case.fault.name, 'base': case.base,
                'not_made': traceback.format_exc(limit=-3)}
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run_case(case: Case, setting: Setting, folder: str) -> Dict[str, Any]:
    """A case's row of the result."""
    spoiled = case.spoil(setting.bases[case.base], setting.seed)
    write(folder, spoiled.rec, spoiled.vehicle, np.random.default_rng(setting.seed))
    if setting.keep:
        kept = os.path.join(setting.keep, folder_name(case.name))
        shutil.copytree(folder, kept, dirs_exist_ok=True)
    run = calibrate(setting.calibrate, folder)
    score = judge(run, case.fault, case.scale, setting.unspoiled[case.base], spoiled.span)
    return row(case, score, run, spoiled.span)


def row(case: Case, score: Score, run: Run, span: Any) -> Dict[str, Any]:
    """A result as it is written."""
    return {'case': case.name, 'class': case.fault.name, 'base': case.base,
            'outcome': score.outcome, 'k_f_percent': score.k_f_percent,
            'k_f_sigmas': score.k_f_sigmas, 'worst': score.worst,
            'worst_sigmas': score.worst_sigmas, 'trust': score.trust,
            'unrelated': score.unrelated, 'said': score.said, 'seconds': run.seconds,
            'span_s': list(span) if span else None}


def run_all(setting: Setting, jobs: int, journal: Optional[str] = None) -> List[Dict[str, Any]]:
    """Runs all cases in so many processes; results in the cases' order.

    journal: a file that gets each result as it comes; cases that it has, of the same seed, are not run again.
    """
    global SETTING
    SETTING = setting
    count = len(setting.cases)
    rows = {name: row for name, row in earlier(journal, setting.seed).items()
            if name in {case.name for case in setting.cases}}
    left = [k for k, case in enumerate(setting.cases) if case.name not in rows]
    if rows:
        print(f'{len(rows)} of {count} are in {journal}', file=sys.stderr, flush=True)
    context = multiprocessing.get_context('fork')
    with contextlib.ExitStack() as stack:
        pool = stack.enter_context(concurrent.futures.ProcessPoolExecutor(jobs, mp_context=context))
        file = stack.enter_context(open(journal, 'a', encoding='utf-8')) if journal else None
        if file and file.tell() > 0:
            file.write('\n')  # ends a line that was cut off
        for done in pool.map(one, left, chunksize=2):
            rows[done['case']] = done
            if file:
                file.write(json.dumps({'seed': setting.seed, **done}) + '\n')
                file.flush()
            if len(rows) % 50 == 0:
                print(f'{len(rows)} of {count}', file=sys.stderr, flush=True)
    return [rows[case.name] for case in setting.cases]


def earlier(journal: Optional[str], seed: int) -> Dict[str, Dict[str, Any]]:
    """Results of a journal, by case; a last line that was cut off does not count."""
    rows: Dict[str, Dict[str, Any]] = {}
    if journal and os.path.isfile(journal):
        with open(journal, encoding='utf-8') as file:
            for line in file:
                with contextlib.suppress(ValueError):
                    row = json.loads(line)
                    if row.pop('seed') == seed:
                        rows[row['case']] = row
    return rows
