#!/usr/bin/python3
"""scripts/code_figures on made-up trees: which functions it finds, and what it counts."""

import importlib.machinery
import importlib.util
import io
import os
import sys
import tempfile
import textwrap
import unittest
from contextlib import redirect_stderr, redirect_stdout
from typing import Any, Dict, List, Tuple

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))


def load() -> Any:
    """The script as a module, without leaving its bytecode beside it."""
    loader = importlib.machinery.SourceFileLoader('code_figures', os.path.join(ROOT, 'scripts', 'code_figures'))
    spec = importlib.util.spec_from_loader('code_figures', loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode = True
    loader.exec_module(module)
    return module


FIGURES = load()


def found(text: str) -> List[Tuple[str, int, int]]:
    """Name, first line and length of the functions in a source."""
    return [tuple(f) for f in FIGURES.functions_of(textwrap.dedent(text).lstrip('\n'))]


def run(*arguments: str) -> Tuple[int, str, str]:
    """Status and output of the script."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = FIGURES.main(list(arguments))
    return status, out.getvalue(), err.getvalue()


class Functions(unittest.TestCase):
    """What counts as a function, and how long it is."""

    def test_heads_of_several_lines_count(self) -> None:
        self.assertEqual(found('''
            #include <map>
            namespace a { namespace {
            /// Says (something) {
            std::map<int, int> Long(int a,
                                    int b = {}) {
              return {{a, b}};
            }
            }  // namespace
            int Short() { return 1; }
            }
            '''), [('Long', 4, 4), ('Short', 9, 1)])

    def test_members_operators_and_constructors_are_functions(self) -> None:
        self.assertEqual(found('''
            /// A class.
            class A final : public B<int> {
             public:
              A(int x) : x_(x), y_{x} {
              }
              ~A() override {}
              bool operator==(const A& a) const { return x_ == a.x_; }
              int operator()() const noexcept { return 1; }
              auto Get() const -> int { return x_; }
              template <typename T = std::vector<int>>
              void Set(T t) { x_ = t; }
             private:
              int x_{0}, y_ = {1};
              std::function<void(int)> f_{};
            };
            A::A()
                : x_(1) {}
            '''), [('A', 4, 2), ('~A', 6, 1), ('operator==', 7, 1), ('operator()', 8, 1), ('Get', 9, 1), ('Set', 10, 2),
                   ('A::A', 16, 2)])

    def test_lambdas_values_and_types_are_none(self) -> None:
        self.assertEqual(found('''
            enum class E { kOne, kTwo };
            struct S { int a; };
            const std::vector<S> kList = {{1}, {2}};
            const auto f = [](int a) { return a; };
            void G() {
              const auto g = [] { return 1; };
              struct Inner { int Get() { return 1; } };
              if (g()) { return; }
            }
            '''), [('G', 5, 5)])

    def test_texts_and_other_branches_mislead_it_not(self) -> None:
        self.assertEqual(found(r'''
            void A() { Print("}{ \" {"); Print('{'); Print(R"x(
            }}} " )x"); const int n = 1'000; }
            #if SOME
            void B(int a) {
            #else
            void B() {
            #endif
              /* } */
            }
            #define OPEN {   \
              {
            void C() {}
            '''), [('A', 1, 2), ('B', 4, 6), ('C', 12, 1)])


class Tree(unittest.TestCase):
    """Whole folders."""

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name
        self.write({'include/a.h': '/// A.\n\nint A();  // one\n/* two\n   lines */\n',
                    'src/a.cpp': 'int A() {\n  return 1;\n}\n' + 'void B() {\n' + '  A();\n' * 70 + '}\n',
                    'test/test_a.cpp': 'void T() {\n' + '  A();\n' * 100 + '}\n',
                    'src/a_test.cc': '\n\nint t;\n',
                    'third_party/x.h': 'int x;\n', '.git/y.h': 'int y;\n', 'build/z.cpp': 'int z;\n'})

    def write(self, files: Dict[str, str]) -> None:
        """Writes files below the folder."""
        for path, text in files.items():
            path = os.path.join(self.folder, path)
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(path, 'w', encoding='utf-8') as file:
                file.write(text)

    def test_the_row_has_lines_lengths_tests_and_comments(self) -> None:
        status, out, _ = run(f'small={self.folder}')
        self.assertEqual(status, 0)
        cells = [cell.strip() for cell in out.splitlines()[2].strip('|').split('|')]
        # 4 lines of header, 3 + 72 of source, 102 + 1 of tests; functions of 3 and 72 lines.
        self.assertEqual(cells, ['small', '4', '75', '2', '3', '3', '50.0 %', '1.30', '75 %'])

    def test_long_functions_are_listed_with_their_place(self) -> None:
        status, out, _ = run('--above', '60', self.folder)
        self.assertEqual(status, 0)
        self.assertEqual(out, '  72 src/a.cpp:4 B\n')

    def test_folders_and_files_can_be_left_out(self) -> None:
        status, out, _ = run('--leave-out', 'include', '--leave-out', 'a.cpp', '--leave-out', 'a_test.cc', self.folder)
        self.assertEqual(status, 0)
        self.assertEqual([cell.strip() for cell in out.splitlines()[2].split('|')[2:5]], ['0', '0', '0'])

    def test_a_folder_that_is_none_is_refused(self) -> None:
        status, out, err = run('x=/nowhere')
        self.assertEqual((status, out), (1, ''))
        self.assertIn('/nowhere is no folder', err)


if __name__ == '__main__':
    unittest.main()
