#!/usr/bin/python3
"""Prints "PASSED FAILED SKIPPED,NAMES" of one test suite's log (gtest, unittest or rostest)."""

import re
import sys
from typing import List, Tuple


def counts(name: str, text: str, status: int) -> Tuple[int, int, List[str]]:
    """Figures of one log; a suite that died without closing lines counts as one failure."""
    text = re.sub(r'\x1b\[[0-9;]*m', '', text)  # colours
    skipped = re.findall(r'^\[  SKIPPED \] ([^\d\s]\S*?) \(', text, flags=re.MULTILINE)
    skipped = sorted(set(skipped))
    if re.search(r'\[==========\] .* ran\.', text):  # gtest
        passed = sum(int(n) for n in re.findall(r'\[  PASSED  \] (\d+) tests?', text))
        failed = sum(int(n) for n in re.findall(r'\[  FAILED  \] (\d+) tests?, listed', text))
    elif re.search(r'^ \* TESTS: (\d+)', text, flags=re.MULTILINE):  # rostest
        total = int(re.findall(r'^ \* TESTS: (\d+)', text, flags=re.MULTILINE)[-1])
        failed = sum(int(re.findall(rf'^ \* {kind}: (\d+)', text, flags=re.MULTILINE)[-1])
                     for kind in ('ERRORS', 'FAILURES'))
        passed = total - failed
    elif re.search(r'^Ran (\d+) tests?', text, flags=re.MULTILINE):  # unittest
        total = int(re.findall(r'^Ran (\d+) tests?', text, flags=re.MULTILINE)[-1])
        failed = sum(int(n) for n in re.findall(r'(?:failures|errors)=(\d+)', text))
        skipped = re.findall(r'^(\S+) .*\.\.\. skipped', text, flags=re.MULTILINE)
        passed = total - failed - len(skipped)
    else:
        return 0, 1, []
    if status != 0 and failed == 0:
        failed = 1
    return passed, failed, [f'{name}.{case}' for case in skipped]


def main() -> int:
    """Reads NAME LOG STATUS from the command line."""
    name, path, status = sys.argv[1:4]
    with open(path, encoding='utf-8', errors='replace') as file:
        passed, failed, skipped = counts(name, file.read(), int(status))
    print(passed, failed, ','.join(skipped))
    return 0


if __name__ == '__main__':
    sys.exit(main())
