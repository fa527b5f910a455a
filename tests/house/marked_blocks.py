"""The README's code blocks that are under test.

A block is marked by a comment on the line before its fence: `<!-- test: NAME -->`.
"""
import pathlib
import re

BLOCK = re.compile(r'<!-- test: (?P<name>[^\n]+?) -->\n```\w+\n(?P<text>.*?)^```', re.M | re.S)


def marked_blocks(source):
    """Name -> text of every marked block, in order."""
    readme = (pathlib.Path(source) / 'README.md').read_text()
    blocks = {match['name']: match['text'] for match in BLOCK.finditer(readme)}
    if len(blocks) != readme.count('<!-- test: '):
        raise SystemExit('README.md: a mark without a block, or two blocks of one name')
    return blocks
