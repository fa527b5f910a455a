#!/usr/bin/env python3
"""/metrics as Prometheus reads it: its own client's parser, and promtool where there is one."""
import concurrent.futures
import shutil
import subprocess
import tempfile
import threading
import unittest

from prometheus_client.parser import text_string_to_metric_families

import harness
from harness import CUBE, Server, ServerCase, spot

# What docs/http.md and the issue of the service name, and the labels of each.
SERIES = {
    'strata_info': ('gauge', {'version'}),
    'strata_requests': ('counter', {'protocol', 'endpoint', 'status'}),
    'strata_request_seconds': ('histogram', {'protocol', 'endpoint', 'le'}),
    'strata_body_bytes': ('counter', {'direction'}),
    'strata_connections': ('gauge', {'protocol'}),
    'strata_jobs': ('counter', {'outcome'}),
    'strata_job_seconds': ('histogram', {'le'}),
    'strata_jobs_running': ('gauge', set()),
    'strata_jobs_waiting': ('gauge', set()),
    'strata_job_memory_bytes': ('gauge', set()),
    'strata_samples': ('counter', set()),
    'strata_cache': ('counter', {'outcome'}),
}


def parsed(text):
    """Families by name. The parser refuses what is not the text format."""
    families = list(text_string_to_metric_families(text))
    named = {family.name: family for family in families}
    assert len(named) == len(families), 'a family stands there twice'
    return named


def counters(families):
    """The value of each series that may not fall."""
    return {(sample.name, tuple(sorted(sample.labels.items()))): sample.value
            for family in families.values() if family.type in ('counter', 'histogram')
            for sample in family.samples}


class Metrics(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.server = Server('--data', f'{cls.folder.name}/data', '--models', str(spot().parent))
        cls.server.curl('/v1/samples?resolution=9', body=CUBE)
        cls.server.curl('/v1/samples', body=b'no mesh')
        for _ in range(2):  # A miss, then a hit.
            cls.server.curl('/v1/samples?model=spot.obj&resolution=9')
        # A request is counted just after its answer.
        asked = 'strata_requests_total{endpoint="/v1/samples",protocol="http",status="200"}'
        harness.wait_until(lambda: cls.server.metric(asked) == 3, 'the requests to be counted')

    @classmethod
    def tearDownClass(cls):
        assert cls.server.stop() == 0
        cls.folder.cleanup()

    def text(self):
        answer = self.server.curl('/metrics')
        self.assertEqual(answer.headers['content-type'], 'text/plain; version=0.0.4; charset=utf-8')
        return answer.body.decode()

    def test_every_series_that_is_promised_is_there_with_its_type_and_labels(self):
        families = parsed(self.text())
        self.assertEqual(set(families), set(SERIES))
        for name, (kind, labels) in SERIES.items():
            family = families[name]
            self.assertEqual(family.type, kind, name)
            self.assertTrue(family.documentation, f'{name} has no help')
            found = {label for sample in family.samples for label in sample.labels}
            self.assertEqual(found, labels, name)

    def test_names_tell_their_units(self):
        for family in parsed(self.text()).values():
            self.assertRegex(family.name, r'^strata_[a-z]+(_[a-z]+)*$')
            for sample in family.samples:
                if family.type == 'counter':
                    self.assertTrue(sample.name.endswith('_total'), sample.name)
                if family.type == 'histogram':
                    self.assertTrue(family.name.endswith('_seconds'), family.name)
                for unit in ('_ms', '_milliseconds', '_kb', '_mb', '_kilobytes', '_percent'):
                    self.assertNotIn(unit, sample.name)

    def test_histograms_add_up(self):
        for family in parsed(self.text()).values():
            if family.type != 'histogram':
                continue
            groups = {}
            for sample in family.samples:
                labels = {k: v for k, v in sample.labels.items() if k != 'le'}
                group = groups.setdefault(tuple(sorted(labels.items())), {'buckets': []})
                if sample.name.endswith('_bucket'):
                    group['buckets'].append((float(sample.labels['le']), sample.value))
                else:
                    group[sample.name[len(family.name):]] = sample.value
            for labels, group in groups.items():
                bounds, counts = zip(*sorted(group['buckets']))
                self.assertEqual(bounds[-1], float('inf'), labels)
                self.assertEqual(list(counts), sorted(counts), labels)
                self.assertEqual(counts[-1], group['_count'], labels)
                self.assertGreaterEqual(group['_sum'], 0.0)

    def test_the_figures_are_those_of_what_was_asked(self):
        families = parsed(self.text())

        def value(name, **labels):
            return sum(sample.value for sample in families[name].samples
                       if labels.items() <= sample.labels.items() and
                       not sample.name.endswith('_created'))
        self.assertEqual(value('strata_cache', outcome='hit'), 1)
        self.assertEqual(value('strata_cache', outcome='miss'), 1)
        self.assertGreaterEqual(value('strata_jobs', outcome='succeeded'), 2)
        self.assertGreaterEqual(value('strata_jobs', outcome='failed'), 1)
        self.assertGreater(value('strata_samples'), 0)
        self.assertGreaterEqual(value('strata_body_bytes', direction='in'), len(CUBE))
        self.assertGreaterEqual(
            value('strata_requests', endpoint='/v1/samples', protocol='http', status='200'), 3)
        harness.wait_until(lambda: self.server.metric('strata_connections{protocol="http"}') == 1,
                           'only the connection that asks to be counted')

    def test_counters_never_fall_under_load(self):
        stop = threading.Event()
        asked = []

        def ask(number):
            count = 0
            while not stop.is_set() and count < 200:
                path = ('/v1/samples?resolution=5', '/v1/samples?resolution=0', '/livez')[count % 3]
                self.server.curl(path, body=None if path == '/livez' else CUBE)
                count += 1
            asked.append(count)
        before = counters(parsed(self.text()))
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            loads = [pool.submit(ask, number) for number in range(4)]
            try:
                for _ in range(40):
                    now = counters(parsed(self.text()))
                    for series, value in before.items():
                        self.assertGreaterEqual(now[series], value, series)
                    before = now
            finally:
                stop.set()
            for load in loads:
                load.result()
        self.assertGreater(sum(asked), 0)
        total = ('strata_requests_total', (('endpoint', '/livez'), ('protocol', 'http'),
                                           ('status', '200')))
        self.assertGreater(before[total], 0)

    def test_no_text_of_a_client_becomes_a_label(self):
        for path in ('/made-up', '/v1/models/made-up', '/v1/jobs/made-up', '/v1/uploads/made-up'):
            self.server.curl(path)
        self.assertNotIn('made-up', self.text())

    def test_promtool_has_nothing_to_say(self):
        promtool = shutil.which('promtool')
        if not promtool:
            self.skipTest('promtool is missing (Debian: prometheus)')
        done = subprocess.run([promtool, 'check', 'metrics'], input=self.text().encode(),
                              capture_output=True, timeout=harness.PATIENCE)
        self.assertEqual((done.returncode, done.stdout + done.stderr), (0, b''))


if __name__ == '__main__':
    harness.main()
