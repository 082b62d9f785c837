#!/usr/bin/python3
"""scripts/tidy_changed: which lines and sources it judges, what it finds, and that it ends in time."""

import importlib.machinery
import importlib.util
import io
import json
import os
import shutil
import sys
import tempfile
import time
import unittest
from contextlib import redirect_stdout
from typing import Any, Tuple

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
DIFF = """diff --git a/src/io/a.cpp b/src/io/a.cpp
--- a/src/io/a.cpp
+++ b/src/io/a.cpp
@@ -3,0 +4,2 @@ namespace odmc {
+int x;
+int y;
@@ -9 +11 @@ void F() {
-  old();
+  renewed();
@@ -20,3 +21,0 @@ void G() {
diff --git a/src/io/gone.cpp b/src/io/gone.cpp
--- a/src/io/gone.cpp
+++ /dev/null
@@ -1 +0,0 @@
-int gone;
"""


def load() -> Any:
    """The script as a module, without leaving its bytecode beside it."""
    loader = importlib.machinery.SourceFileLoader('tidy_changed', os.path.join(ROOT, 'scripts', 'tidy_changed'))
    spec = importlib.util.spec_from_loader('tidy_changed', loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode = True
    loader.exec_module(module)
    return module


TIDY = load()


def shown(*verdicts: Tuple[str, str, bool]) -> Tuple[int, str]:
    """Exit status and output for these verdicts."""
    out = io.StringIO()
    with redirect_stdout(out):
        status = TIDY.show([TIDY.Verdict(*v) for v in verdicts], 5.0)
    return status, out.getvalue()


class TidyChangedTest(unittest.TestCase):
    """A small tree of sources in place of the package."""

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.addCleanup(setattr, TIDY, 'ROOT', TIDY.ROOT)
        TIDY.ROOT = self.root = os.path.realpath(folder.name)
        self.write('include/odmc/io/a.h', '#pragma once\nclass lower_case {};\n')
        self.write('src/io/b.h', '#include "odmc/io/a.h"\n')
        self.write('src/io/a.cpp', '#include "odmc/io/a.h"\nint Fine() { return 1; }\nint bad_() { return 1; }\n')
        self.write('src/io/b.cpp', '#include "b.h"\n')
        self.write('src/io/c.cpp', '#include "io/b.h"\n')
        self.compiled = ['src/io/a.cpp', 'src/io/b.cpp', 'src/io/c.cpp']

    def write(self, path: str, text: str) -> None:
        """A file of the tree."""
        path = os.path.join(self.root, path)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, 'w', encoding='utf-8') as file:
            file.write(text)

    def database(self) -> None:
        """compile_commands.json in the folder build, as with gcc's precompiled headers."""
        flags = f'-I{self.root}/include -I{self.root}/src -Winvalid-pch -include {self.root}/build/cmake_pch.hxx'
        entries = [{'directory': self.root, 'file': os.path.join(self.root, path),
                    'command': f'/usr/bin/c++ {flags} -o x.o -c {self.root}/{path}'} for path in self.compiled]
        self.write('build/compile_commands.json', json.dumps(entries))
        self.write('build/cmake_pch.hxx.gch', 'of another compiler')

    def judge(self, lines: Any, seconds: float = 120.0) -> Any:
        """The verdict on a.cpp."""
        self.database()
        TIDY.readable_database(os.path.join(self.root, 'build'), self.root)
        shutil.copy(os.path.join(ROOT, '.clang-tidy'), self.root)
        return TIDY.judge('src/io/a.cpp', lines, self.root, time.monotonic() + seconds)

    def test_lines_that_a_diff_adds(self) -> None:
        self.assertEqual(TIDY.changed_lines(DIFF), {'src/io/a.cpp': [[4, 5], [11, 11]]})

    def test_a_header_comes_with_its_own_source(self) -> None:
        self.assertEqual(TIDY.sources_for({'src/io/b.h': [[1, 1]]}, self.compiled), ['src/io/b.cpp'])

    def test_a_header_that_a_changed_source_includes_takes_no_other(self) -> None:
        lines = {'include/odmc/io/a.h': [[1, 1]], 'src/io/c.cpp': [[1, 1]]}
        self.assertEqual(TIDY.sources_for(lines, self.compiled), ['src/io/c.cpp'])

    def test_what_changed_last_comes_first(self) -> None:
        self.assertEqual(TIDY.newest_first(self.compiled, 'src/io/c.cpp\nsrc/io/b.h\n\nsrc/io/a.cpp\nsrc/io/c.cpp\n'),
                         ['src/io/b.cpp', 'src/io/c.cpp', 'src/io/a.cpp'])

    @unittest.skipUnless(shutil.which('clang-tidy'), 'clang-tidy is not installed')
    def test_changed_lines_alone_are_judged_in_source_and_header(self) -> None:
        self.assertEqual(self.judge({'src/io/a.cpp': [[1, 2]]}).findings, '')
        self.assertIn('bad_', self.judge({'src/io/a.cpp': [[3, 3]]}).findings)
        self.assertIn('lower_case', self.judge({'include/odmc/io/a.h': [[2, 2]]}).findings)

    @unittest.skipUnless(shutil.which('clang-tidy'), 'clang-tidy is not installed')
    def test_a_source_that_clang_cannot_read_is_a_finding(self) -> None:
        self.write('src/io/a.cpp', '#include "nowhere.h"\n')
        self.assertIn('nowhere.h', self.judge({'src/io/a.cpp': [[1, 1]]}).findings)

    def test_no_time_leaves_a_source_out(self) -> None:
        self.assertFalse(self.judge({'src/io/a.cpp': [[1, 3]]}, seconds=0.0).judged)

    def test_what_is_left_out_is_named(self) -> None:
        status, out = shown(('a.cpp', '', True), ('b.cpp', '', False))
        self.assertEqual(status, 0)
        self.assertIn('left out: 1 of 2 changed sources, after 5 s of clang-tidy: b.cpp', out)

    def test_findings_decide_the_status(self) -> None:
        self.assertEqual(shown(('a.cpp', 'a.cpp:1: warning: x [y]', True), ('b.cpp', '', False))[0], 1)
        self.assertEqual(shown(('b.cpp', '', False))[0], 3)
        self.assertEqual(shown()[0], 0)


if __name__ == '__main__':
    unittest.main()
