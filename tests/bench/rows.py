"""The table: rows with their bounds, and how they are printed."""
import statistics
from dataclasses import dataclass

from measure import spread


@dataclass
class Row:
    """One promise, or one figure for context. `values` are those of the rounds, none when it was not
    measured. A bound is held against the median."""
    what: str
    values: list
    unit: str
    at_most: float | None = None
    at_least: float | None = None
    aim: float | None = None
    note: str = ''

    def met(self):
        """Whether the bound holds; None without a bound or figures."""
        if not self.values or (self.at_most is None and self.at_least is None):
            return None
        median = statistics.median(self.values)
        return median <= self.at_most if self.at_most is not None else median >= self.at_least

    def wanted_text(self):
        if self.at_most is None and self.at_least is None:
            return ''
        sign, bound = ('<=', self.at_most) if self.at_most is not None else ('>=', self.at_least)
        return f'{sign} {bound:g}' + (f' (aim {self.aim:g})' if self.aim else '')

    def to_json(self):
        figures = dict(zip(('median', 'min', 'max'), spread(self.values))) if self.values else {}
        return {**vars(self), **figures, 'met': self.met()}


def number(value):
    """Three significant digits, without an exponent."""
    if value >= 100:
        return f'{value:,.0f}'
    return f'{value:.3g}'


def spread_text(values, unit):
    if not values:
        return '–'
    median, low, high = map(number, spread(values))
    return f'{median} {unit} ({low}–{high})'


def markdown_table(header, body):
    widths = [max(len(row[i]) for row in [header, *body]) for i in range(len(header))]
    rule = ['-' * width for width in widths]
    return '\n'.join('| ' + ' | '.join(cell.ljust(width) for cell, width in zip(row, widths)) + ' |'
                     for row in [header, rule, *body]) + '\n'


MET = {True: 'yes', False: 'NO', None: ''}


def markdown(rows):
    body = [[row.what, spread_text(row.values, row.unit), row.wanted_text(), MET[row.met()],
             row.note] for row in rows]
    return markdown_table(['what', 'median (min–max)', 'wanted', 'met', 'note'], body)


def costs_markdown(costs):
    """What each command cost: medians of CPU and wall seconds and of the peak memory."""
    body = []
    for name, entry in costs.items():
        def median(key, entry=entry):
            return statistics.median(run[key] for run in entry['runs'])
        cpu = statistics.median(run['user'] + run['system'] for run in entry['runs'])
        body.append([name, f'{cpu:.3f}', f'{median("system"):.3f}', f'{median("wall"):.3f}',
                     f'{median("peak_bytes") / 1e6:.0f}', f'{entry["others_percent"]:.0f} %'])
    return markdown_table(
        ['command', 'CPU s', 'of it system', 'wall s', 'peak MB', 'machine used by others'], body)


def footer(about):
    before, after = about['load'], about['load_after']
    return (f'{about["processor"]}, {about["cores"]} cores, {about["system"]}; load average '
            f'{before[0]:.2f} before, {after[0]:.2f} after; {about["time"]}. A busy machine spoils wall '
            'times, the rows of two threads above all.')
