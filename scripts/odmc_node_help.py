"""What the nodes' --help says, read for the site, check_docs and the nodes' tests."""

import os
import re
import subprocess
import xml.etree.ElementTree
from typing import Dict, List, NamedTuple

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
# Each node with the launch file whose arguments document its parameters.
NODES = {'controller_node': 'controller.launch', 'estimator_node': 'estimator.launch', 'simulator_node': 'simulation.launch'}


class Entry(NamedTuple):
    """A topic or service."""
    name: str
    types: List[str]
    remark: str


class Help(NamedTuple):
    """The sections of a node's --help."""
    purpose: str
    commands: List[str]
    subscribes: List[Entry]
    publishes: List[Entry]
    services: List[Entry]
    parameters: Dict[str, str]  # with their defaults
    config_parameter: str       # which names a file that documents ...
    config: Dict[str, str]      # these, with their defaults
    config_example: str


def _items(lines: List[str]) -> List[List[str]]:
    """Name and text of each entry; a text goes on in lines that are indented further."""
    items: List[List[str]] = []
    for line in lines:
        entry = re.match(r'  (\S+)\s+(\S.*)$', line)
        if entry:
            items.append([entry.group(1), entry.group(2)])
        elif line.strip():
            items[-1][1] += ' ' + line.strip()
    return items


def _entries(lines: List[str]) -> List[Entry]:
    """Entries of a section of topics or services."""
    entries = []
    for name, text in _items(lines):
        types, _, remark = text.partition('; ')
        entries.append(Entry(name, types.split(', '), remark))
    return entries


def parse(text: str) -> Help:
    """What a --help says."""
    first, *parts = re.split(r'\n\n(?=\S)', text.rstrip('\n'))
    sections = {part.split('\n', 1)[0].split(',')[0].split(' that')[0].rstrip(':'): part.split('\n') for part in parts}
    title, commands = first.split('\n\n', 1)
    own, config = [p.split('\n') for p in parts if p.startswith('Parameters')]
    named = re.search(r'the file `(\w+)`.*\((\S+) documents them\)', config[0])
    assert named, config[0]
    return Help(title.split(': ', 1)[1], [line.strip() for line in commands.split('\n')],
                *(_entries(sections[name][1:]) for name in ('Subscribes', 'Publishes', 'Services')),
                parameters={name: default for name, default in _items(own[1:])}, config_parameter=named.group(1),
                config={name: default for name, default in _items(config[1:])}, config_example=named.group(2))


def help_of(program: str) -> Help:
    """What a node says of itself."""
    return parse(subprocess.run([program, '--help'], capture_output=True, text=True, check=True, timeout=60).stdout)


def launch_texts(node: str) -> Dict[str, str]:
    """What the arguments of a launch file say of the private parameters of a node that they set."""
    tree = xml.etree.ElementTree.parse(os.path.join(ROOT, 'launch', NODES[node])).getroot()
    said = {arg.get('name', ''): ' '.join(arg.get('doc', '').split()) for arg in tree.findall('arg')}
    texts = {}
    for element in tree.iter('node'):
        if element.get('type') != node:
            continue
        for parameter in element.findall('param'):
            argument = re.fullmatch(r'\$\(arg (\w+)\)', parameter.get('value', ''))
            if argument and said.get(argument.group(1)):
                texts[parameter.get('name', '')] = said[argument.group(1)]
    return texts


class Key(NamedTuple):
    """A key of an options file."""
    group: str  # title of its part of the file
    text: str   # comment beside it and on the lines after it


def config_keys(path: str) -> Dict[str, Key]:
    """The keys of an options file of this package."""
    keys: Dict[str, Key] = {}
    group = key = ''
    with open(os.path.join(ROOT, path), encoding='utf-8') as file:
        for line in file:
            title = re.match(r'# ---- (.*) ----$', line)
            entry = re.match(r'(\w+):[^#]*(?:#\s*(.*))?$', line)
            more = re.match(r'\s+#\s*(.*)$', line)
            if title:
                group = title.group(1)
            if entry:
                key = entry.group(1)
                keys[key] = Key(group, (entry.group(2) or '').strip())
            elif more and key:
                keys[key] = Key(group, f'{keys[key].text} {more.group(1)}'.strip())
            else:
                key = ''
    return keys


def section_of(document: str, node: str) -> List[str]:
    """The lines of a document under the heading whose section begins with the node's name in code."""
    for part in re.split(r'^(?=## )', document, flags=re.MULTILINE):
        if re.match(r'## .*\n\n`%s`' % node, part):
            return part.split('\n')
    return []


def table_rows(lines: List[str], title: str) -> List[List[str]]:
    """Cells of the rows of all tables whose first column has this title."""
    rows: List[List[str]] = []
    inside = False
    for line in lines:
        cells = [cell.strip() for cell in line.strip().strip('|').split(' | ')] if line.startswith('|') else []
        if not cells:
            inside = False
        elif inside and not line.startswith('| ---'):
            rows.append(cells)
        elif cells[0].rstrip(' |') == title:
            inside = True
    return rows


def named(cell: str) -> List[str]:
    """What stands as `code` in a cell."""
    return re.findall(r'`([^`]+)`', cell)


def document_texts(document: str, node: str) -> Dict[str, str]:
    """What docs/node.md says of parameters that neither a launch file nor an options file has."""
    rows = table_rows(section_of(document, node), 'parameter')
    return {name: cells[-1].rstrip(' |') for cells in rows for name in named(cells[0])}


def faults(node: str, said: Help, document: str) -> List[str]:
    """Where docs/node.md disagrees with a node's --help, and which parameters are documented nowhere."""
    section = section_of(document, node)
    if not section:
        return [f'no section begins with `{node}`']
    wrong = []
    for title, entries, only in (('subscribes', said.subscribes, False), ('publishes', said.publishes, True),
                                 ('service', said.services, True)):
        left = {entry.name: entry for entry in entries}
        for cells in table_rows(section, title):
            names, types = named(cells[0]), named(cells[1])
            known = [left.pop(name) for name in names if name in left]
            wrong += [f'{title} {name}, which its --help does not name, or twice' for name in names
                      if name not in {entry.name for entry in known}]
            told = {kind for entry in known for kind in entry.types}
            wrong += [f'{title} {names[0]}: its type {kind} is not named' for kind in sorted(told)
                      if kind not in types and kind.split('/')[1] not in types]
            if only:
                wrong += [f'{title} {names[0]} has no type {kind}' for kind in types if known and kind not in told]
        wrong += [f'{title} {name}, which is not in the table' for name in left]
    texts = {**launch_texts(node), **{key: one.text for key, one in config_keys(said.config_example).items()}}
    extra = document_texts(document, node)
    parameters = {**said.parameters, **said.config}
    wrong += [f'has no parameter {name}' for name in extra if name not in parameters]
    wrong += [f'parameter {name} is explained in {NODES[node]} or {said.config_example} already' for name in extra
              if texts.get(name)]
    wrong += [f'parameter {name} is explained neither in {NODES[node]} nor in {said.config_example} nor here'
              for name in parameters if not texts.get(name) and not extra.get(name)]
    return wrong
