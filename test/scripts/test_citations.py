"""Every section, equation and test of docs/model.md and every equation of docs/effects.md that is cited exists."""

import os
import re
import unittest
from typing import Iterator, List, Set, Tuple

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
FOLDERS = ('config', 'docs', 'include', 'launch', 'msg', 'scripts', 'src', 'test')
SECTION = r'\d{1,2}(?:\.\d{1,2})?'
# "model.md section 4.2", "model.md sections 2, 4.4 and 9", "[model.md](model.md) section 11", "model.md 12.1".
CITED = re.compile(r'model\.md(?:\]\([^)]*\))?,? (?:\(?sections? )?(' + SECTION + r'(?:(?:, | and |, and )' + SECTION +
                   r'(?!\w))*)(?:, test (\d+))?')
# "model.md Eq. (A), (B)", "model.md section 2, Eq. (M3)", "model.md 12.1 and 12.3, Eq. (M28), (M30)".
EQUATION = re.compile(r'model\.md(?:\]\([^)]*\))?(?:,? (?:sections? )?([\d., and]+))?,? Eq\. '
                      r'(\([A-Z]\w*\)(?:, \([A-Z]\w*\))*)')
# "docs/effects.md, Eq. (F1)", "docs/effects.md, Eq. (F9) to (F14)".
SERIES = re.compile(r'effects\.md(?:, "[^"]*")?, Eq\. \((F\d+)\)(?: to \((F\d+)\))?')


def texts() -> Iterator[Tuple[str, str]]:
    """Name and text of each file that may cite; comments joined over lines."""
    for folder in FOLDERS + ('README.md', 'CONTRIBUTING.md'):
        top = os.path.join(ROOT, folder)
        paths = [top] if os.path.isfile(top) else [os.path.join(at, name) for at, _, names in os.walk(top) for name in names]
        for path in sorted(paths):
            name = os.path.relpath(path, ROOT)
            if name in ('docs/model.md', 'test/scripts/test_citations.py') or name.startswith('test/fuzz/corpus'):
                continue
            try:
                with open(path, encoding='utf-8') as file:
                    yield name, re.sub(r'\n\s*(?:///?<?|#|\*)?\s*|"\s*\n\s*"', ' ', file.read())
            except UnicodeDecodeError:
                continue


def cited(text: str) -> List[Tuple[str, str]]:
    """Kind and name of each citation in a text."""
    found = []
    for match in CITED.finditer(text):
        found += [('section', number) for number in re.findall(SECTION, match.group(1))]
        if match.group(2):
            found.append(('test', match.group(2)))
    for match in EQUATION.finditer(text):
        found += [('equation', name) for name in re.findall(r'\w+', match.group(2))]
    for match in SERIES.finditer(text):
        found += [('equation', name) for name in match.groups() if name]
    return found


def misplaced(text: str) -> List[str]:
    """Equations that a text cites with sections in none of which they stand."""
    found = []
    for match in EQUATION.finditer(text):
        sections = re.findall(SECTION, match.group(1) or '')
        for name in re.findall(r'\w+', match.group(2)) if sections else ():
            at = section_of(name)
            if at not in sections and at.split('.')[0] not in sections:
                found.append(f'({name}) is in section {at}, not in {" or ".join(sections)}')
    return found


def section_of(equation: str) -> str:
    """Section of docs/model.md with this equation, '' if there is none."""
    with open(os.path.join(ROOT, 'docs', 'model.md'), encoding='utf-8') as file:
        before, tag, _ = file.read().partition(f'\\tag{{{equation}}}')
    headings = re.findall(r'^##+ (' + SECTION + r')\.? ', before, flags=re.MULTILINE)
    return headings[-1] if tag and headings else ''


def offered() -> Set[Tuple[str, str]]:
    """What docs/model.md has."""
    with open(os.path.join(ROOT, 'docs', 'model.md'), encoding='utf-8') as file:
        text = file.read()
    found = {('section', number) for number in re.findall(r'^##+ (' + SECTION + r')\.? ', text, flags=re.MULTILINE)}
    found |= {('equation', name) for name in re.findall(r'\\tag\{(\w+)\}', text)}
    with open(os.path.join(ROOT, 'docs', 'effects.md'), encoding='utf-8') as file:
        found |= {('equation', name) for name in re.findall(r'\((F\d+)\)', file.read())}
    tests = text[text.index('\n## 13.'):text.index('\n## 14.')]
    return found | {('test', number) for number in re.findall(r'^(\d+)\. ', tests, flags=re.MULTILINE)}


class CitationsTest(unittest.TestCase):
    """Citations against docs/model.md, and the reading of them."""

    def test_every_citation_is_there(self) -> None:
        have = offered()
        count = 0
        missing = []
        for name, text in texts():
            citations = cited(text)
            count += len(citations)
            missing += [f'{name}: {kind} {number}' for kind, number in citations if (kind, number) not in have]
        self.assertEqual(missing, [])
        self.assertGreater(count, 150)

    def test_equations_stand_in_the_sections_cited_with_them(self) -> None:
        self.assertEqual([f'{name}: {what}' for name, text in texts() for what in misplaced(text)], [])
        self.assertEqual(misplaced('model.md 12.3, Eq. (M28)'), ['(M28) is in section 12.1, not in 12.3'])

    def test_equations_have_one_number_each(self) -> None:
        with open(os.path.join(ROOT, 'docs', 'model.md'), encoding='utf-8') as file:
            text = file.read()
        tags = re.findall(r'\\tag\{(\w+)\}', text)
        self.assertEqual(len(tags), len(set(tags)))
        self.assertEqual(len(tags), text.count('\n$$\n') // 2)

    def test_forms_of_citations(self) -> None:
        self.assertEqual(cited('model.md sections 2, 4.4 and 9; paper Eq. (1)'),
                         [('section', '2'), ('section', '4.4'), ('section', '9')])
        self.assertEqual(cited('[model.md](model.md) section 11, the'), [('section', '11')])
        self.assertEqual(cited('model.md section 13, test 4.'), [('section', '13'), ('test', '4')])
        self.assertEqual(cited('model.md Eq. (A), (B)'), [('equation', 'A'), ('equation', 'B')])
        self.assertEqual(cited('model.md 12.1 and 12.3, Eq. (M28), (M30); paper Eq. (1)'),
                         [('section', '12.1'), ('section', '12.3'), ('equation', 'M28'), ('equation', 'M30')])
        self.assertEqual(cited('model.md section 2, Eq. (M3)'), [('section', '2'), ('equation', 'M3')])
        self.assertEqual(cited('12.1, Leishman; docs/effects.md, Eq. (F9) to (F14)'), [('equation', 'F9'), ('equation', 'F14')])
        self.assertEqual(cited('model.md 12.1, 12.3'), [('section', '12.1'), ('section', '12.3')])


if __name__ == '__main__':
    unittest.main()
